"""What holds of every scenario as it is drawn: ranges, hazards, who is connected, traffic that does not crash."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import fields

import numpy as np
import pytest
from scenes import Steady, started, steps

from cad_env.envs.single import CADEnv
from cad_env.numerics.philox import generator
from cad_env.rules.expert import Expert
from cad_env.rules.planner import Planner
from cad_env.scenarios import SCENARIOS, SHIPPED, scenario_named
from cad_env.scenarios.overtaking import EAST
from cad_env.scenarios.ranges import DENSITIES, Traffic
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.scene import EGO, OCCLUDER, Actors, Placement, Scene, place
from cad_env.scoring.rollout import rollout
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, GO, MAX_STEPS, STEP, TRUCK
from cad_env.world.drivers import HARDEST_BRAKING, MAX_ACCELERATION
from cad_env.world.state import OFF, STANDING
from cad_env.world.step import advance, note_contacts

SEEDS = range(200)
EVERY = pytest.mark.parametrize("scenario", [SCENARIOS[name] for name in SHIPPED], ids=SHIPPED)
DENSITY = pytest.mark.parametrize("density", DENSITIES)


def drawn(scenario: Scenario, seed: int, hazard: bool | None = None, **ranges) -> Scene:
    return scenario.scene(scenario.configured(ranges), Traffic(), seed, hazard)


def cast(scenario: Scenario, seed: int, **ranges) -> Actors:
    """The actors alone."""
    return scenario.actors(scenario.map, scenario.configured(ranges), generator(seed, "traffic"))


def where_they_meet(scenario: Scenario, drawn: Scene | Actors) -> float:
    """m along the way of the hidden stream, where it meets the ego's; in overtaking beside the truck."""
    vehicles = drawn.placements if isinstance(drawn, Scene) else drawn.vehicles
    ego, truck, route = vehicles[EGO], vehicles[OCCLUDER], vehicles[drawn.hidden[0]].route
    if scenario.name == "overtaking":
        return EAST - 0.5 * truck.length
    return scenario.map.crossing(ego.route, route)[1]


def nobody_touches(scenario: Scenario, scene: Scene) -> bool:
    world = place(scene.placements, scenario.map.routes)
    note_contacts(world)
    return bool((world.struck < 0).all())


def scenes_of(scenario: Scenario, density: str = "light", penetration: float | None = None, count: int = 100, **ranges):
    traffic = Traffic(density, penetration)
    return [scenario.scene(scenario.configured(ranges), traffic, seed) for seed in range(count)]


@EVERY
def test_the_same_seed_draws_the_same_scene_and_another_seed_another(scenario: Scenario):
    scenes = scenes_of(scenario)
    assert scenes_of(scenario, count=30) == scenes[:30]
    assert len({scene.placements for scene in scenes}) == len(scenes)


@EVERY
def test_about_half_of_the_scenes_have_a_hazard(scenario: Scenario):
    # always-go collides in 40 to 60 % of all episodes, give or take 300 draws.
    scenes = scenes_of(scenario, "none", count=300)
    assert 0.33 < sum(scene.hazard for scene in scenes) / 300 < 0.67
    assert all(scene.draws == 1 for scene in scenes)


@EVERY
def test_a_hazard_is_what_an_ego_that_never_brakes_meets(scenario: Scenario):
    kinds = set()
    for seed in SEEDS[:40]:
        simulation = started(seed, scenario=scenario.name, traffic="none", radio="none")
        scene = simulation.scene
        for _ in steps(simulation):
            pass
        kinds.add(simulation.outcome())
        assert simulation.outcome() == ("collision" if scene.hazard else "success")
        if scene.hazard:
            assert simulation.world.struck[EGO] == scene.hazard_row
            assert simulation.time == pytest.approx(scene.hazard_time)
            assert scene.hazard_row in scene.hidden
        else:
            assert scene.hazard_row == -1
            assert scene.hazard_time == math.inf
    assert kinds == {"success", "collision"}


