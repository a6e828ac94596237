"""Routes are the lanes of the highway-env network, sampled; and the table that places one route on another."""

import numpy as np
import pytest
from scenes import BESIDE, EAST, LANE, NORTH, WEST, cross

from cad_env.scenarios.junction import ARM, ARMS, OUT, STOP_LINE, TURN_RADIUS
from cad_env.scenarios.left_turn import LEFT_TURN
from cad_env.scenarios.routes import SPACING
from cad_env.types import Command

MAP = LEFT_TURN.map
ROUTES, NETWORK = MAP.routes, MAP.network
NAMES = [plan.name for plan in MAP.plans]


def used(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points, headings and commands of a route, without what lies beyond its end."""
    route = MAP.route(name)
    count = int(ROUTES.length[route] / SPACING) + 1
    return ROUTES.point[route, :count], ROUTES.heading[route, :count], ROUTES.command[route, :count]


@pytest.mark.parametrize("name", NAMES)
def test_every_sample_lies_on_a_lane_of_its_plan(name: str):
    lanes = [NETWORK.get_lane(index) for index in MAP.plans[MAP.route(name)].lanes]
    for point in used(name)[0]:
        assert min(abs(lane.local_coordinates(point)[1]) for lane in lanes if lane.on_lane(point, margin=0.1)) < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_samples_are_evenly_spaced_and_headings_point_along(name: str):
    points, headings, _ = used(name)
    step = np.diff(points, axis=0)
    assert np.linalg.norm(step, axis=1) == pytest.approx(SPACING, abs=1e-3)
    middle = (headings[1:] + headings[:-1]) / 2
    assert np.abs(np.angle(np.exp(1j * (np.arctan2(step[:, 1], step[:, 0]) - middle)))).max() < 0.02
    assert np.abs(np.diff(headings)).max() < 1.1 * SPACING / TURN_RADIUS  # unwrapped: no jump of a whole turn


@pytest.mark.parametrize("arm", ARMS)
def test_a_left_turn_turns_left_by_a_right_angle_and_says_so(arm: str):
    points, headings, command = used(f"{arm}_left")
    assert headings[-1] - headings[0] == pytest.approx(np.pi / 2)
    turning = np.flatnonzero(command == Command.TURN_LEFT) * SPACING
    assert turning[0] == pytest.approx(ARM - STOP_LINE, abs=SPACING)
    assert turning[-1] == pytest.approx(ARM - STOP_LINE + np.pi / 2 * TURN_RADIUS, abs=SPACING)
    assert set(command) == {Command.FOLLOW_LANE, Command.TURN_LEFT}
    assert np.linalg.norm(points[-1]) == pytest.approx(OUT, abs=2.0)


@pytest.mark.parametrize("arm", ARMS)
def test_going_through_is_straight_and_says_so_on_the_junction(arm: str):
    points, headings, command = used(f"{arm}_through")
    assert np.ptp(headings) == 0.0
    on_junction = np.flatnonzero(command == Command.GO_STRAIGHT) * SPACING
    assert (on_junction[0], on_junction[-1]) == pytest.approx((ARM - STOP_LINE, ARM + STOP_LINE), abs=SPACING)
    assert np.linalg.norm(points[-1] - points[0]) == pytest.approx(ARM + OUT, abs=SPACING)


def test_beyond_its_end_a_route_goes_straight_on():
    for route, length in enumerate(ROUTES.length):
        last = int(length / SPACING)
        beyond = ROUTES.point[route, last:]
        ahead = np.array([np.cos(ROUTES.heading[route, last]), np.sin(ROUTES.heading[route, last])])
        assert beyond - beyond[0] == pytest.approx(np.arange(len(beyond))[:, None] * SPACING * ahead, abs=1e-9)


def test_traffic_drives_on_the_right():
    # Every approach lane lies to the right of the lane that leaves the same arm.
    for arm in ARMS:
        across = ARMS[(ARMS.index(arm) + 2) % 4]
        inbound, outbound = used(f"{arm}_through"), used(f"{across}_through")
        leftward = np.array([-np.sin(inbound[1][0]), np.cos(inbound[1][0])])
        assert (outbound[0][-1] - inbound[0][0]) @ leftward > 2 * LANE


def test_a_route_lies_on_itself():
    for route, length in enumerate(ROUTES.length):
        arc = np.arange(0.0, length, SPACING)
        placed = ROUTES.projection[route, route, : len(arc)]
        assert placed[:, 0] == pytest.approx(arc, abs=1e-6)
        assert np.abs(placed[:, 1]).max() < 1e-6


def test_a_lane_beside_is_placed_with_its_distance_to_the_left():
    placed = cross().projection[EAST, BESIDE, 100:200]
    assert placed[:, 0] == pytest.approx(np.arange(100, 200) * SPACING)
    assert placed[:, 1] == pytest.approx(LANE)
    assert cross().projection[BESIDE, EAST, 100:200, 1] == pytest.approx(-LANE)


@pytest.mark.parametrize(("own", "other"), [(EAST, WEST), (WEST, EAST), (EAST, NORTH), (NORTH, EAST)])
def test_who_comes_towards_one_or_crosses_is_not_in_one_s_stream(own: int, other: int):
    assert np.isnan(cross().projection[own, other]).all()


def test_the_hidden_lane_is_not_in_the_stream_of_the_turn_that_crosses_it():
    assert np.isnan(ROUTES.projection[MAP.route("south_left"), MAP.route("north_through")]).all()


def test_after_the_junction_a_turn_joins_the_stream_that_it_merges_into():
    # Left from the south and straight from the east leave on two lanes of the same road, west.
    placed = ROUTES.projection[MAP.route("south_left"), MAP.route("east_through")]
    along = np.flatnonzero(~np.isnan(placed[:, 0])) * SPACING
    assert along[0] > ARM - STOP_LINE
    assert along[-1] >= ROUTES.length[MAP.route("east_through")] - SPACING
    assert np.abs(placed[int((ARM + 50.0) / SPACING), 1]) == pytest.approx(LANE)
