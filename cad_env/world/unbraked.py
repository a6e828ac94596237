"""Whom a vehicle would meet if it never braked: what makes an episode a hazard."""

import math

import numpy as np

from cad_env.numerics.jit import compiled
from cad_env.types import STEP, Floats
from cad_env.world.state import Routes, World
from cad_env.world.step import advance


def who_is_met(world: World, routes: Routes, goal: float, steps: int) -> tuple[int, float]:
    """(row, time s) of the first contact of row 0, which is never told to brake, on its way to `goal`, m; (-1, inf).

    The world is driven: give a copy. After `steps` decisions (0.1 s each) nothing more is looked at.
    """
    row, time = _rolled_out(world, routes, goal, steps, np.empty(len(world.speed)))
    return int(row), float(time)


@compiled
def _rolled_out(world: World, routes: Routes, goal: float, steps: int, scratch: Floats) -> tuple[int, float]:
    nobody = np.zeros(0, np.int64)  # is told anything
    for step in range(steps):
        advance(world, routes, nobody, nobody, scratch)
        if world.struck[0] >= 0:
            return world.struck[0], STEP * (step + 1)
        if world.progress[0] >= goal:
            break
    return -1, math.inf
