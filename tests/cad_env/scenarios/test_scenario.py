"""What holds of every scenario as it is drawn: ranges, hazards, who is connected, traffic that does not crash."""

import math
import re
from dataclasses import fields

import numpy as np
import pytest
from scenes import Steady, started

from cad_env.envs.single import CADEnv
from cad_env.numerics.philox import generator
from cad_env.rules.expert import Expert
from cad_env.rules.planner import Planner
from cad_env.scenarios import SCENARIOS, scenario_named
from cad_env.scenarios.ranges import DENSITIES, Traffic
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.scene import EGO, HIDDEN, OCCLUDER, Scene, place
from cad_env.scoring.rollout import rollout
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, GO, TRUCK
from cad_env.world.state import OFF, SCRIPTED, STANDING
from cad_env.world.step import advance, note_contacts

SEEDS = range(200)
EVERY = pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
DENSITY = pytest.mark.parametrize("density", DENSITIES)


def drawn(scenario: Scenario, seed: int, hazard: bool | None = None, **ranges) -> Scene:
    return scenario.scene(scenario.configured(ranges), Traffic(), seed, hazard)


def scenes_of(scenario: Scenario, density: str = "light", penetration: float | None = None, count: int = 100, **ranges):
    traffic = Traffic(density, penetration)
    return [scenario.scene(scenario.configured(ranges), traffic, seed) for seed in range(count)]


@EVERY
def test_the_same_seed_draws_the_same_scene_and_another_seed_another(scenario: Scenario):
    scenes = scenes_of(scenario)
    assert scenes_of(scenario, count=30) == scenes[:30]
    assert len({scene.placements for scene in scenes}) == len(scenes)


@EVERY
def test_half_of_the_scenes_have_a_hazard(scenario: Scenario):
    hazards = sum(scene.hazard for scene in scenes_of(scenario, count=300))
    assert abs(hazards - 150) < 5 * math.sqrt(300 / 4)
    assert not any(drawn(scenario, seed, hazard_share=0.0).hazard for seed in SEEDS[:20])
    assert all(drawn(scenario, seed, hazard_share=1.0).hazard for seed in SEEDS[:20])


@EVERY
def test_forcing_the_hazard_changes_only_the_hidden_vehicle(scenario: Scenario):
    absent = 0
    for seed in SEEDS[:100]:
        with_hazard, without = drawn(scenario, seed, True), drawn(scenario, seed, False)
        assert (with_hazard.hazard, without.hazard) == (True, False)
        assert with_hazard.connected == without.connected
        for row, (one, other) in enumerate(zip(with_hazard.placements, without.placements, strict=True)):
            assert row == HIDDEN or one == other
        assert with_hazard.placements[HIDDEN].driver == SCRIPTED
        absent += without.placements[HIDDEN].driver == OFF
        assert drawn(scenario, seed) in (with_hazard, without)
    assert 10 < absent < 50


@EVERY
def test_another_density_or_penetration_leaves_the_cast_alone(scenario: Scenario):
    ranges = scenario.configured({})
    for seed in SEEDS[:20]:
        alone = scenario.scene(ranges, Traffic("none"), seed).placements
        for traffic in (Traffic("light"), Traffic("dense"), Traffic("dense", 0.5)):
            assert scenario.scene(ranges, traffic, seed).placements[: len(alone)] == alone


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
        world = place(scene, scenario.map.routes)
        note_contacts(world)
        assert (world.struck < 0).all()


@EVERY
def test_the_ego_is_the_first_of_at_least_three_connected_vehicles(scenario: Scenario):
    counts = set()
    for scene in scenes_of(scenario):
        assert scene.connected[0] == EGO
        assert len(set(scene.connected)) == len(scene.connected)
        assert HIDDEN not in scene.connected
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
    eligible = sum(len(scene.placements) - 2 for scene in half)
    assert sum(len(scene.connected) - 1 for scene in half) / eligible == pytest.approx(0.5, abs=0.06)
    everybody = scenes_of(scenario, "light", 1.0, count=20)
    assert all(len(scene.connected) == len(scene.placements) - 1 for scene in everybody)
    assert all(scene.connected == (EGO,) for scene in scenes_of(scenario, "light", 0.0, count=20))


@EVERY
@pytest.mark.parametrize("penetration", [0.1, 0.4])
def test_each_vehicle_is_connected_with_the_probability_of_the_penetration_by_itself(
    scenario: Scenario, penetration: float
):
    scenes, ranges = scenes_of(scenario, "dense", penetration, count=1000), scenario.configured({})
    error = 4.5 * math.sqrt(penetration * (1.0 - penetration) / len(scenes))
    for row in range(1, len(scenes[0].placements)):
        there = [scene for scene in scenes if row < len(scene.placements)]
        if len(there) == len(scenes):
            share = sum(row in scene.connected for scene in there) / len(there)
            assert (share == 0.0) if row == HIDDEN else abs(share - penetration) < error
    some, expected, spread = 0, 0.0, 0.0
    for seed, scene in enumerate(scenes):
        witnesses = scenario.actors(scenario.map, ranges, generator_after_hazard(seed), scene.hazard).witnesses
        some += not set(witnesses).isdisjoint(scene.connected)
        chance = 1.0 - (1.0 - penetration) ** len(witnesses)
        expected, spread = expected + chance, spread + chance * (1.0 - chance)
    assert abs(some - expected) < 4.5 * math.sqrt(spread)


