"""The laws that every change keeps. Law 3 is in test_sense.py, law 4 for messages in test_merge.py, law 5 in
test_codec.py; here are the others, and what laws 4 and 5 say of whole episodes."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scenes import Steady, Twitchy, digest, started, steps, whole_episode

from cad_env.config import RadioConfig, radio_config
from cad_env.env import CADEnv
from cad_env.live import Board, play
from cad_env.pipeline.codec import ACCEPTED as READ
from cad_env.pipeline.codec import decode, read
from cad_env.pipeline.merge import finish_merge, receive, start_merge, take_in
from cad_env.pipeline.observe import as_observation
from cad_env.pipeline.radio import ACCEPTED, OVER_BUDGET, link_of
from cad_env.pipeline.step import ALL, OTHERS, Fleet, new_fleet
from cad_env.pipeline.track import BIRTH_HITS
from cad_env.rollout import Episode, rollout, rollouts
from cad_env.rows import as_graph, empty_rows
from cad_env.scenarios import SCENARIOS
from cad_env.scenarios.ranges import DENSITIES
from cad_env.scenarios.scene import HIDDEN
from cad_env.simulation import Simulation, setup_from
from cad_env.types import BRAKE, FRAMES, GO, MERGED_ROWS, TRUCK, Rows
from cad_env.vector import CADVectorEnv
from cad_env.world.state import OFF, SCRIPTED

seeds = st.integers(0, 2**31 - 1)
EVERYWHERE = pytest.mark.parametrize(
    "where",
    [{"scenario": name, "traffic": density} for name in SCENARIOS for density in DENSITIES],
    ids=lambda where: "-".join(where.values()),
)
IDEAL = {"sensor": {"noise": 0.0, "miss": 0.0}, "radio": "ideal"}


def differences(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> list[str]:
    """The fields in which two observations, or stacks of them, are not the same to the last bit."""
    assert one.keys() == other.keys()
    return [name for name in one if one[name].tobytes() != other[name].tobytes()]


# --- 1. Budget 0 equals sharing nothing ---------------------------------------------------------------------


@EVERYWHERE
@settings(max_examples=1)
@given(seeds)
def test_law_1_a_budget_of_zero_is_no_radio_to_the_last_bit(where: dict, seed: int):
    with_zero, rest = whole_episode(seed, **where, radio=RadioConfig(rate=0.0, loss=0.3, delay=0.5, range=1e6), depth=3)
    without, same = whole_episode(seed, **where, radio="none")
    assert differences(with_zero, without) == []
    assert [r[:2] for r in rest] == [r[:2] for r in same]
    assert all(r[2]["bytes_received"] == r[2]["bytes_sent"] == r[2]["messages_sent"] == 0 for r in rest)


@EVERYWHERE
@settings(max_examples=1)
@given(seeds)
def test_law_1_no_radio_is_as_if_no_other_vehicle_were_connected(where: dict, seed: int):
    simulation, alone = started(seed, **where, radio="none"), np.array([0])
    fleet = new_fleet(alone, len(simulation.world.speed), 1, link_of(radio_config("none")))
    board = Board(1)
    board.put(0, simulation._live._replace(fleet=fleet, told=board.told_at(0)))  # the same world, another fleet
    for _ in steps(simulation, action=lambda agent: BRAKE if agent == 0 and seed % 2 else GO):
        play(board.shelf, alone, alone, False)
        assert differences(simulation.observation(0), view_of(fleet, 0)) == []


def view_of(fleet: Fleet, receiver: int) -> dict[str, np.ndarray]:
    return as_observation(type(fleet.views)(*(part[receiver] for part in fleet.views)))


def test_sharing_does_change_what_the_ego_sees():
    # Otherwise law 1 could hold of a radio that never carries anything.
    sharing, without = whole_episode(0, radio="dsrc")[0], whole_episode(0, radio="none")[0]
    assert sharing["mask"].sum() > 1.2 * without["mask"][: len(sharing["mask"])].sum()


# --- 2. Perfect sensors and an unlimited radio: nothing that anyone sees is missing ----------------------------


@EVERYWHERE
@settings(max_examples=2)
@given(seeds)
def test_law_2_with_perfect_sharing_the_ego_knows_what_any_vehicle_sees(where: dict, seed: int):
    simulation = started(seed, **where, **IDEAL)
    fleet, world = simulation.fleet, simulation.world
    streak = np.zeros(fleet.visible.shape, int)
    checked = 0
    for _ in steps(simulation):
        streak = np.where(fleet.visible, streak + 1, 0)
        known = simulation.merged_graph(0)
        newest = known.position[:, -1, :2][known.mask[:, -1]]
        # A track is born with its third detection, so an object counts once one vehicle has seen it three times in
        # a row. The vehicles that send are always known; the ego itself is nobody's object.
        seen = (streak >= BIRTH_HITS).any(axis=0)
        seen[simulation.agents] = True
        seen[0] = False
        for row in np.flatnonzero(seen & (world.driver != OFF)):
            assert np.linalg.norm(newest - world.position[row], axis=1).min() < 0.5, (simulation.steps, row)
            checked += 1
    assert checked > 100


def test_law_2_the_same_holds_for_every_receiver():
    simulation = started(3, **IDEAL)
    for _ in steps(simulation, 30):
        for agent, own in enumerate(simulation.agents):
            known = simulation.merged_graph(agent)
            newest = known.position[:, -1, :2][known.mask[:, -1]]
            for row in set(simulation.agents) - {own}:
                assert np.linalg.norm(newest - simulation.world.position[row], axis=1).min() < 0.5


# --- 4. Order and repetition, in the pipeline ------------------------------------------------------------------


def heard_again(fleet: Fleet, senders: list[int]) -> Rows:
    """What the ego would know if it heard each of these senders' newest messages once more, in this order."""
    kept = Rows(*(part[0].copy() for part in fleet.kept))
    message, header = empty_rows(), np.zeros(3, np.int64)
    for sender in senders:
        length = int(fleet.air.length[0, sender])
        assert read(fleet.air.payload[0, sender], length, header, message) == READ
        receive(Rows(*(part[sender] for part in kept)), message, int(header[2]), 0)
    merged, weight, trail = empty_rows(rows=MERGED_ROWS), np.zeros((MERGED_ROWS, FRAMES)), fleet.trail[0]
    start_merge(merged, weight)
    take_in(merged, weight, Rows(*(part[0] for part in fleet.window)), OTHERS, trail)
    for sender in range(1, len(fleet.rows)):
        take_in(merged, weight, Rows(*(part[sender] for part in kept)), ALL, trail)
    finish_merge(merged, trail)
    return merged


