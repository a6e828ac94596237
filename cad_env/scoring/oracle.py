"""The best that could be done: a driver who may choose once when to go, by trying all times.

It knows what will happen and needs no margin, so no policy can be expected to reach it; what an expert loses against
it is the price of its caution.
"""

import math

import numpy as np

from cad_env.numerics.jit import compiled
from cad_env.rules.blind import BEFORE
from cad_env.rules.planner import stopping_distance
from cad_env.scenarios.scene import EGO, Scene, place
from cad_env.types import BRAKE, GO, MAX_STEPS, STEP, Floats
from cad_env.world.state import Routes, World
from cad_env.world.step import advance


def best_time(scene: Scene, routes: Routes, conflict: float) -> float:
    """s of the soonest arrival among those who wait, until any decision, and then go; inf if none arrives.

    One kind of them brakes from the start, the other drives up to 1 m before `conflict`, m along the ego's route,
    where its body first is in the way of the hidden stream.
    """
    start, best = place(scene.placements, routes), MAX_STEPS + 1
    for stop in (conflict - BEFORE, -math.inf):
        for wait in range(MAX_STEPS):
            if wait >= best:
                break
            world = World(*(part.copy() for part in start))
            best = min(best, _arrival(world, routes, scene.goal, stop, wait, best, np.empty(len(start.speed))))
    return best * STEP if best <= MAX_STEPS else math.inf


@compiled
def _arrival(world: World, routes: Routes, goal: float, stop: float, wait: int, best: int, scratch: Floats) -> int:
    """Decisions until the ego arrives, or more than MAX_STEPS; not looked at beyond `best`."""
    rows, actions = np.array([EGO]), np.array([GO])
    begun = False
    for step in range(best):
        if step >= wait:
            actions[0] = GO
        else:
            speed = world.speed[EGO]
            begun = begun or world.progress[EGO] + speed * STEP + stopping_distance(speed) >= stop
            actions[0] = BRAKE if begun else GO
        advance(world, routes, rows, actions, scratch)
        if world.struck[EGO] >= 0:
            break
        if world.progress[EGO] >= goal:
            return step + 1
    return MAX_STEPS + 1
