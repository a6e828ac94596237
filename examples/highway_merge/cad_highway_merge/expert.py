"""Who decides in a merge with the truth: waits before the right lane until there is a gap, and goes into it.

cad_env's own rules look only as far ahead as the ego can stop, too short for whoever comes from behind so fast.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from cad_env.config import check_range
from cad_env.rules.planner import SLOWEST, stopping_distance
from cad_env.simulation.scene_step import Truths
from cad_env.types import BRAKE, GO, STEP, Bools, Floats, Ints
from cad_env.world.drivers import COMMANDED_BRAKING, idm_acceleration
from cad_env.world.geometry import ALONG
from cad_env.world.state import OFF, Routes, Truth, World
from cad_highway_merge.road import ENTER, GOAL, LANE, ROUTES

RAMP_ROUTE = ROUTES.index("ramp")
HORIZON = 150  # decisions: from standstill to the goal


@dataclass(frozen=True)
class MergeConfig:
    """How large a gap must be."""

    look_ahead: float = 3.0  # s before it would enter the lane, from when on the gap counts
    ahead: float = 1.0  # s of the travel of whoever comes from behind, to be free between them
    behind: float = 0.5  # s of the ego's own travel, to be free to whoever is before it
    margin: float = 1.0  # m besides

    def __post_init__(self) -> None:
        for name in ("look_ahead", "ahead", "behind", "margin"):
            check_range(name, getattr(self, name), 0.0, 10.0)


@dataclass
class MergeExpert:
    """Goes when the gap in the right lane suffices up to its goal, everybody keeping speed; else brakes before it."""

    config: MergeConfig = field(default_factory=MergeConfig)
    privileged: bool = True

    def reset(self, seed: int) -> None:
        """Nothing to forget: the rules have no memory."""

    def act(self, observation: Truth) -> int:
        """GO or BRAKE on the truth."""
        return self._decide(observation.world, observation.routes, observation.row)

    def act_batch(self, observations: Truths) -> Ints:
        """GO or BRAKE, (n,), in n scenes."""
        return np.array([self.act(truth) for truth in observations.each()], np.int64)

    def _decide(self, world: World, routes: Routes, row: int) -> int:
        here, rule = float(world.progress[row]), self.config
        if world.route[row] != RAMP_ROUTE or here > GOAL:
            return GO
        others = _in_right_lane(world, row)
        going = _rolled(world, row, GO)
        entry = int(np.searchsorted(going, ENTER)) * STEP  # s
        if entry > rule.look_ahead or _free(world, routes, row, others, going, rule):
            return GO
        if here + stopping_distance(float(world.speed[row])) < ENTER:
            return BRAKE
        touch = MergeConfig(ahead=0.0, behind=0.0, margin=0.5)  # too late to wait: only true contacts count
        braking = _rolled(world, row, BRAKE)
        goes = _free(world, routes, row, others, going, touch)
        return BRAKE if not goes and _free(world, routes, row, others, braking, touch) else GO


def _in_right_lane(world: World, row: int) -> Bools:
    """(N,) True for every other vehicle that drives in the right lane."""
    inside = np.abs(world.position[:, 1]) < 0.5 * LANE
    moving = (world.driver != OFF) & (world.speed > SLOWEST) & (np.cos(world.heading) > ALONG)
    mine = np.arange(len(world.speed)) == row
    found: Bools = inside & moving & ~mine
    return found


def _rolled(world: World, row: int, action: int) -> Floats:
    """(HORIZON,) m along its route at the next decisions, on a free road, if the ego does the same at all of them."""
    arc, speed, target = (float(part[row]) for part in (world.progress, world.speed, world.target_speed))
    decided = [*world.command[row, 1:].tolist()]  # not in force yet, but on the way
    arcs = np.empty(HORIZON)
    for k in range(HORIZON):
        arcs[k] = arc
        brakes = (decided[k] if k < len(decided) else action) == BRAKE
        acceleration = -COMMANDED_BRAKING if brakes else idm_acceleration(speed, target, math.inf, 0.0)
        arc += speed * STEP
        speed = max(speed + acceleration * STEP, 0.0)
    return arcs


def _free(world: World, routes: Routes, row: int, others: Bools, arcs: Floats, rule: MergeConfig) -> bool:
    """True if nobody of `others` (N,) comes too near while the ego, at `arcs` (T,) m, is in the lane and not there."""
    spent = np.flatnonzero((arcs >= ENTER) & (arcs <= GOAL))
    if not len(spent) or not others.any():
        return True
    samples = np.arange(routes.point.shape[1]) * routes.spacing
    x = np.interp(arcs[spent], samples, routes.point[world.route[row], :, 0])
    speed = np.gradient(arcs, STEP)[spent]
    pace, length = world.speed[others, None], world.size[others, 0, None]
    ahead = world.position[others, 0, None] + pace * spent * STEP - x  # (n, t) m, of the other's centre
    wanted = np.where(ahead < 0.0, rule.ahead * pace, rule.behind * speed) + rule.margin
    return bool((np.abs(ahead) - 0.5 * (length + world.size[row, 0]) >= wanted).all())