@EVERYWHERE
@settings(max_examples=1)
@given(seeds, st.sampled_from([1, 5, FRAMES]), st.randoms(use_true_random=False))
def test_law_4_hearing_messages_once_more_in_any_order_changes_nothing(where: dict, seed: int, depth: int, chance):
    simulation = started(seed, **where, radio=RadioConfig(loss=0.0, range=1e6), depth=depth)
    for _ in steps(simulation, 40):
        senders = list(range(1, len(simulation.agents))) * 2
        chance.shuffle(senders)
        once, again = simulation.merged_graph(0), as_graph(heard_again(simulation.fleet, senders), 0, simulation.time)
        assert once.position.tobytes() == again.position.tobytes()
        assert once.mask.tobytes() == again.mask.tobytes()
        assert once.kind.tolist() == again.kind.tolist()


# --- 5. What is received is what was sent, and the budget holds ------------------------------------------------


@EVERYWHERE
@settings(max_examples=1)
@given(seeds, st.integers(1, FRAMES), st.sampled_from([2e6, 30_000.0, 24_000.0, 16_000.0]))
def test_law_5_what_arrives_is_what_was_sent_and_never_more_than_the_budget(
    where: dict, seed: int, depth: int, rate: float
):
    radio = RadioConfig(rate=rate, loss=0.0, range=1e6)
    simulation = started(seed, **where, radio=radio, depth=depth)
    fleet = simulation.fleet
    for step in steps(simulation, 60):
        slot = step % fleet.air.step.shape[0]
        for sender in range(len(simulation.agents)):
            size = int(fleet.report.sent_bytes[sender])
            assert size <= radio.budget
            if fleet.report.refusal[sender] != ACCEPTED:
                assert size == 0
                continue
            said = simulation.own_graph(sender)
            heard = decode(fleet.air.payload[slot, sender, :size].tobytes())
            newest = said.mask.copy()
            newest[:, : FRAMES - depth] = False
            spoken = newest.any(axis=1)
            assert heard.track.tolist() == said.track[spoken].tolist()
            assert (heard.mask == newest[spoken]).all()
            assert np.abs(heard.position - said.position[spoken])[heard.mask].max() <= 0.005 + 1e-9
            # With nothing lost, what the ego holds of a sender in these frames is just that.
            kept = as_graph(type(fleet.message)(*(part[0, sender] for part in fleet.kept)), sender, 0.0)
            for track, position, mask in zip(heard.track, heard.position, heard.mask, strict=True):
                if sender != 0:
                    row = kept.track.tolist().index(track)
                    assert (kept.mask[row, FRAMES - depth :] == mask[FRAMES - depth :]).all()
                    assert (kept.position[row][mask] == position[mask]).all()


