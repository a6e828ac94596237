"""What every scenario is made of: placements of vehicles on routes, and who of them is connected."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any

import numpy as np
from highway_env.road.road import RoadNetwork

from cad_env.chance import generator
from cad_env.config import check_names
from cad_env.roads import RoutePlan, sample_routes
from cad_env.types import CAR
from cad_env.world.state import IDM, Routes, World, empty_world

Range = tuple[float, float]


@dataclass(frozen=True)
class Placement:
    """One vehicle at the start of an episode."""

    route: int
    progress: float  # m along the route, centre of the vehicle
    speed: float  # m/s
    target_speed: float  # m/s
    driver: int = IDM
    kind: int = CAR
    length: float = 4.8  # m
    width: float = 1.9  # m
    offset: float = 0.0  # m to the left of the route
    yaw: float = 0.0  # rad, counter-clockwise from the route
    stop_at: float = math.inf  # m along the route, where a red light stops it


@dataclass(frozen=True)
class Scene:
    """The start of an episode. Row 0 is the ego; `connected` lists rows, the ego first."""

    placements: tuple[Placement, ...]
    connected: tuple[int, ...]
    hazard: bool
    hazard_row: int | None  # the vehicle that the occluder hides, if there is one
    occluder_row: int
    goal: float  # m along the ego's route, where it has arrived


@dataclass(frozen=True)
class Map:
    """A road network and its routes; built once and shared, never changed."""

    network: RoadNetwork
    routes: Routes
    plans: tuple[RoutePlan, ...]

    def route(self, name: str) -> int:
        """The row of the route called `name`."""
        return next(r for r, plan in enumerate(self.plans) if plan.name == name)


@dataclass(frozen=True)
class Scenario:
    """One occlusion story: `config` is a frozen dataclass of ranges, `draw` turns chance into a scene."""

    name: str
    gym_id: str
    config: type[Any]
    network: Callable[[], RoadNetwork]
    plans: tuple[RoutePlan, ...]
    draw: Callable[[Map, Any, np.random.Generator, bool], Scene] = field(repr=False)

    @property
    def map(self) -> Map:
        """The map of this scenario."""
        return _build_map(self)

    def configured(self, overrides: dict[str, Any]) -> Any:
        """This scenario's config with some ranges replaced; ValueError names what is wrong and what is allowed."""
        check_names(f"{self.name} parameter", overrides, [f.name for f in fields(self.config)])
        return self.config(**overrides)

    def scene(self, config: Any, seed: int, hazard: bool | None = None) -> Scene:
        """The scene of an episode seed; `hazard` forces its kind, and leaves the rest of the traffic as it is drawn."""
        rng = generator(seed, "traffic")
        drawn = bool(rng.random() < config.hazard_share)
        return self.draw(self.map, config, rng, drawn if hazard is None else hazard)


@cache
def _build_map(scenario: Scenario) -> Map:
    network = scenario.network()
    return Map(network, sample_routes(network, scenario.plans), scenario.plans)


def place(scene: Scene, routes: Routes) -> World:
    """A world with the vehicles of a scene in it."""
    world = empty_world(len(scene.placements))
    for row, vehicle in enumerate(scene.placements):
        whole = int(vehicle.progress / routes.spacing)
        rest = vehicle.progress - whole * routes.spacing
        along = routes.heading[vehicle.route, whole]
        cos, sin = math.cos(along), math.sin(along)
        start = routes.point[vehicle.route, whole]
        world.position[row, 0] = start[0] + rest * cos - vehicle.offset * sin
        world.position[row, 1] = start[1] + rest * sin + vehicle.offset * cos
        world.heading[row] = along + vehicle.yaw
        world.speed[row] = vehicle.speed
        world.size[row] = vehicle.length, vehicle.width
        world.kind[row] = vehicle.kind
        world.driver[row] = vehicle.driver
        world.route[row] = vehicle.route
        world.progress[row] = vehicle.progress
        world.target_speed[row] = vehicle.target_speed
        world.stop_at[row] = vehicle.stop_at
    return world


def check_span(name: str, span: Any, low: float, high: float) -> None:
    """Refuse anything but an ordered pair of numbers within [low, high] with a one-line ValueError."""
    ordered = (
        isinstance(span, tuple | list)
        and len(span) == 2
        and all(isinstance(end, int | float) and not isinstance(end, bool) for end in span)
        and low <= span[0] <= span[1] <= high
    )
    if not ordered:
        raise ValueError(f"{name} must be a pair (from, to) within [{low:g}, {high:g}], got {span!r}")
