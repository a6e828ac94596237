"""A free vehicle moves as highway-env's own does on the same lanes."""

import numpy as np
import pytest
from highway_env.road.road import Road
from highway_env.vehicle.behavior import ControlledVehicle
from highway_env.vehicle.controller import MDPVehicle

from cad_env.scenarios.left_turn import LEFT_TURN, LEFT_TURN_LINE
from cad_env.scenarios.scene import Placement, place
from cad_env.world.dynamics import place_on_route, wrapped
from cad_env.world.state import SCRIPTED
from cad_env.world.step import SUBSTEP, substep

NAMES = [plan.name for plan in LEFT_TURN.plans]
STRAIGHTS, TURNS = [n for n in NAMES if "through" in n], [n for n in NAMES if "left" in n]
START = LEFT_TURN_LINE - 88.0  # m along the route


def theirs(name: str, speed: float, kind: type[ControlledVehicle], seconds: float) -> np.ndarray:
    """(n, 2) positions, m, of highway-env's vehicle at 20 Hz."""
    plan = LEFT_TURN.plans[LEFT_TURN.map.route(name)]
    road = Road(LEFT_TURN.map.network, vehicles=[], np_random=np.random.RandomState(0))
    lane = road.network.get_lane(plan.lanes[0])
    vehicle = kind(
        road, lane.position(START, 0.0), lane.heading_at(START), speed, plan.lanes[0], speed, route=list(plan.lanes),
        **({"target_speeds": np.array([speed, 2.0 * speed])} if kind is MDPVehicle else {}),
    )  # fmt: skip
    road.vehicles.append(vehicle)
    path = []
    for _ in range(round(seconds / SUBSTEP)):
        road.act()
        road.step(SUBSTEP)
        path.append(vehicle.position.copy())
    return np.array(path)


def ours(name: str, speed: float, seconds: float) -> np.ndarray:
    """(n, 2) positions, m, of ours."""
    routes = LEFT_TURN.map.routes
    vehicle = Placement(LEFT_TURN.map.route(name), START, speed, speed, SCRIPTED, length=5.0, width=2.0)
    world = place([vehicle], routes)
    path, scratch = [], np.zeros(1)
    for _ in range(round(seconds / SUBSTEP)):
        substep(world, routes, scratch, SUBSTEP)
        path.append(world.position[0].copy())
    return np.array(path)


def apart(name: str, speed: float, kind: type[ControlledVehicle]) -> float:
    seconds = min(170.0 / speed, 30.0)
    there, here = theirs(name, speed, kind, seconds), ours(name, speed, seconds)
    return float(np.linalg.norm(there - here, axis=1).max())


@pytest.mark.parametrize("kind", [ControlledVehicle, MDPVehicle])
@pytest.mark.parametrize("name", STRAIGHTS)
def test_on_a_straight_it_is_where_theirs_is(name: str, kind: type[ControlledVehicle]):
    assert max(apart(name, speed, kind) for speed in (5.0, 10.0, 18.0)) < 0.0005


@pytest.mark.parametrize("kind", [ControlledVehicle, MDPVehicle])
@pytest.mark.parametrize("name", TURNS)
def test_in_a_turn_it_is_within_20_cm_of_theirs(name: str, kind: type[ControlledVehicle]):
    # Theirs steers towards the next lane 2.5 m before the end of its own, and so cuts corners.
    assert max(apart(name, speed, kind) for speed in (5.0, 7.0, 9.0)) < 0.2


@pytest.mark.parametrize("name", TURNS)
def test_in_a_turn_it_stays_in_its_lane(name: str):
    routes, route = LEFT_TURN.map.routes, LEFT_TURN.map.route(name)
    path = ours(name, 8.0, 20.0)
    aside = [
        abs(place_on_route(routes, route, x, y, START + 8.0 * SUBSTEP * (k + 1))[1]) for k, (x, y) in enumerate(path)
    ]
    assert max(aside) < (3.5 - 2.0) / 2


def test_it_returns_to_its_lane_after_a_push():
    routes = LEFT_TURN.map.routes
    vehicle = Placement(LEFT_TURN.map.route("south_through"), 50.0, 10.0, 10.0, SCRIPTED, offset=1.0, yaw=0.1)
    world = place([vehicle], routes)
    for _ in range(200):
        substep(world, routes, np.zeros(1), SUBSTEP)
    _, lateral = place_on_route(routes, int(world.route[0]), *world.position[0], world.progress[0])
    assert abs(lateral) < 0.01
    assert world.progress[0] == pytest.approx(150.0, abs=0.5)


@pytest.mark.parametrize("turns", range(-3, 4))
def test_angles_wrap(turns: int):
    assert wrapped(0.3 + 2 * np.pi * turns) == pytest.approx(0.3)
    assert wrapped(-3.0 + 2 * np.pi * turns) == pytest.approx(-3.0)