def test_law_5_a_tight_budget_lets_short_messages_pass_and_refuses_long_ones():
    simulation = started(0, radio=RadioConfig(rate=16_000.0, loss=0.0))  # 200 bytes
    answers = [simulation.fleet.report.refusal.copy() for _ in steps(simulation, 40)]
    assert {int(answer) for answer in np.ravel(answers)} == {ACCEPTED, OVER_BUDGET}


# --- 6. The world has no preferred place or direction ----------------------------------------------------------


def moved(simulation: Simulation, dx: float, dy: float, angle: float) -> None:
    """Turn the map of a simulation about its origin and shift it; the next start places everybody on it."""
    routes = simulation.map.routes
    cos, sin = math.cos(angle), math.sin(angle)
    point = routes.point @ np.array([[cos, sin], [-sin, cos]]) + [dx, dy]
    simulation.map = replace(simulation.map, routes=routes._replace(point=point, heading=routes.heading + angle))


def two_worlds(seed: int, dx: float, dy: float, angle: float, options: dict) -> Iterator[tuple[dict, dict]]:
    """What the ego sees in a world and in the same one elsewhere, step by step."""
    here, there = Simulation(setup_from(options)), Simulation(setup_from(options))
    moved(there, dx, dy, angle)
    here.start(seed)
    there.start(seed)
    for _ in zip(steps(here), steps(there), strict=True):
        yield here.observation(0), there.observation(0)
    assert here.outcome() == there.outcome() is not None


shifts, angles = st.floats(-2000.0, 2000.0), st.floats(-7.0, 7.0)


@EVERYWHERE
@settings(max_examples=2)
@given(seeds, shifts, shifts, angles)
def test_law_6_shifting_and_turning_the_world_changes_no_observation(where: dict, seed, dx, dy, angle):
    # Sensor noise is drawn along the axes of the world, so it is off; misses are not.
    for one, other in two_worlds(seed, dx, dy, angle, {**where, "sensor": {"noise": 0.0}, "radio": "none"}):
        for name in one:
            np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=3e-5, err_msg=name)  # float32 at 200 m


@EVERYWHERE
@settings(max_examples=2)
@given(seeds, shifts, shifts, angles)
def test_law_6_what_is_shared_moves_by_no_more_than_the_centimetre_of_a_message(where: dict, seed, dx, dy, angle):
    # Positions on the air are whole centimetres along the axes of the world, so ties between tracks that are equally
    # near, or fit equally well, may fall otherwise; but the same nodes are known.
    for one, other in two_worlds(seed, dx, dy, angle, {**where, "sensor": {"noise": 0.0}, "radio": "dsrc"}):
        for name in set(one) - {"tracks", "mask", "kind"}:
            np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=3e-5, err_msg=name)
        for t in range(FRAMES):
            here, there = (seen["tracks"][seen["mask"][:, t] == 1, t] for seen in (one, other))
            apart = np.linalg.norm(here[:, None] - there[None], axis=-1)
            assert len(here) == len(there) == 0 or max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 0.02