@EVERY
def test_forcing_draws_the_actors_of_the_same_stream_again_and_counts(scenario: Scenario):
    ranges, counts = scenario.configured({}), []
    for seed in SEEDS[:30]:
        free, *forced = (drawn(scenario, seed, hazard) for hazard in (None, True, False))
        assert [scene.hazard for scene in forced] == [True, False]
        assert forced[not free.hazard] == free
        for scene in forced:
            rng = generator(seed, "traffic")
            again = [scenario.actors(scenario.map, ranges, rng).vehicles for _ in range(scene.draws)]
            assert scene.placements[: len(again[-1])] == again[-1]
            counts.append(scene.draws)
        assert min(scene.draws for scene in forced) == 1 < max(scene.draws for scene in forced)
    assert 1.5 < np.mean(counts) < 3.0


@EVERY
def test_a_kind_of_episode_that_the_ranges_do_not_hold_is_refused_in_one_line(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("cad_env.scenarios.scenario.MOST_DRAWS", 20)
    assert not drawn(scenario, 0, False, empty_share=1.0).hazard
    complaint = f"no episode of {scenario.name} with hazard=True in 20 draws: choose other ranges than"
    with pytest.raises(ValueError, match=complaint) as refusal:
        drawn(scenario, 0, True, empty_share=1.0)
    assert "\n" not in str(refusal.value)
    assert "empty_share=1.0" in str(refusal.value)


@EVERY
def test_arrivals_know_nothing_of_the_ego(scenario: Scenario):
    def arrivals(seed: int, **ranges) -> list[Placement]:
        drawn = cast(scenario, seed, empty_share=0.0, **ranges)
        return [drawn.vehicles[row] for row in drawn.hidden]

    ranges = scenario.ranges()
    slow, far = ranges.ego_speed[0] - 2.0, ranges.ego_start[1] + 20.0
    for seed in SEEDS[:50]:
        usual = arrivals(seed)
        assert arrivals(seed, ego_speed=(slow, slow), ego_start=(far, far)) == usual != arrivals(seed + 1)


@EVERY
def test_the_stream_has_been_there_before_the_ego_and_lasts_for_the_whole_episode(scenario: Scenario):
    times: list[float] = []
    for seed in SEEDS:
        drawn = cast(scenario, seed, empty_share=0.0)
        conflict = where_they_meet(scenario, drawn)
        stream = [drawn.vehicles[row] for row in drawn.hidden]
        times.extend((conflict - vehicle.progress) / vehicle.speed for vehicle in stream)
    counts = np.histogram(times, bins=np.arange(-5.0, 45.0, 5.0))[0]  # from 5 s before the start to the end
    assert len(counts) == 9
    assert counts == pytest.approx(counts.mean(), rel=0.3)


@EVERY
def test_another_density_or_penetration_leaves_the_actors_and_the_hazard_alone(scenario: Scenario):
    ranges = scenario.configured({})
    for seed in SEEDS[:20]:
        for hazard in (None, True):
            alone = scenario.scene(ranges, Traffic("none"), seed, hazard)
            for traffic in (Traffic("light"), Traffic("dense"), Traffic("dense", 0.5)):
                scene = scenario.scene(ranges, traffic, seed, hazard)
                assert scene.placements[: len(alone.placements)] == alone.placements
                assert (scene.hazard_row, scene.hidden, scene.draws) == (alone.hazard_row, alone.hidden, alone.draws)
                assert scene.hazard_time == alone.hazard_time or not scene.hazard


@EVERY
@DENSITY
def test_a_density_is_a_number_of_further_vehicles(scenario: Scenario, density: str):
    ranges, low, high = scenario.configured({}), *DENSITIES[density]
    counts = set()
    for seed in SEEDS:
        actors = len(scenario.scene(ranges, Traffic("none"), seed).placements)
        counts.add(len(scenario.scene(ranges, Traffic(density), seed).placements) - actors)
    assert counts == set(range(low, high + 1))


@EVERY
@DENSITY
def test_nobody_touches_anybody_at_the_start(scenario: Scenario, density: str):
    for scene in scenes_of(scenario, density):
        assert nobody_touches(scenario, scene)


@EVERY
def test_nobody_touches_anybody_at_the_start_at_the_ends_of_what_ranges_allow(scenario: Scenario):
    within = {field.name: field.metadata["within"] for field in fields(scenario.ranges) if "within" in field.metadata}
    for speed in within["stream_speed"]:
        for headway in within["headway"]:
            ends = {"stream_speed": (speed, speed), "headway": (headway, headway), "empty_share": 0.0}
            for seed in SEEDS[:10]:
                assert nobody_touches(scenario, drawn(scenario, seed, **ends)), ends


@EVERY
def test_the_ego_is_the_first_of_at_least_three_connected_vehicles(scenario: Scenario):
    counts = set()
    for scene in scenes_of(scenario):
        assert scene.connected[0] == EGO
        assert len(set(scene.connected)) == len(scene.connected)
        assert not {*scene.connected} & {*scene.hidden}
        assert not any(scene.placements[row].bystander for row in scene.connected)
        counts.add(len(scene.connected))
    assert counts == {3, 4, 5}


@EVERY
def test_without_traffic_there_are_still_three_to_choose_collaborators_from(scenario: Scenario):
    for scene in scenes_of(scenario, "none", collaborators=(3, 3)):
        assert len(scene.connected) == 4


@EVERY
def test_penetration_is_the_share_of_all_vehicles_without_a_minimum(scenario: Scenario):
    half = scenes_of(scenario, "dense", 0.5)
    assert sum(len(scene.connected) - 1 for scene in half) / sum(map(eligible, half)) == pytest.approx(0.5, abs=0.06)
    assert all(len(scene.connected) - 1 == eligible(scene) for scene in scenes_of(scenario, "light", 1.0, count=20))
    assert all(scene.connected == (EGO,) for scene in scenes_of(scenario, "light", 0.0, count=20))


@EVERY
def test_more_traffic_leaves_the_connection_of_the_actors_alone(scenario: Scenario):
    for few, many in zip(scenes_of(scenario, "none", 0.4), scenes_of(scenario, "dense", 0.4), strict=True):
        assert few.connected == tuple(row for row in many.connected if row < len(few.placements))


def eligible(scene: Scene) -> int:
    """How many may be connected besides the ego."""
    return len(scene.placements) - 1 - len(scene.hidden)


@EVERY
@pytest.mark.parametrize("penetration", [None, 0.0, 0.5, 1.0])
def test_the_hidden_stream_is_never_connected(scenario: Scenario, penetration: float | None):
    asked = {"collaborators": (20, 20)} if penetration is None else {}
    scenes = scenes_of(scenario, "dense", penetration, **asked)
    assert sum(len(scene.hidden) for scene in scenes) > 500
    assert not any({*scene.connected} & {*scene.hidden} for scene in scenes)


@EVERY
def test_more_penetration_only_adds_connected_vehicles(scenario: Scenario):
    for few, many in zip(scenes_of(scenario, "dense", 0.2), scenes_of(scenario, "dense", 0.7), strict=True):
        assert set(few.connected) <= set(many.connected)


@EVERY
@pytest.mark.parametrize("penetration", [None, 0.0, 0.4, 1.0])
def test_no_scene_has_more_connected_vehicles_than_it_says(scenario: Scenario, penetration: float | None):
    most = scenario.most_connected(scenario.configured({}), Traffic("dense", penetration))
    found = max(len(scene.connected) for scene in scenes_of(scenario, "dense", penetration))
    assert found <= most
    assert found == most or penetration in (0.0, 0.4)


@EVERY
def test_the_occluder_is_a_truck_that_stands(scenario: Scenario):
    for scene in scenes_of(scenario):
        occluder = scene.placements[scene.occluder_row]
        assert scene.occluder_row == OCCLUDER
        assert (occluder.kind, occluder.driver, occluder.speed) == (TRUCK, STANDING, 0.0)


# Of the vehicles that are at the conflict within so many seconds: the share that is seen at the least by all connected
# vehicles but the ego, and by the ego at the most while it waits before the occluder.
VIEWS = {"left_turn": (3.0, 0.95, 0.85), "overtaking": (8.0, 0.99, 0.3), "street_crossing": (4.0, 0.99, 0.95)}
# What each guaranteed witness sees alone: it is in so many seconds at the conflict, share at the least.
WITNESSES = {
    "left_turn": {2: (4.0, 0.95)},
    "overtaking": {3: (8.0, 0.8)},
    "street_crossing": {OCCLUDER: (4.0, 0.97), 2: (4.0, 0.97)},
}


def shares_seen(scenario: Scenario, action: int) -> dict[object, tuple[int, float]]:
    """(vehicles near the conflict in all steps, share seen) of each row of WITNESSES, of the ego and of all others."""
    found: dict[object, list[float]] = {who: [0.0, 0.0] for who in (*WITNESSES[scenario.name], EGO, "others")}
    for seed in range(14):
        simulation = started(seed, hazard=True, scenario=scenario.name, traffic="none")
        world, scene, visible = simulation.world, simulation.scene, simulation.fleet.visible
        rows, conflict = np.array(scene.hidden), where_they_meet(scenario, scene)
        for _ in steps(simulation, action=lambda agent: action if agent == 0 else GO):
            away = (conflict - world.progress[rows]) / np.maximum(world.speed[rows], 1.0)
            for who, counts in found.items():
                horizon = WITNESSES[scenario.name].get(who, VIEWS[scenario.name])[0]
                some = rows[(away > 0.0) & (away < horizon) & (world.driver[rows] != OFF)]
                agents = np.arange(1, len(visible)) if who == "others" else np.flatnonzero(simulation.agents == who)
                if len(agents):
                    counts[0] += len(some)
                    counts[1] += visible[np.ix_(agents, some)].any(axis=0).sum()
    return {who: (int(near), seen / near) for who, (near, seen) in found.items()}


@EVERY
@pytest.mark.parametrize("action", [GO, BRAKE])
def test_others_see_the_stream_for_as_long_as_it_matters_and_the_ego_does_not(scenario: Scenario, action: int):
    shares, (_, others, own) = shares_seen(scenario, action), VIEWS[scenario.name]
    assert all(near > 200 for near, _ in shares.values())
    assert shares["others"][1] > others
    for row, (_, least) in WITNESSES[scenario.name].items():
        assert shares[row][1] > least
    assert action == GO or shares[EGO][1] < own
    assert shares[EGO][1] < shares["others"][1] - 0.05


@EVERY
def test_a_witness_is_always_connected(scenario: Scenario):
    assert all({*cast(scenario, seed).witnesses} == {*WITNESSES[scenario.name]} for seed in SEEDS[:20])
    for scene in scenes_of(scenario, "dense", collaborators=(1, 1)):
        assert {*WITNESSES[scenario.name]} & {*scene.connected}


# --- Nobody but the ego ever touches anybody -----------------------------------------------------------------------

EGOS = ("stands", "brakes", "acts at random", "goes late", "goes")


def driven(kind: str, simulation: Simulation, seed: int) -> Iterator[int]:
    """Decisions of an ego of a kind, step by step; one that stands does so from the start."""
    rng = np.random.default_rng(seed)
    late, acts = rng.uniform(0.5, 25.0) / STEP, rng.random(MAX_STEPS) < 0.5
    if kind == "stands":
        simulation.world.driver[EGO], simulation.world.speed[EGO] = STANDING, 0.0
    for step in range(MAX_STEPS):
        braking = {"goes": False, "goes late": step < late, "acts at random": bool(acts[step // 10])}
        yield BRAKE if braking.get(kind, True) else GO


def contacts_without_the_ego(scenario: Scenario, density: str, seed: int, kind: str) -> int:
    """How many have touched another than the ego in an episode, or until the ego itself touches somebody.

    The stated limits of every driver are checked on the way.
    """
    simulation = started(seed, scenario=scenario.name, traffic=density)
    world, routes, scratch = simulation.world, simulation.map.routes, np.zeros(len(simulation.world.speed))
    actions = np.zeros(len(simulation.agents), np.int64)
    fastest = np.maximum(world.speed, world.target_speed) + 1e-6
    for action in driven(kind, simulation, seed):
        actions[0] = action
        advance(world, routes, simulation.agents, actions, scratch)
        if world.struck[EGO] >= 0:
            break
        assert (world.acceleration >= -HARDEST_BRAKING - 1e-6).all()
        assert (world.acceleration <= MAX_ACCELERATION + 1e-6).all()
        assert (world.speed <= fastest).all()
    return int((world.struck[1:] > EGO).sum())


def all_contacts(scenario: Scenario, density: str, seeds: range, kinds: Sequence[str]) -> dict[tuple[str, int], int]:
    found = {(kind, seed): contacts_without_the_ego(scenario, density, seed, kind) for seed in seeds for kind in kinds}
    return {which: contacts for which, contacts in found.items() if contacts}


@EVERY
@DENSITY
def test_nobody_but_the_ego_touches_anybody_and_no_driver_exceeds_its_limits(scenario: Scenario, density: str):
    assert all_contacts(scenario, density, range(1_000_000, 1_000_010), EGOS) == {}


@pytest.mark.slow
@EVERY
@DENSITY
@pytest.mark.parametrize("kind", EGOS)
def test_nobody_but_the_ego_touches_anybody_in_2000_episodes(scenario: Scenario, density: str, kind: str):
    assert all_contacts(scenario, density, range(1_000_000, 1_002_000), [kind]) == {}


def outcomes(scenario: Scenario, policy, hazard: bool, radio: str = "none", count: int = 40) -> list[str]:
    env = CADEnv(scenario=scenario.name, radio=radio)
    return [rollout(env, policy, seed, hazard=hazard).outcome for seed in range(1_000_000, 1_000_000 + count)]


@EVERY
def test_never_braking_collides_in_a_hazard_and_not_without_one(scenario: Scenario):
    # The hazard is what an ego alone with the actors would meet; the traffic around may hold it back a little.
    assert outcomes(scenario, Steady(GO), hazard=True).count("collision") >= 36
    assert outcomes(scenario, Steady(GO), hazard=False).count("success") >= 36


@EVERY
@DENSITY
def test_the_expert_arrives_with_and_without_a_hazard_and_waits_for_no_gap_for_ever(scenario: Scenario, density: str):
    env = CADEnv(scenario=scenario.name, traffic=density, radio="none")
    for hazard in (True, False):
        episodes = [rollout(env, Expert(), seed, hazard=hazard) for seed in range(1_000_000, 1_000_025)]
        assert {episode.outcome for episode in episodes} == {"success"}
        assert np.median([episode.time for episode in episodes]) < 26.0


@EVERY
def test_the_same_rules_crash_alone_and_arrive_when_others_share(scenario: Scenario):
    assert outcomes(scenario, Planner(), True, "none").count("collision") >= 10
    assert outcomes(scenario, Planner(), True, "dsrc").count("collision") <= 2


@EVERY
def test_an_ego_that_stands_runs_out_of_time(scenario: Scenario):
    episode = rollout(CADEnv(scenario=scenario.name, radio="none"), Steady(BRAKE), 3)
    assert episode.outcome == "timeout"
    assert len(episode.action) == MAX_STEPS
    assert episode.time == pytest.approx(40.0)


@EVERY
def test_every_range_can_be_set_to_its_own_default_and_an_override_narrows_what_is_drawn(scenario: Scenario):
    default = scenario.ranges()
    assert scenario.configured({field.name: getattr(default, field.name) for field in fields(default)}) == default
    speed = default.ego_speed[0] + 0.5
    for seed in range(10):
        scene = drawn(scenario, seed, ego_speed=(speed, speed), collaborators=(3, 3))
        assert scene.placements[EGO].target_speed == speed
        assert len(scene.connected) == 4


@EVERY
def test_the_ranges_are_used_to_their_ends(scenario: Scenario):
    ranges, scenes = scenario.ranges(), scenes_of(scenario, count=200)
    for values, (low, high) in (
        ([s.placements[OCCLUDER].length for s in scenes], ranges.truck_length),
        ([s.placements[EGO].target_speed for s in scenes], ranges.ego_speed),
        ([s.placements[row].target_speed for s in scenes for row in s.hidden], ranges.stream_speed),
        ([len(s.connected) - 1 for s in scenes], ranges.collaborators),
    ):
        assert low <= min(values) < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < max(values) <= high


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"ranges": {"ego_sped": (7, 9)}}, "unknown left_turn range ego_sped=(7, 9): choose among attentive_share, "),
        ({"ranges": {"ego_speed": (9, 7)}}, "ego_speed must be a pair (from, to) within [1, 20], got (9, 7)"),
        ({"ranges": {"ego_speed": (7, 99)}}, "within [1, 20], got (7, 99)"),
        ({"ranges": {"ego_speed": 7}}, "ego_speed must be a pair"),
        ({"ranges": {"ego_speed": (7,)}}, "got (7,)"),
        ({"ranges": {"ego_speed": ("7", "9")}}, "got ('7', '9')"),
        ({"ranges": {"ego_speed": (math.nan, 9.0)}}, "got (nan, 9.0)"),
        ({"ranges": {"ego_speed": (True, 9.0)}}, "got (True, 9.0)"),
        ({"ranges": {"truck_yaw": (-0.1, 0.1)}}, "truck_yaw must be a pair (from, to) within [0, 0.2]"),
        ({"ranges": {"collaborators": (2.5, 3)}}, "collaborators must be a pair of whole numbers, got (2.5, 3)"),
        ({"ranges": {"collaborators": (-1, 2)}}, "collaborators must be a pair (from, to) within [0, 20], got (-1, 2)"),
        ({"ranges": {"empty_share": 1.5}}, "empty_share must be a number from 0 to 1, got 1.5"),
        ({"ranges": {"attentive_share": "half"}}, "attentive_share must be a number from 0 to 1, got 'half'"),
        ({"ranges": {"hazard_share": 0.5}}, "unknown left_turn range hazard_share=0.5: choose among attentive_share, "),
        ({"ranges": {"platoon": (0, 3)}}, "platoon must be a pair (from, to) within [1, 30], got (0, 3)"),
        ({"ranges": {"headway": (0.5, 2.0)}}, "headway must be a pair (from, to) within [0.9, 10], got (0.5, 2.0)"),
        ({"ranges": "dense"}, "ranges must be a dict of the scenario's ranges, got 'dense'"),
        ({"traffic": "heavy"}, "traffic must be one of none, light, dense, got 'heavy'"),
        ({"traffic": {"ego_speed": (7, 9)}}, "traffic must be one of none, light, dense, got {'ego_speed': (7, 9)}"),
        ({"penetration": 1.5}, "penetration must be a number from 0 to 1, got 1.5"),
        (
            {"penetration": 0.5, "ranges": {"collaborators": (0, 4)}},
            "penetration draws each connected vehicle by itself: leave out the range collaborators, got (0, 4)",
        ),
        ({"penetration": "all"}, "penetration must be a number from 0 to 1, got 'all'"),
        ({"scenario": "overtaking", "ranges": {"truck_yaw": (0, 0)}}, "unknown overtaking range truck_yaw=(0, 0)"),
    ],
)
def test_a_misspelt_or_impossible_option_is_refused_by_name_value_and_choices(options, complaint):
    with pytest.raises(ValueError, match=re.escape(complaint)) as refusal:
        Simulation(setup_from(options))
    assert "\n" not in str(refusal.value)


def test_an_unknown_scenario_is_refused_with_the_choices():
    choices = "left_turn, overtaking, street_crossing, unsignalised"
    with pytest.raises(ValueError, match=f"unknown scenario 'right_turn': choose among {choices}"):
        scenario_named("right_turn")
