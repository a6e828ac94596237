"""Where connected vehicles are going: a place on the route of each that drives, nowhere for each that has to wait.

A vehicle *waits* if it cannot get through, whatever it decides: it is parked, a light is red for it (lights do not
change within an episode), or a vehicle that waits is in its way. Standing there is all that is asked of it: it has no
goal and no time limit, and nothing to lose but a collision.
"""

from typing import NamedTuple

import numpy as np

from cad_env.types import Bools, Command, Floats, Ints
from cad_env.world.drivers import SIDE_MARGIN
from cad_env.world.state import OFF, STANDING, Routes, World

_BEYOND = 25.0  # m past its manoeuvre, or past the ego's way, where a vehicle other than the ego has arrived
NEAR = 8.0  # m from the ego's way, within which the two have to do with each other
WITHIN = 20.0  # s at the speed it wants: no goal is farther away, so that 30 s are enough for an undisturbed vehicle


class Goals(NamedTuple):
    """The goal of each of V connected vehicles."""

    progress: Floats  # (V,) m along its own route, where it has arrived; inf for a vehicle that waits
    waits: Bools  # (V,)


def goals(world: World, routes: Routes, agents: Ints, ego_goal: float) -> Goals:
    """The goals at the start of an episode. agents (V,): rows of the world, the ego's (row 0) among them."""
    waiting = who_waits(world, routes)
    way = _way(world, routes, 0, ego_goal)
    places = [ego_goal if row == 0 else _goal(world, routes, int(row), way) for row in agents]
    waits = waiting[agents]
    return Goals(np.where(waits, np.inf, np.array(places)), waits)


def who_waits(world: World, routes: Routes) -> Bools:
    """(N,) True for every vehicle that stands, faces a red light, or is behind one that does; never for the ego."""
    waits: Bools = (world.driver == STANDING) | np.isfinite(world.stop_at)
    blocks = _in_the_way(world, routes)
    blocks[0] = waits[0] = False
    while (more := ~waits & (blocks & waits).any(axis=1)).any():
        waits |= more
    return waits


def _in_the_way(world: World, routes: Routes) -> Bools:
    """(N, N) True where vehicle j is ahead on vehicle i's route, as in `world.drivers.gap_to_leader` but farther."""
    sample = np.clip((world.progress / routes.spacing + 0.5).astype(np.int64), 0, routes.projection.shape[2] - 1)
    place = routes.projection[world.route[:, None], world.route[None, :], sample[None, :]]
    ahead = place[..., 0] + (world.progress - sample * routes.spacing)[None, :] - world.progress[:, None]
    width, side = world.size[:, 1], place[..., 1] + _beside_route(world, routes, sample)[None, :]
    beside = np.abs(side) > 0.5 * (width[:, None] + width[None, :]) + SIDE_MARGIN
    # Not NaN either, which says that j's route does not run along i's there.
    near = (ahead > 0.0) & (ahead < WITHIN * world.target_speed[:, None])
    blocks: Bools = near & ~beside & (world.driver != OFF)[None, :]
    return blocks


def _beside_route(world: World, routes: Routes, sample: Ints) -> Floats:
    """(N,) m to the left of its route that each vehicle is, by the sample of the route nearest to it."""
    off = world.position - routes.point[world.route, sample]
    heading = routes.heading[world.route, sample]
    left: Floats = off[:, 1] * np.cos(heading) - off[:, 0] * np.sin(heading)
    return left


def _way(world: World, routes: Routes, row: int, end: float) -> Floats:
    """(P, 2) m, the points of a vehicle's route from where it is to an arc length."""
    route = world.route[row]
    first, last = int(world.progress[row] / routes.spacing), int(end / routes.spacing) + 1
    points: Floats = routes.point[route, first:last]
    return points


def _goal(world: World, routes: Routes, row: int, ego_way: Floats) -> float:
    """Past its own manoeuvre, or else past the ego's way; the end of the route if it is beyond both already."""
    route, start = world.route[row], world.progress[row]
    length = float(routes.length[route])
    busy = np.flatnonzero(routes.command[route] != Command.FOLLOW_LANE)
    if not len(busy):
        ahead = _way(world, routes, row, length)
        gap = np.hypot(*(ahead[:, None] - ego_way[None]).transpose(2, 0, 1)).min(axis=1)
        busy = int(start / routes.spacing) + np.flatnonzero(gap < NEAR)
    goal = busy[-1] * routes.spacing + _BEYOND if len(busy) else length
    if goal <= start:
        goal = length
    return float(min(goal, length, start + WITHIN * world.target_speed[row]))