@EVERYWHERE
@settings(max_examples=2)
@given(seeds, st.integers(-1000, 1000), st.integers(-1000, 1000))
def test_law_6_shifting_the_world_changes_no_observation_with_all_its_noise(where: dict, seed, dx, dy):
    for one, other in two_worlds(seed, dx, dy, 0.0, {**where, "sensor": {"gnss_noise": 0.5}}):
        for name in one:
            np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=3e-5, err_msg=name)


# --- 7. Named streams ------------------------------------------------------------------------------------------

OTHER_SETUPS = [
    {"sensor": {"noise": 3.0, "miss": 0.5, "gnss_noise": 5.0, "gnss_yaw_noise": 0.5, "range": 20.0}},
    {"radio": "none"},
    {"radio": {"loss": 0.9, "delay": 1.0}},
    {"depth": 1},
]


@EVERYWHERE
@settings(max_examples=5)
@given(seeds, st.sampled_from(OTHER_SETUPS))
def test_law_7_noise_and_radio_do_not_move_the_traffic(where: dict, seed: int, options: dict):
    usual, other = started(seed, **where), started(seed, **where, **options)
    assert usual.scene == other.scene
    for name, one, two in zip(usual.world._fields, usual.world, other.world, strict=True):
        assert one.tobytes() == two.tobytes(), name


@EVERYWHERE
@settings(max_examples=2)
@given(seeds)
def test_law_7_the_radio_does_not_move_what_the_sensors_report(where: dict, seed: int):
    radios = ("dsrc", "none", RadioConfig(loss=0.9, delay=0.3))
    simulations = [started(seed, **where, radio=radio) for radio in radios]
    for _ in zip(*(steps(simulation, 40) for simulation in simulations), strict=True):
        for agent in range(len(simulations[0].agents)):
            graphs = [simulation.own_graph(agent) for simulation in simulations]
            assert len({graph.position.tobytes() + graph.mask.tobytes() for graph in graphs}) == 1


@EVERYWHERE
@settings(max_examples=2)
@given(seeds)
def test_law_7_another_policy_meets_the_same_traffic(where: dict, seed: int):
    drawn = []
    env = CADEnv(**where)
    for policy in (Steady(GO), Steady(BRAKE), Twitchy()):
        rollout(env, policy, seed)
        env.reset(seed=seed)
        drawn.append(b"".join(part.tobytes() for part in env.simulation.world))
    assert len(set(drawn)) == 1


# --- 8. No policy sees what nobody sees ------------------------------------------------------------------------


def hidden_rows(simulation: Simulation) -> list[int]:
    """Vehicles that no connected vehicle has a line of sight to now, and that are not connected themselves."""
    seen = simulation.fleet.visible.any(axis=0)
    seen[simulation.agents] = True
    return [int(row) for row in np.flatnonzero(~seen & (simulation.world.driver != OFF))]


# Where there is little traffic most changes come into view, and are not counted.
@EVERYWHERE
@settings(max_examples=5, suppress_health_check=[HealthCheck.filter_too_much])
@given(seeds, st.integers(0, 40), st.floats(-3.0, 3.0), st.floats(0.0, 25.0))
def test_law_8_changing_what_nobody_sees_changes_no_observation(
    where: dict, seed: int, when: int, shift: float, speed: float
):
    usual, changed = started(seed, hazard=True, **where), started(seed, hazard=True, **where)
    for _ in zip(steps(usual, when), steps(changed, when), strict=True):
        pass
    rows = hidden_rows(usual)
    assume(rows)
    assert rows == hidden_rows(changed)
    world = changed.world
    for row in rows:
        world.speed[row] = world.target_speed[row] = speed
        world.kind[row], world.driver[row] = TRUCK, SCRIPTED
        world.stop_at[row], world.acceleration[row] = 50.0, -3.0
        along = world.heading[row]
        world.position[row] += shift * math.cos(along), shift * math.sin(along)
    for simulation in (usual, changed):
        simulation._perceive()  # the same instant once more, and once more with the change
    assume((usual.fleet.visible == changed.fleet.visible).all())  # it has not come into view, nor before another
    for agent in range(len(usual.agents)):
        assert differences(usual.observation(agent), changed.observation(agent)) == []
        assert usual.own_graph(agent).position.tobytes() == changed.own_graph(agent).position.tobytes()


