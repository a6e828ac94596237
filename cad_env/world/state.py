"""The state of the world as arrays, one row a vehicle, and the map as sampled routes."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cad_env.types import Bools, Floats, Ints

# Who drives a row. A connected vehicle is an IDM driver whose GO/BRAKE command comes from outside (`command`).
# SCRIPTED keeps its speed whatever comes; STREAM too, however near the vehicle before it is, unless that one is slower.
# YIELDING is an IDM driver that gives way at its line, where the map has one (see `world.priority`).
OFF, STANDING, SCRIPTED, IDM, STREAM, YIELDING = 0, 1, 2, 3, 4, 5

# An actuation delay of two decisions (0.2 s): a brake does not bite in the frame that asks for it.
COMMAND_DELAY = 2


class Routes(NamedTuple):
    """Every route of a map, sampled at one spacing so that an arc length is an index.

    `projection[a, b, p]` places sample p of route b on route a as (arc length, lateral offset to the left);
    NaN where b does not run along a there (farther than a vehicle's width, or headed elsewhere).
    """

    spacing: float  # m
    length: Floats  # (R,) m
    point: Floats  # (R, P, 2) m; samples beyond the length repeat the end, straight on
    heading: Floats  # (R, P) rad, unwrapped along the route
    command: Ints  # (R, P) int8 Command
    oncoming: Ints  # (R, P) int8 1 where a car that follows the route is in a lane of oncoming traffic
    projection: Floats  # (R, R, P, 2) m
    line: Floats  # (R,) m along it, where whoever gives way waits; inf where nobody ever does
    meets: Floats  # (R, R, 4) m: from where to where a has b in its way, then b a, each along its own; NaN: nowhere
    yields: Ints  # (R, R) int8 1 where whoever is on a lets pass who is on b


class World(NamedTuple):
    """N vehicles. Rows stay put for a whole episode; a vehicle that leaves the map turns OFF."""

    position: Floats  # (N, 2) m
    heading: Floats  # (N,) rad
    speed: Floats  # (N,) m/s, never negative
    acceleration: Floats  # (N,) m/s2, what was applied last
    size: Floats  # (N, 2) m length, width
    kind: Ints  # (N,) int8 CAR or TRUCK
    driver: Ints  # (N,) int8 OFF, STANDING, SCRIPTED, IDM, STREAM or YIELDING
    route: Ints  # (N,) int64
    progress: Floats  # (N,) m along the route
    target_speed: Floats  # (N,) m/s
    stop_at: Floats  # (N,) m along the route, the line where a red light stops the vehicle; inf for none
    late_braking: Floats  # (N,) m/s2 that stopping at the line must take before the vehicle begins to; 0: in good time
    attention: Floats  # (N,) s from when another is across its way until its driver reacts; inf: never
    noticed: Floats  # (N,) s for which another has been across its way
    command: Ints  # (N, COMMAND_DELAY + 1) int8 GO or BRAKE; column 0 is in force, the last is the newest
    struck: Ints  # (N,) int64 row of the first vehicle it touched, -1 for none


def empty_routes() -> Routes:
    """A map without routes."""
    samples = (0, 0)
    return Routes(
        0.0, np.zeros(0), np.zeros((*samples, 2)), np.zeros(samples), np.zeros(samples, np.int8),
        np.zeros(samples, np.int8), np.zeros((0, *samples, 2)), np.zeros(0), np.zeros((*samples, 4)),
        np.zeros(samples, np.int8),
    )  # fmt: skip


def empty_world(count: int) -> World:
    """`count` vehicles, all OFF."""
    return World(
        position=np.zeros((count, 2)),
        heading=np.zeros(count),
        speed=np.zeros(count),
        acceleration=np.zeros(count),
        size=np.zeros((count, 2)),
        kind=np.zeros(count, np.int8),
        driver=np.zeros(count, np.int8),
        route=np.zeros(count, np.int64),
        progress=np.zeros(count),
        target_speed=np.zeros(count),
        stop_at=np.full(count, np.inf),
        late_braking=np.zeros(count),
        attention=np.full(count, np.inf),
        noticed=np.zeros(count),
        command=np.zeros((count, COMMAND_DELAY + 1), np.int8),
        struck=np.full(count, -1, np.int64),
    )


def indices_on_map(world: World, rows: Ints) -> list[int]:
    """The indices into `rows` of the vehicles that have not left the map."""
    return [index for index, driver in enumerate(world.driver[rows].tolist()) if driver != OFF]


def crashed(world: World) -> Bools:
    """(N,) True for every vehicle that has touched another."""
    return world.struck >= 0


@dataclass(frozen=True)
class Truth:
    """What a privileged policy is given: the world itself, and which row it drives."""

    world: World
    routes: Routes
    row: int
