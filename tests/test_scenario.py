"""The left turn as it is drawn: ranges, hazards, who is connected, and traffic that does not crash by itself."""

import math
import re
from dataclasses import fields

import numpy as np
import pytest
from scenes import Steady, started

from cad_env.env import CADEnv
from cad_env.planner import Expert
from cad_env.rollout import rollout
from cad_env.scenarios import SCENARIOS, scenario_named
from cad_env.scenarios.left_turn import LEFT_TURN, LINE, LeftTurnConfig, unbraked_time
from cad_env.scenarios.scene import Scene, place
from cad_env.simulation import Simulation, setup_from
from cad_env.types import BRAKE, CAR, GO, TRUCK
from cad_env.world.state import IDM, SCRIPTED, STANDING
from cad_env.world.step import advance, note_contacts

CONFIG = LeftTurnConfig()
SEEDS = range(300)
WAYS = LEFT_TURN.map.routes


def drawn(seed: int, hazard: bool | None = None, **ranges) -> Scene:
    return LEFT_TURN.scene(LEFT_TURN.configured(ranges), seed, hazard)


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [drawn(seed) for seed in SEEDS]


def test_the_same_seed_draws_the_same_scene_and_another_seed_another(scenes):
    assert [drawn(seed) for seed in SEEDS[:50]] == scenes[:50]
    assert len({scene.placements for scene in scenes}) == len(scenes)


def test_half_of_the_scenes_have_a_hazard(scenes):
    hazards = sum(scene.hazard for scene in scenes)
    assert abs(hazards - 150) < 5 * math.sqrt(300 / 4)
    assert not any(drawn(seed, hazard_share=0.0).hazard for seed in SEEDS[:20])
    assert all(drawn(seed, hazard_share=1.0).hazard for seed in SEEDS[:20])


def test_forcing_the_hazard_leaves_all_others_as_they_are():
    absent = 0
    for seed in SEEDS[:100]:
        with_hazard, without = drawn(seed, True), drawn(seed, False)
        assert (with_hazard.hazard, without.hazard) == (True, False)
        others = [p for row, p in enumerate(with_hazard.placements) if row != with_hazard.hazard_row]
        assert others == [p for row, p in enumerate(without.placements) if row != without.hazard_row]
        absent += without.hazard_row is None
        assert drawn(seed) in (with_hazard, without)
    assert 15 < absent < 55  # absent, early and late are equally likely


def test_everything_is_drawn_within_its_range(scenes):
    for scene in scenes:
        ego, truck = scene.placements[0], scene.placements[scene.occluder_row]
        measured = {
            "ego_speed": ego.target_speed,
            "ego_start": LINE - ego.progress,
            "truck_length": truck.length,
            "truck_width": truck.width,
            "truck_front": 250.0 - truck.progress - truck.length / 2,
            "truck_yaw": truck.yaw,
            "others": len(scene.placements) - 2 - (scene.hazard_row is not None),
            "collaborators": len(scene.connected) - 1,
        }
        if scene.hazard_row is not None:
            measured["collider_speed"] = scene.placements[scene.hazard_row].speed
        for name, value in measured.items():
            low, high = getattr(CONFIG, name)
            assert low - 1e-9 <= value <= high + 1e-9, name


def test_the_ranges_are_used_to_their_ends(scenes):
    # The ends of a range are what an override moves: values near both must occur.
    truck = [scene.placements[scene.occluder_row] for scene in scenes]
    for values, (low, high) in (
        ([t.length for t in truck], CONFIG.truck_length),
        ([t.yaw for t in truck], CONFIG.truck_yaw),
        ([s.placements[0].target_speed for s in scenes], CONFIG.ego_speed),
        ([LINE - s.placements[0].progress for s in scenes], CONFIG.ego_start),
        ([len(s.connected) - 1 for s in scenes], CONFIG.collaborators),
    ):
        assert min(values) < low + 0.05 * (high - low)
        assert max(values) > high - 0.05 * (high - low)