def test_law_8_has_something_to_hide():
    # Otherwise the law above would be about nothing: hidden vehicles are common, and among them is the hazard.
    hidden = [hidden_rows(started(seed, hazard=True)) for seed in range(30)]
    assert sum(len(rows) > 0 for rows in hidden) >= 15
    assert sum(HIDDEN in rows for rows in hidden) >= 10


@EVERYWHERE
@settings(max_examples=2)
@given(seeds)
def test_law_8_whether_a_hazard_is_coming_does_not_show_before_it_is_seen(where: dict, seed: int):
    coming, clear = started(seed, hazard=True, **where), started(seed, hazard=False, **where)
    for _ in zip(steps(coming, 60), steps(clear, 60), strict=True):
        if coming.fleet.visible.tobytes() != clear.fleet.visible.tobytes() or coming.fleet.visible[:, HIDDEN].any():
            break
        assert differences(coming.observation(0), clear.observation(0)) == []


# --- 9. One seed, one episode ----------------------------------------------------------------------------------


@EVERYWHERE
@settings(max_examples=1)
@given(seeds)
def test_law_9_the_same_seed_gives_the_same_episode_twice(where: dict, seed: int):
    assert digest(seed, **where) == digest(seed, **where) != digest(seed + 1, **where)


def test_law_9_a_fresh_process_gives_the_same_episode():
    program = "import json, scenes; print(json.dumps([scenes.digest(seed) for seed in (1, 2)]))"
    env = {**os.environ, "PYTHONHASHSEED": "77"}
    here = Path(__file__).parent
    answer = subprocess.run(
        [sys.executable, "-c", program], cwd=here, env=env, capture_output=True, text=True, check=True
    )
    assert json.loads(answer.stdout) == [digest(1), digest(2)]


def facts(episode: Episode) -> list:
    """Everything an episode holds, comparable."""
    values = [getattr(episode, field.name) for field in fields(episode)]
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in values]


def test_law_9_side_by_side_is_as_alone():
    numbers, seen = range(100, 113), {"alone": {}, "together": {}}

    def watch(how: str):
        def note(where: CADEnv | Simulation, observation: dict, action: int) -> None:
            simulation = where if isinstance(where, Simulation) else where.simulation
            parts = b"".join(observation[name].tobytes() for name in sorted(observation))
            seen[how].setdefault(simulation.seed, []).append((parts, action))

        return note

    alone = [rollout(CADEnv(), Twitchy(), number, watch=watch("alone")) for number in numbers]
    envs = CADVectorEnv(8)
    together = list(rollouts(envs, Twitchy(), numbers, watch=watch("together")))
    assert len(together) == len(alone)
    assert [episode.seed for episode in together] != list(numbers)  # they end in another order, and yet
    assert [facts(e) for e in sorted(together, key=lambda e: e.seed)] == [facts(e) for e in alone]
    assert seen["together"] == seen["alone"]


def test_law_9_an_episode_does_not_depend_on_those_before_it():
    env, fresh = CADEnv(), CADEnv()
    for seed in (5, 6, 7):
        rollout(env, Twitchy(), seed)
    assert facts(rollout(env, Twitchy(), 8)) == facts(rollout(fresh, Twitchy(), 8))


@pytest.mark.slow
def test_law_9_holds_for_many_seeds():
    envs = CADVectorEnv(64)
    together = {e.seed: facts(e) for e in rollouts(envs, Twitchy(), range(500))}
    env = CADEnv()
    assert all(facts(rollout(env, Twitchy(), seed)) == together[seed] for seed in range(500))