def generator_after_hazard(seed: int) -> np.random.Generator:
    """The stream of the actors of a seed as they are given it: the kind of the episode is drawn."""
    rng = generator(seed, "traffic")
    rng.random()
    return rng


@EVERY
def test_more_traffic_leaves_the_connection_of_the_actors_alone(scenario: Scenario):
    for few, many in zip(scenes_of(scenario, "none", 0.4), scenes_of(scenario, "dense", 0.4), strict=True):
        assert few.connected == tuple(row for row in many.connected if row < len(few.placements))


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


@EVERY
def test_somebody_sees_the_hidden_vehicle_before_the_ego_does(scenario: Scenario):
    earlier = []
    for seed in range(40):
        simulation = started(seed, hazard=True, scenario=scenario.name)
        seen = []
        while simulation.outcome() is None and simulation.steps < 120:
            seen.append(simulation.fleet.visible[:, HIDDEN].copy())
            simulation.step(np.zeros(len(simulation.agents), np.int64))
        hidden, others = ~np.array(seen)[:, 0], np.array(seen)[:, 1:].any(axis=1)
        earlier.append((hidden & others).sum() * 0.1)
    assert min(earlier) > 0.3  # s, time for a track
    assert np.median(earlier) > 1.0


def contacts_among_others(scenario: Scenario, density: str, seed: int, ego_brakes: bool) -> int:
    """How many vehicles were touched by another than the ego in 30 s in which it stands, or comes to stand."""
    simulation = started(seed, scenario=scenario.name, traffic=density)
    world = simulation.world
    if not ego_brakes:
        world.driver[EGO], world.speed[EGO] = STANDING, 0.0
    actions = np.zeros(len(simulation.agents), np.int64)
    actions[0] = BRAKE
    scratch = np.zeros(len(world.speed))
    for _ in range(300):
        advance(world, simulation.map.routes, simulation.agents, actions, scratch)
    return int((world.struck[1:] > EGO).sum())


@EVERY
@DENSITY
@pytest.mark.parametrize("ego_brakes", [False, True])
def test_traffic_does_not_crash_by_itself(scenario: Scenario, density: str, ego_brakes: bool):
    seeds = range(1_000_000, 1_000_040)
    assert sum(contacts_among_others(scenario, density, seed, ego_brakes) for seed in seeds) == 0


@pytest.mark.slow
@EVERY
@DENSITY
@pytest.mark.parametrize("ego_brakes", [False, True])
def test_traffic_does_not_crash_by_itself_in_2000_episodes(scenario: Scenario, density: str, ego_brakes: bool):
    seeds = range(1_000_000, 1_002_000)
    assert sum(contacts_among_others(scenario, density, seed, ego_brakes) for seed in seeds) == 0


def outcomes(scenario: Scenario, policy, hazard: bool, radio: str = "none", count: int = 40) -> list[str]:
    env = CADEnv(scenario=scenario.name, radio=radio)
    return [rollout(env, policy, seed, hazard=hazard).outcome for seed in range(1_000_000, 1_000_000 + count)]


@EVERY
def test_never_braking_collides_in_a_hazard_and_not_without_one(scenario: Scenario):
    assert outcomes(scenario, Steady(GO), hazard=True).count("collision") >= 36
    assert outcomes(scenario, Steady(GO), hazard=False) == ["success"] * 40


@EVERY
def test_the_expert_arrives_with_and_without_a_hazard(scenario: Scenario):
    for hazard in (True, False):
        assert outcomes(scenario, Expert(), hazard) == ["success"] * 40


@EVERY
def test_the_same_rules_crash_alone_and_arrive_when_others_share(scenario: Scenario):
    assert outcomes(scenario, Planner(), True, "none").count("collision") >= 10
    assert outcomes(scenario, Planner(), True, "dsrc").count("collision") <= 2


@EVERY
def test_an_ego_that_stands_runs_out_of_time(scenario: Scenario):
    episode = rollout(CADEnv(scenario=scenario.name, radio="none"), Steady(BRAKE), 3)
    assert episode.outcome == "timeout"
    assert len(episode.action) == 300
    assert episode.time == pytest.approx(30.0)


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
        ([s.placements[HIDDEN].speed for s in scenes if s.hazard], ranges.collider_speed),
        ([s.timing for s in scenes if s.hazard], ranges.hazard_timing),
        ([len(s.connected) - 1 for s in scenes], ranges.collaborators),
    ):
        assert low <= min(values) < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < max(values) <= high


@EVERY
def test_a_hazard_that_would_have_to_start_beyond_the_road_is_refused(scenario: Scenario):
    with pytest.raises(ValueError, match=r"ego_start=\(30.0, 150.0\).*starts more than \d+ m away"):
        scenario.configured({"ego_start": (30.0, 150.0)})


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"ranges": {"ego_sped": (7, 9)}}, "unknown left_turn range ego_sped=(7, 9): choose among collaborators, "),
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
        ({"ranges": {"hazard_share": 1.5}}, "hazard_share must be a number from 0 to 1, got 1.5"),
        ({"ranges": {"hazard_share": "half"}}, "hazard_share must be a number from 0 to 1, got 'half'"),
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
    choices = "left_turn, overtaking, street_crossing"
    with pytest.raises(ValueError, match=f"unknown scenario 'right_turn': choose among {choices}"):
        scenario_named("right_turn")
