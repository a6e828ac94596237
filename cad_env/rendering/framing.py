"""Where the picture looks, and how large it is: a junction as a whole, a long road along with the ego."""

from typing import Any

import numpy as np

from cad_env.scenarios.scenario import Map
from cad_env.simulation.simulation import Simulation
from cad_env.types import Floats

SLENDER = 0.25  # short over long side of a map, below which it is a road and not a junction
SCALING = 6.5  # pixels a metre
MARGIN = 8.0  # m that the ego stays away from the edge of the picture


def screen(map_: Map, share: float = 1.0) -> dict[str, Any]:
    """highway-env's display settings that suit a map; a share below 1 shows the same in a smaller picture."""
    low, high = _extent(map_)
    width, height = high - low
    if height < SLENDER * width:  # the ego at a third, for what comes towards it matters more than what is behind
        size, at = (1080, 300), [0.35, 0.5]
    elif width < SLENDER * height:
        size, at = (300, 1080), [0.5, 0.65]
    else:
        size, at = (720, 720), [0.5, 0.5]
    return {
        "screen_width": round(share * size[0]), "screen_height": round(share * size[1]),
        "scaling": share * SCALING, "centering_position": at,
    }  # fmt: skip


def focus(simulation: Simulation, view: Floats) -> Floats:
    """(2,) m: what a picture of `view` (2,) m is about: the middle of a junction; on a long road, the ego.

    Across a long road it is the middle too, or where the ego is going if the picture does not take in all of it.
    """
    low, high = _extent(simulation.map)
    size, ego = high - low, simulation.world.position[simulation.agents[0]]
    middle = 0.5 * (low + high)
    free, along = np.maximum(0.5 * view - MARGIN, 0.0), size[::-1] < SLENDER * size
    about = np.where(along[::-1] & (size > view), _goal(simulation), middle)
    followed: Floats = np.where(along, ego, np.clip(about, ego - free, ego + free))
    return followed


def _goal(simulation: Simulation) -> Floats:
    """(2,) m: where the ego has arrived."""
    routes, route = simulation.map.routes, simulation.world.route[simulation.agents[0]]
    place: Floats = routes.point[route, int(simulation.scene.goal / routes.spacing)]
    return place


def _extent(map_: Map) -> tuple[Floats, Floats]:
    """(2,), (2,) m: the lowest and highest x and y of the lanes."""
    ends = np.array([lane.position(s, 0.0) for lane in map_.network.lanes_list() for s in (0.0, lane.length)])
    return ends.min(axis=0), ends.max(axis=0)