def arrival_after_the_ego(scene: Scene) -> float:
    """s from the moment an unbraked ego is at the conflict point to when the vehicle of the hidden lane is there."""
    ego, other = scene.placements[0], scene.placements[scene.hazard_row]
    way = WAYS.point[ego.route]
    crossing = np.flatnonzero(way[:, 0] <= WAYS.point[other.route, 0, 0])[0] * WAYS.spacing
    distance = WAYS.point[other.route, 0, 1] - way[int(crossing / WAYS.spacing), 1] - other.progress
    return distance / other.speed - unbraked_time(ego.speed, ego.target_speed, crossing - ego.progress)


def test_a_hazard_meets_an_unbraked_ego_and_others_pass_clearly_before_or_after(scenes):
    kinds = set()
    for scene in scenes:
        if scene.hazard_row is None:
            assert not scene.hazard
            continue
        late = arrival_after_the_ego(scene)
        if scene.hazard:
            assert -0.4 < late < 0.4
        else:
            kinds.add(late > 0)
            assert -7.1 < late < -3.9 or 2.9 < late < 6.1
        assert scene.placements[scene.hazard_row].driver == SCRIPTED
    assert kinds == {True, False}


def test_the_ego_is_the_first_of_at_least_three_connected_vehicles(scenes):
    for scene in scenes:
        assert scene.connected[0] == 0
        assert 3 <= len(scene.connected) <= 5
        assert len(set(scene.connected)) == len(scene.connected)
        assert scene.hazard_row not in scene.connected
        assert scene.placements[0].route == LEFT_TURN.map.route("south_left")


def test_a_standing_truck_waits_in_the_opposite_left_turn_lane(scenes):
    for scene in scenes:
        truck = scene.placements[scene.occluder_row]
        assert (truck.kind, truck.driver, truck.speed) == (TRUCK, STANDING, 0.0)
        assert truck.route == LEFT_TURN.map.route("north_left")
        rest = [p for row, p in enumerate(scene.placements) if row != scene.occluder_row]
        assert {p.kind for p in rest} == {CAR}


def test_at_least_four_further_vehicles_drive_by_idm(scenes):
    for scene in scenes:
        further = scene.placements[2 + (scene.hazard_row is not None) :]
        assert 4 <= len(further) <= 10
        assert {vehicle.driver for vehicle in further} == {IDM}


def test_nobody_touches_anybody_at_the_start(scenes):
    for scene in scenes:
        world = place(scene, WAYS)
        note_contacts(world)
        assert (world.struck < 0).all()


def test_a_connected_vehicle_sees_what_the_truck_hides_from_the_ego():
    hidden, shown = 0, 0
    for seed in range(40):
        simulation = started(seed, hazard=True)
        row, ego_blind, somebody = simulation.scene.hazard_row, 0, 0
        for _ in range(40):
            if simulation.outcome() is not None:
                break
            visible = simulation.fleet.visible[:, row]
            ego_blind += not visible[0]
            somebody += visible[1:].any() and not visible[0]
            simulation.step(np.zeros(len(simulation.agents), np.int64))
        hidden += ego_blind >= 20
        shown += somebody >= 10
    assert hidden >= 36
    assert shown >= 36


def contacts_among_others(seed: int, ego_brakes: bool) -> int:
    """How many vehicles other than the ego were touched, in 30 s in which it stands, or comes to stand where it is."""
    simulation = started(seed)
    world = simulation.world
    if not ego_brakes:
        world.driver[0], world.speed[0] = STANDING, 0.0
    actions = np.zeros(len(simulation.agents), np.int64)
    actions[0] = BRAKE
    scratch = np.zeros(len(world.speed))
    for _ in range(300):
        advance(world, WAYS, simulation.agents, actions, scratch)
    return int((world.struck[1:] >= 0).sum())


