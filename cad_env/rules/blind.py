"""Who drives with closed eyes: by the ego's own speed, its place on its route and the clock, and by nothing else."""

import math
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cad_env.rules.planner import CAR_SIZE, stopping_distance
from cad_env.scenarios import scenario_named
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import EGO
from cad_env.types import BRAKE, GO, STEP, Bools
from cad_env.world.drivers import COMMANDED_BRAKING, MAX_ACCELERATION
from cad_env.world.state import COMMAND_DELAY, Routes, Truth
from cad_env.world.step import SUBSTEP

BEFORE = 1.0  # m before the conflict, where `stop-D` waits
STANDS = 0.1  # m/s, below which the ego stands
_EXACT = 1e-9  # s, less than any difference between two times


class Own(NamedTuple):
    """All that a control is told."""

    time: float  # s since the start
    speed: float  # m/s
    progress: float  # m along its route


class Control(ABC):
    """A policy that is told nothing but `Own`; only the truth has the place on the route, so it is privileged."""

    privileged: bool = True
    _decisions: int = 0

    def reset(self, seed: int) -> None:
        """Start the clock."""
        self._decisions = 0

    def act(self, observation: Truth) -> int:
        """GO or BRAKE, by the ego's own row of the truth."""
        world, row = observation.world, observation.row
        own = Own(self._decisions * STEP, float(world.speed[row]), float(world.progress[row]))
        self._decisions += 1
        return self.decide(own)

    @abstractmethod
    def decide(self, own: Own) -> int:
        """GO or BRAKE."""


@dataclass
class Blind(Control):
    """Brakes for the first seconds of an episode, then goes."""

    seconds: float

    def decide(self, own: Own) -> int:
        """BRAKE until the time is over."""
        return BRAKE if own.time < self.seconds - _EXACT else GO


@dataclass
class Stop(Control):
    """Drives to a place on its route, stops there (at most 2 m short of it, never beyond), waits, and goes."""

    place: float  # m along its route
    seconds: float  # that it waits
    _braking: bool = field(default=False, init=False)
    _since: float | None = field(default=None, init=False)  # s, when it came to stand there
    _speed: float = field(default=0.0, init=False)  # m/s, a decision ago

    def reset(self, seed: int) -> None:
        """Start anew."""
        super().reset(seed)
        self._braking, self._since, self._speed = False, None, math.inf

    def decide(self, own: Own) -> int:
        """GO up to the last moment to stop, BRAKE from then on, GO when it has waited."""
        self._braking = self._braking or own.progress + self._stopping_a_decision_later(own.speed) >= self.place
        if not self._braking:
            return GO
        if self._since is None and own.speed < STANDS:
            self._since = own.time
        return GO if self._since is not None and own.time - self._since >= self.seconds - _EXACT else BRAKE

    def _stopping_a_decision_later(self, speed: float) -> float:
        """m that it covers if it brakes from the next decision on; until that bites it gains speed as before."""
        gained, self._speed = max(speed - self._speed, 0.0), speed
        fastest = speed + (COMMAND_DELAY + 1) * gained
        return fastest * (STEP + SUBSTEP) + stopping_distance(fastest)


@dataclass
class Slow(Control):
    """Is never faster than a speed, once it has slowed down to it."""

    speed: float  # m/s
    _pending: deque[int] = field(default_factory=lambda: deque([GO] * COMMAND_DELAY, COMMAND_DELAY), init=False)

    def reset(self, seed: int) -> None:
        """Nothing is pending."""
        super().reset(seed)
        self._pending.extend([GO] * COMMAND_DELAY)

    def decide(self, own: Own) -> int:
        """GO if it is no faster after that, BRAKE otherwise; what was decided before may not be in force yet."""
        speed = own.speed
        for action in self._pending:
            speed = _after(speed, action)
        action = GO if _after(speed, GO) <= self.speed + _EXACT else BRAKE
        self._pending.append(action)
        return action


def _after(speed: float, action: int) -> float:
    """m/s after a decision, at the most."""
    return max(speed - COMMANDED_BRAKING * STEP, 0.0) if action == BRAKE else speed + MAX_ACCELERATION * STEP


@cache
def conflict_of(scenario: str) -> float:
    """m along the ego's route, where the body of a car that follows it first is in the way of the hidden lane.

    By the map alone, so it is the same in every episode. The hidden lane is the route of the vehicle that would hit an
    ego that never brakes. The ego is in its way within half a car's width of it or, as the rules have it, where the map
    says that the ego's route is in a lane of oncoming traffic. ValueError if they never meet.
    """
    story = scenario_named(scenario)
    scene = story.scene(story.configured({}), Traffic("none"), 0, hazard=True)
    own, hidden = (scene.placements[row].route for row in (EGO, scene.hazard_row))
    routes = story.map.routes
    met = _reaches(routes, own, hidden) | (routes.oncoming[own] > 0)
    if not met.any():
        raise ValueError(f"the ego's route never meets that of the hidden vehicle in {scenario!r}: there is no stop-D")
    return float(np.flatnonzero(met)[0] * routes.spacing)


def _reaches(routes: Routes, own: int, hidden: int) -> Bools:
    """(P,) True where a car at that sample of its route has its front within half a car's width of another route."""
    length, width = CAR_SIZE
    heading = routes.heading[own]
    ahead, left = np.stack([np.cos(heading), np.sin(heading)], 1), np.stack([-np.sin(heading), np.cos(heading)], 1)
    front = routes.point[own] + 0.5 * length * ahead
    corners = np.stack([front + side * 0.5 * width * left for side in (-1.0, 0.0, 1.0)], 1)
    distance, _ = cKDTree(routes.point[hidden]).query(corners.reshape(-1, 2))
    near: Bools = (distance.reshape(-1, 3) <= 0.5 * width).any(axis=1)
    return near
