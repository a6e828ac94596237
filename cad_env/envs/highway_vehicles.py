"""The face for highway-env: vehicles that are views on rows of the world, and a road that steps it."""

from typing import Any, NoReturn

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

from cad_env.envs.highway_base import not_served
from cad_env.types import Floats
from cad_env.world.state import OFF, Routes, World
from cad_env.world.step import substep

_EGO_COLOUR, CONNECTED_COLOUR, OTHER_COLOUR, CRASHED_COLOUR = (
    (50, 200, 0),
    (100, 200, 255),
    (200, 200, 0),
    (255, 100, 100),
)

_MOVED = "the vehicles of a scene are moved together, by road.step() and the environment's step()"
_DRAWN = "the vehicles of a scene are drawn by its scenario at reset and cannot be replaced"


class RowVehicle(Vehicle):
    """One row of the world under highway-env's names; reading and writing go straight to the arrays."""

    def __init__(self, road: "WorldRoad", row: int, colour: tuple[int, int, int]) -> None:
        # Deliberately not Vehicle.__init__: it searches all lanes for each vehicle, which would dominate a reset.
        self.road = road
        self.row = row
        self.base_colour = colour
        self.action = {"steering": 0.0, "acceleration": 0.0}
        self.impact = None
        self.log: list[Any] = []
        self.history: list[Any] = []
        self.collidable = self.solid = self.check_collisions = True
        self.hit = False

    @property
    def position(self) -> Floats:
        """(2,) m, a live view."""
        position: Floats = self.road.world.position[self.row]
        return position

    @position.setter
    def position(self, value: Floats) -> None:
        self.road.world.position[self.row] = value

    @property
    def heading(self) -> float:
        """Rad, counter-clockwise from +x."""
        return float(self.road.world.heading[self.row])

    @heading.setter
    def heading(self, value: float) -> None:
        self.road.world.heading[self.row] = value

    @property
    def speed(self) -> float:
        """m/s."""
        return float(self.road.world.speed[self.row])

    @speed.setter
    def speed(self, value: float) -> None:
        self.road.world.speed[self.row] = value

    @property
    def target_speed(self) -> float:
        """m/s the driver wants."""
        return float(self.road.world.target_speed[self.row])

    @target_speed.setter
    def target_speed(self, value: float) -> None:
        self.road.world.target_speed[self.row] = value

    @property
    def crashed(self) -> bool:
        """True once it has touched another vehicle."""
        return bool(self.road.world.struck[self.row] >= 0)

    @crashed.setter
    def crashed(self, value: bool) -> None:
        raise NotImplementedError(f"crashed cannot be set in cad_env, it follows from contact; got {value!r}")

    @property
    def LENGTH(self) -> float:  # noqa: N802  highway-env's name
        """m."""
        return float(self.road.world.size[self.row, 0])

    @property
    def WIDTH(self) -> float:  # noqa: N802  highway-env's name
        """m."""
        return float(self.road.world.size[self.row, 1])

    @property
    def diagonal(self) -> float:
        """m, corner to corner."""
        return float(np.hypot(*self.road.world.size[self.row]))

    @property
    def color(self) -> tuple[int, int, int]:
        """What stock graphics fill the box with."""
        return CRASHED_COLOUR if self.crashed else self.base_colour

    @property
    def lane_index(self) -> tuple[str, str, int]:
        """The lane nearest to the vehicle, searched when asked."""
        index: tuple[str, str, int] = self.road.network.get_closest_lane_index(self.position, self.heading)
        return index

    @property
    def lane(self) -> AbstractLane:
        """The lane nearest to the vehicle, searched when asked."""
        return self.road.network.get_lane(self.lane_index)

    def predict_trajectory_constant_speed(self, times: Floats) -> tuple[list[Floats], list[float]]:
        """Where it will be at its present speed, as highway-env's ControlledVehicle says it: along its route.

        times (n,) s from now -> n positions (2,) m and n headings, rad; it keeps its distance from the route.
        """
        world, routes = self.road.world, self.road.routes
        route, start = int(world.route[self.row]), world.progress[self.row]
        point, heading = _on_route(routes, route, np.concatenate([[start], start + self.speed * np.asarray(times)]))
        forward, left = (np.column_stack([np.cos(turn), np.sin(turn)]) for turn in (heading, heading + 0.5 * np.pi))
        away = self.position - point[0]  # also along the route: its progress is exact to some millimetres in a bend
        places = point + (away @ forward[0]) * forward + (away @ left[0]) * left
        return list(places[1:]), (heading[1:] + (self.heading - heading[0])).tolist()

    act = not_served("act()", _MOVED)
    step = not_served("step()", _MOVED)
    predict_trajectory = not_served("predict_trajectory()", _MOVED)
    clip_actions = not_served("clip_actions()", _MOVED)
    on_state_update = not_served("on_state_update()", _MOVED)
    handle_collisions = not_served("handle_collisions()", "contact is found by the world's step")
    create_random = staticmethod(not_served("create_random()", _DRAWN))
    create_from = staticmethod(not_served("create_from()", _DRAWN))
    make_on_lane = staticmethod(not_served("make_on_lane()", _DRAWN))


def _on_route(routes: Routes, route: int, progress: Floats) -> tuple[Floats, Floats]:
    """Points (n, 2) m and headings (n,) rad of a route at arc lengths (n,) m."""
    along = routes.spacing * np.arange(routes.point.shape[1])
    parts = (*routes.point[route].T, routes.heading[route])
    x, y, heading = (np.interp(progress, along, part) for part in parts)
    return np.column_stack([x, y]), heading


class FixedList(list[Any]):
    """A list that refuses to be changed: the world would not notice."""

    def __reduce__(self) -> Any:
        return type(self), (list(self),)


def _refuse_change(*_: Any, **__: Any) -> NoReturn:
    raise ValueError(_DRAWN)


for _change in (
    "append", "clear", "extend", "insert", "pop", "remove", "__delitem__", "__iadd__", "__imul__", "__setitem__",
):  # fmt: skip
    setattr(FixedList, _change, _refuse_change)


class WorldRoad(Road):
    """A highway-env road whose vehicles live in the compiled world."""

    def __init__(self, network: RoadNetwork, world: World, routes: Routes, connected: tuple[int, ...]) -> None:
        self.world, self.routes = world, routes
        self.scratch = np.zeros(len(world.speed))
        super().__init__(network=network, vehicles=[], np_random=None)
        self.objects = FixedList()  # none, and none can be put there
        colours = [OTHER_COLOUR] * len(world.speed)
        for row in connected:
            colours[row] = CONNECTED_COLOUR
        colours[connected[0]] = _EGO_COLOUR
        self.rows = [RowVehicle(self, row, colour) for row, colour in enumerate(colours)]

    @property
    def vehicles(self) -> list[RowVehicle]:
        """The vehicles that are on the map, in a list that cannot be changed."""
        return FixedList(vehicle for vehicle in self.rows if self.world.driver[vehicle.row] != OFF)

    @vehicles.setter
    def vehicles(self, value: list[RowVehicle]) -> None:
        if value:
            raise ValueError(_DRAWN)

    def act(self) -> None:
        """Nothing to do: drivers decide inside the step."""

    def step(self, dt: float) -> None:
        """Move the world by dt s."""
        substep(self.world, self.routes, self.scratch, dt)
