"""The left turn's own story: a truck opposite, and a vehicle that comes down the lane beside it."""

import numpy as np
import pytest

from cad_env.scenarios.left_turn import LEFT_TURN, LEFT_TURN_LINE, LeftTurnRanges
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import EGO, HIDDEN, OCCLUDER, Scene
from cad_env.scenarios.vehicles import unbraked_time
from cad_env.world.state import OFF

RANGES = LeftTurnRanges()
WAYS = LEFT_TURN.map.routes


def drawn(seed: int, **ranges) -> Scene:
    return LEFT_TURN.scene(LEFT_TURN.configured(ranges), Traffic(), seed)


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [drawn(seed) for seed in range(200)]


def test_everything_is_drawn_within_its_range(scenes):
    for scene in scenes:
        ego, truck = scene.placements[EGO], scene.placements[OCCLUDER]
        measured = {
            "ego_speed": ego.target_speed,
            "ego_start": LEFT_TURN_LINE - ego.progress,
            "truck_length": truck.length,
            "truck_width": truck.width,
            "truck_front": 250.0 - truck.progress - truck.length / 2,
            "truck_yaw": truck.yaw,
            "collider_speed": scene.placements[HIDDEN].speed,
        }
        for name, value in measured.items():
            low, high = getattr(RANGES, name)
            assert low - 1e-9 <= value <= high + 1e-9, name


def test_the_truck_waits_in_the_opposite_left_turn_lane(scenes):
    assert {scene.placements[OCCLUDER].route for scene in scenes} == {LEFT_TURN.map.route("north_left")}
    assert {scene.placements[EGO].route for scene in scenes} == {LEFT_TURN.map.route("south_left")}


def arrival_after_the_ego(scene: Scene) -> float:
    """s from the moment an unbraked ego is at the conflict point to when the vehicle of the hidden lane is there."""
    ego, other = scene.placements[EGO], scene.placements[HIDDEN]
    way = WAYS.point[ego.route]
    crossing = np.flatnonzero(way[:, 0] <= WAYS.point[other.route, 0, 0])[0] * WAYS.spacing
    distance = WAYS.point[other.route, 0, 1] - way[int(crossing / WAYS.spacing), 1] - other.progress
    return distance / other.speed - unbraked_time(ego.speed, ego.target_speed, crossing - ego.progress)


def test_a_hazard_meets_an_unbraked_ego_and_others_pass_clearly_before_or_after(scenes):
    kinds = set()
    for scene in scenes:
        if scene.placements[HIDDEN].driver == OFF:
            assert scene.timing is None
            assert not scene.hazard
            continue
        late = arrival_after_the_ego(scene)
        if scene.placements[HIDDEN].progress > 1.0:  # else it starts at the road's end, and passes earlier
            assert late == pytest.approx(scene.timing, abs=0.15)
        if scene.hazard:
            assert -0.4 < late < 0.4
        else:
            kinds.add(late > 0)
            assert -7.1 < late < -3.9 or 2.9 < late < 6.1
    assert kinds == {True, False}


def test_a_vehicle_that_passed_long_ago_is_at_the_end_of_its_road():
    for seed in range(30):
        scene = drawn(seed, early=(30.0, 30.0), hazard_share=0.0)
        assert all(0.0 < vehicle.progress < 500.0 for vehicle in scene.placements)
