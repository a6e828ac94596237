"""Laws 1 and 2, and what 4 and 5 say of whole episodes. Law 3 is in test_sense.py, 4 for messages in test_merge.py,
5 in test_codec.py, 6 and 8 in test_laws_world.py, 7 and 9 in test_laws_seed.py. Every change keeps them all."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import started, steps, whole_episode

from cad_env.config import RadioConfig, radio_config
from cad_env.pipeline.codec import DECODED as READ
from cad_env.pipeline.codec import decode, read
from cad_env.pipeline.fleet import Fleet, new_fleet
from cad_env.pipeline.graph_arrays import as_graph, empty_graph_arrays
from cad_env.pipeline.merge import finish_merge, receive, start_merge, take_in
from cad_env.pipeline.observe import as_observation
from cad_env.pipeline.radio import ACCEPTED, OVER_BUDGET, link_of
from cad_env.pipeline.step import ALL, OTHERS
from cad_env.pipeline.track import BIRTH_HITS
from cad_env.scenarios import SCENARIOS
from cad_env.scenarios.ranges import DENSITIES
from cad_env.simulation.scene_step import BatchState, play
from cad_env.types import BRAKE, FRAMES, GO, MAX_MERGED_TRACKS, GraphArrays
from cad_env.world.state import OFF

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
    batch_state = BatchState(1)
    batch_state.put(
        0, simulation._scene_state._replace(fleet=fleet, step_info=batch_state.step_info_at(0))
    )  # the same world, another fleet
    for _ in steps(simulation, action=lambda agent: BRAKE if agent == 0 and seed % 2 else GO):
        play(batch_state.records, alone, alone, False)
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


def heard_again(fleet: Fleet, senders: list[int]) -> GraphArrays:
    """What the ego would know if it heard each of these senders' newest messages once more, in this order."""
    kept = GraphArrays(*(part[0].copy() for part in fleet.kept))
    message, header = empty_graph_arrays(), np.zeros(3, np.int64)
    for sender in senders:
        length = int(fleet.air.length[0, sender])
        assert read(fleet.air.payload[0, sender], length, header, message) == READ
        receive(GraphArrays(*(part[sender] for part in kept)), message, int(header[2]), 0)
    merged, weight, trail = (
        empty_graph_arrays(rows=MAX_MERGED_TRACKS),
        np.zeros((MAX_MERGED_TRACKS, FRAMES)),
        fleet.trail[0],
    )
    start_merge(merged)
    take_in(merged, weight, GraphArrays(*(part[0] for part in fleet.window)), OTHERS, trail)
    for sender in range(1, len(fleet.rows)):
        take_in(merged, weight, GraphArrays(*(part[sender] for part in kept)), ALL, trail)
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
