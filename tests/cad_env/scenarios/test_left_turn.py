"""The left turn's own story: trucks opposite, and a stream that comes down the lane beside them."""

import numpy as np
import pytest
from scenes import started, steps

from cad_env.scenarios.junction import ARM
from cad_env.scenarios.left_turn import LEFT_TURN, LEFT_TURN_LINE, LeftTurnRanges
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import EGO, OCCLUDER, Scene
from cad_env.types import TRUCK
from cad_env.world.state import STANDING

RANGES = LeftTurnRanges()
SECOND_TRUCK = 4


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [LEFT_TURN.scene(RANGES, Traffic(), seed) for seed in range(200)]


def test_everything_is_drawn_within_its_range(scenes):
    for scene in scenes:
        ego, truck = scene.placements[EGO], scene.placements[OCCLUDER]
        measured = {
            "ego_speed": [ego.target_speed],
            "ego_start": [LEFT_TURN_LINE - ego.progress],
            "truck_length": [truck.length, scene.placements[SECOND_TRUCK].length],
            "truck_width": [truck.width, scene.placements[SECOND_TRUCK].width],
            "truck_front": [ARM - truck.progress - truck.length / 2],
            "truck_yaw": [truck.yaw],
            "stream_speed": [scene.placements[row].speed for row in scene.hidden],
        }
        for name, values in measured.items():
            low, high = getattr(RANGES, name)
            assert all(low - 1e-9 <= value <= high + 1e-9 for value in values), name


def test_two_trucks_wait_in_the_opposite_left_turn_lane_one_close_behind_the_other(scenes):
    opposite = LEFT_TURN.map.route("north_left")
    for scene in scenes:
        first, second = scene.placements[OCCLUDER], scene.placements[SECOND_TRUCK]
        for truck in (first, second):
            assert (truck.route, truck.kind, truck.driver) == (opposite, TRUCK, STANDING)
        assert 2.0 <= first.rear - second.progress - 0.5 * second.length <= 3.5
        assert scene.placements[EGO].route == LEFT_TURN.map.route("south_left")


def test_the_stream_comes_down_the_lane_beside_the_trucks(scenes):
    lane = LEFT_TURN.map.route("north_through")
    assert {scene.placements[row].route for scene in scenes for row in scene.hidden} == {lane}
    assert sum(not scene.hidden for scene in scenes) > 2  # and sometimes nobody does


@pytest.mark.parametrize("hazard", [True, False])
def test_who_follows_the_ego_waits_at_the_line_and_never_turns_into_the_stream(hazard: bool):
    route, followers = LEFT_TURN.map.route("south_left"), 0
    for seed in range(12):
        simulation = started(seed, hazard, scenario="left_turn", traffic="dense")
        placed, world = simulation.scene.placements, simulation.world
        rows = [row for row in range(1, len(placed)) if placed[row].route == route and placed[row].stop_at < np.inf]
        assert all(placed[row].progress < placed[EGO].progress for row in rows)
        for _ in steps(simulation):
            pass
        followers += len(rows)
        assert all(world.progress[row] + 0.5 * placed[row].length < LEFT_TURN_LINE + 0.1 for row in rows)
    assert followers > 12