@pytest.mark.parametrize("ego_brakes", [False, True])
def test_traffic_does_not_crash_by_itself(ego_brakes: bool):
    assert sum(contacts_among_others(seed, ego_brakes) for seed in range(1_000_000, 1_000_100)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("ego_brakes", [False, True])
def test_traffic_does_not_crash_by_itself_in_2000_episodes(ego_brakes: bool):
    assert sum(contacts_among_others(seed, ego_brakes) for seed in range(1_000_000, 1_002_000)) == 0


@pytest.fixture(scope="module")
def env() -> CADEnv:
    return CADEnv(radio="none")


def test_never_braking_collides_in_a_hazard_and_not_without_one(env: CADEnv):
    seeds = range(1_000_000, 1_000_040)
    collided = sum(rollout(env, Steady(GO), seed, hazard=True).outcome == "collision" for seed in seeds)
    assert collided >= 38
    arrived = sum(rollout(env, Steady(GO), seed, hazard=False).outcome == "success" for seed in seeds)
    assert arrived >= 38


def test_the_expert_arrives_with_and_without_a_hazard(env: CADEnv):
    for hazard in (True, False):
        outcomes = [rollout(env, Expert(), seed, hazard=hazard).outcome for seed in range(1_000_000, 1_000_040)]
        assert outcomes == ["success"] * 40


def test_an_ego_that_stands_runs_out_of_time(env: CADEnv):
    episode = rollout(env, Steady(BRAKE), 3)
    assert episode.outcome == "timeout"
    assert len(episode.action) == 300
    assert episode.time == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("ranges", "complaint"),
    [
        ({"ego_sped": (7, 9)}, "unknown left_turn parameter ego_sped=(7, 9): choose among collaborators, "),
        ({"ego_speed": (9, 7)}, "ego_speed must be a pair (from, to) within [1, 20], got (9, 7)"),
        ({"ego_speed": (7, 99)}, "within [1, 20], got (7, 99)"),
        ({"ego_speed": 7}, "ego_speed must be a pair"),
        ({"ego_speed": (7,)}, "got (7,)"),
        ({"ego_speed": ("7", "9")}, "got ('7', '9')"),
        ({"ego_speed": (math.nan, 9.0)}, "got (nan, 9.0)"),
        ({"ego_speed": (True, 9.0)}, "got (True, 9.0)"),
        ({"truck_yaw": (-0.1, 0.1)}, "truck_yaw must be a pair (from, to) within [0, 0.2]"),
        ({"others": (3, 8)}, "others must be a pair (from, to) within [4, 10], got (3, 8)"),
        ({"others": (4.5, 8)}, "others must be a pair of whole numbers, got (4.5, 8)"),
        ({"collaborators": (1, 2)}, "collaborators must be a pair (from, to) within [2, 4], got (1, 2)"),
        ({"hazard_share": 1.5}, "hazard_share must be a number from 0 to 1, got 1.5"),
        ({"hazard_share": "half"}, "hazard_share must be a number from 0 to 1, got 'half'"),
    ],
)
def test_a_misspelt_or_impossible_range_is_refused_by_name_value_and_choices(ranges, complaint):
    with pytest.raises(ValueError, match=re.escape(complaint)) as refusal:
        Simulation(setup_from({"traffic": ranges}))
    assert "\n" not in str(refusal.value)


def test_an_override_narrows_what_is_drawn():
    for seed in range(20):
        scene = drawn(seed, ego_speed=(8.0, 8.0), collaborators=(4, 4), truck_length=(12.0, 12.5))
        assert scene.placements[0].target_speed == 8.0
        assert 12.0 <= scene.placements[1].length <= 12.5
        assert len(scene.connected) == 5


def test_every_range_can_be_set_to_its_own_default():
    same = {field.name: getattr(CONFIG, field.name) for field in fields(CONFIG)}
    assert LEFT_TURN.configured(same) == CONFIG


def test_an_unknown_scenario_is_refused_with_the_choices():
    with pytest.raises(ValueError, match="unknown scenario 'right_turn': choose among left_turn"):
        scenario_named("right_turn")
    assert list(SCENARIOS) == ["left_turn"]


def test_a_hazard_that_would_have_to_start_beyond_the_road_is_refused():
    with pytest.raises(ValueError, match=r"ego_start=\(5.0, 150.0\).*starts more than 250 m away"):
        LEFT_TURN.configured({"ego_start": (5.0, 150.0)})


def test_a_vehicle_that_passed_long_ago_is_at_the_end_of_its_road():
    for seed in range(30):
        scene = drawn(seed, early=(30.0, 30.0), hazard_share=0.0)
        assert all(0.0 < vehicle.progress < 500.0 for vehicle in scene.placements)
