"""The start of an episode: placements of vehicles on routes, and who of them is connected."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cad_env.types import CAR
from cad_env.world.state import IDM, Routes, World, empty_world

EGO, OCCLUDER = 0, 1  # the first of the actors of every scene


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
    late_braking: float = 0.0  # m/s2 that stopping there must take before it begins to; 0: in good time
    attention: float = math.inf  # s from when another is across its way until its driver reacts; inf: never
    bystander: bool = False  # True: sees nothing that matters; connected only as penetration has it

    @property
    def rear(self) -> float:
        """m along the route, where it ends."""
        return self.progress - 0.5 * self.length


@dataclass(frozen=True)
class Actors:
    """Who tells the story: the ego, the occluder, others with a view, and the stream that is hidden from the ego."""

    vehicles: tuple[Placement, ...]
    witnesses: tuple[int, ...]  # rows that see what the occluder hides; one of them is always connected
    goal: float  # m along the ego's route, where it has arrived
    hidden: tuple[int, ...]  # rows of the hidden stream, which may be empty; never connected
    peers: tuple[int, ...] = ()  # rows that have to agree with the ego who goes first; connected before anybody else


@dataclass(frozen=True)
class Scene:
    """The start of an episode. Row 0 is the ego; `connected` lists rows, the ego first."""

    placements: tuple[Placement, ...]
    connected: tuple[int, ...]
    hazard: bool  # an ego that never brakes would be hit
    hazard_row: int  # by this vehicle; -1 where there is no hazard
    hazard_time: float  # s after the start; inf where there is no hazard
    occluder_row: int
    goal: float  # m along the ego's route, where it has arrived
    hidden: tuple[int, ...] = ()  # rows of the stream that the occluder hides
    draws: int = 1  # how often the actors were drawn until they were of the kind that was asked for


def connected_rows(
    placements: Sequence[Placement], actors: Actors, collaborators: tuple[int, int], rng: np.random.Generator
) -> tuple[int, ...]:
    """The ego, its peers, a witness and others, as many as `collaborators` says.

    The hidden stream is never connected: it would give itself away.
    """
    witness, never = int(rng.choice(np.array(actors.witnesses))), {EGO, *actors.hidden}
    order = [witness, *(row for row in rng.permutation(len(placements)).tolist() if row not in never | {witness})]
    useful = sorted((row for row in order if not placements[row].bystander), key=lambda row: row not in actors.peers)
    wanted = int(rng.integers(*collaborators, endpoint=True))
    return (EGO, *sorted(useful[:wanted]))


def rows_at_penetration(vehicles: int, actors: Actors, penetration: float, rng: np.random.Generator) -> tuple[int, ...]:
    """The ego, and each other vehicle but the hidden ones by a draw of its own with that probability.

    The draw of a row depends on no other: more penetration, or more traffic behind the rows, only adds vehicles.
    """
    drawn = rng.random(vehicles) < penetration
    return (EGO, *(row for row in np.flatnonzero(drawn).tolist() if row not in (EGO, *actors.hidden)))


def place(placements: Sequence[Placement], routes: Routes) -> World:
    """A world with these vehicles in it."""
    world = empty_world(len(placements))
    for row, vehicle in enumerate(placements):
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
        world.late_braking[row] = vehicle.late_braking
        world.attention[row] = vehicle.attention
    return world
