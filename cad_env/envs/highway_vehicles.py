"""The face for highway-env: vehicles that are views on rows of the world, and a road that steps it."""

from typing import Any

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

from cad_env.types import Floats
from cad_env.world.state import OFF, Routes, World
from cad_env.world.step import substep

_EGO_COLOUR, CONNECTED_COLOUR, OTHER_COLOUR, CRASHED_COLOUR = (
    (50, 200, 0),
    (100, 200, 255),
    (200, 200, 0),
    (255, 100, 100),
)


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


class WorldRoad(Road):
    """A highway-env road whose vehicles live in the compiled world."""

    def __init__(self, network: RoadNetwork, world: World, routes: Routes, connected: tuple[int, ...]) -> None:
        self.world, self.routes = world, routes
        self.scratch = np.zeros(len(world.speed))
        super().__init__(network=network, vehicles=[], np_random=None)
        colours = [OTHER_COLOUR] * len(world.speed)
        for row in connected:
            colours[row] = CONNECTED_COLOUR
        colours[connected[0]] = _EGO_COLOUR
        self.rows = [RowVehicle(self, row, colour) for row, colour in enumerate(colours)]

    @property
    def vehicles(self) -> list[RowVehicle]:
        """The vehicles that are on the map."""
        return [vehicle for vehicle in self.rows if self.world.driver[vehicle.row] != OFF]

    @vehicles.setter
    def vehicles(self, value: list[RowVehicle]) -> None:
        if value:
            raise ValueError("the vehicles of a scene are drawn by its scenario at reset and cannot be replaced")

    def act(self) -> None:
        """Nothing to do: drivers decide inside the step."""

    def step(self, dt: float) -> None:
        """Move the world by dt s."""
        substep(self.world, self.routes, self.scratch, dt)
