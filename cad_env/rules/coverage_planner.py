"""The rules of `planner`, which also wait for whatever may come from where nobody has looked.

Of each lane that its way meets the ego knows the foremost place in which a vehicle may be that nobody has reported
(`cad_env.pipeline.hidden`), and how fast it may come. It drives on as long as it can still stop before a lane. From
there it goes only if it is through before such a vehicle could be at the conflict; until then it stands at the edge of
the lane, where it sees the most itself. How much of the road is vouched for decides how long that takes: nobody on the
air costs time.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cad_env.checks import ConfigError, check_numbers
from cad_env.numerics.jit import compiled
from cad_env.pipeline.observe import View, view_at, view_of
from cad_env.pipeline.observe_lanes import LANE_FEATURES, LaneView, lane_view_at
from cad_env.rules.planner import (
    BEYOND,
    HALF_LANE,
    SLOWEST,
    PlannerConfig,
    Rule,
    decide,
    known_vehicles,
    oncoming_stretch,
    seconds_for,
    stopping_distance,
    way_of,
)
from cad_env.types import BRAKE, GO, ROUTE_SPACING, STEP, Floats, Ints, Observation
from cad_env.world.drivers import COMMANDED_BRAKING, MAX_ACCELERATION
from cad_env.world.geometry import ALONG

REACH, THROUGH, HIDDEN, TIME = (LANE_FEATURES.index(name) for name in ("reach", "through", "hidden", "time"))


class Reserve(NamedTuple):
    """A CoverageConfig as compiled code sees it."""

    short: float
    spare: float
    watch: float


@dataclass(frozen=True)
class CoverageConfig:
    """How the ego treats what nobody vouches for."""

    short: float = 1.0  # m before a lane, where it stops to wait
    spare: float = 0.3  # s that must be left when it is through
    watch: float = 60.0  # m of a lane that must be vouched for, if the ego is to stand on it
    rules: PlannerConfig = field(default_factory=PlannerConfig)  # about the vehicles that it knows

    def __post_init__(self) -> None:
        check_numbers(self, "", {"short": (0.0, 10.0), "spare": (0.0, 10.0), "watch": (0.0, 200.0)})

    @property
    def reserve(self) -> Reserve:
        """The compiled code's view."""
        return Reserve(float(self.short), float(self.spare), float(self.watch))


@compiled
def is_last_chance(reach: float, speed: float, short: float) -> bool:
    """Whether the ego, going on for one more step, could no longer stop `short` m before what is `reach` m away."""
    faster = speed + MAX_ACCELERATION * STEP
    return reach - speed * STEP - stopping_distance(faster) < short


@compiled
def distance_on(lane: Floats, other: Floats) -> float:
    """m before the conflict of a lane (F,), at which a vehicle (6,) that moves towards it on that lane is; inf: not."""
    dx, dy = other[0] - lane[0], other[1] - lane[1]
    before, beside = -(dx * lane[2] + dy * lane[3]), dy * lane[2] - dx * lane[3]
    along = math.cos(other[2]) * lane[2] + math.sin(other[2]) * lane[3]
    if other[3] < SLOWEST or along < ALONG or abs(beside) > HALF_LANE or not 0.0 < before < BEYOND:
        return math.inf
    return float(before)


@compiled
def is_quiet(lane: Floats, others: Floats, watch: float) -> bool:
    """True for a lane (F,) that is vouched for `watch` m, on which none of `others` moves towards the conflict."""
    if lane[HIDDEN] < watch:
        return False
    moving = 0
    for k in range(others.shape[0]):
        moving += distance_on(lane, others[k]) < math.inf
    return moving == 0


@compiled
def soonest_hidden(lane: Floats, others: Floats) -> float:
    """s until who is hidden on a lane (F,) could be at the conflict: not before those known whom it has before it."""
    time = float(lane[TIME])
    for k in range(others.shape[0]):
        before = distance_on(lane, others[k])
        if before < lane[HIDDEN]:
            time = max(time, float(before / others[k, 3]))
    return time


@compiled
def must_wait(lanes: LaneView, ego: Floats, others: Floats, reserve: Reserve) -> bool:
    """True if the ego (4,) must stop now for a lane that it would not be through in time.

    It does not ask for a lane that it can no longer stop before. It enters one only if it need not stop on it for the
    next one, unless it may stand there, because the lane is quiet.
    """
    asked = -math.inf  # m along the way, up to which it must drive if it goes now
    for k in range(lanes.lane_mask.shape[0]):
        if lanes.lane_mask[k] == 0:
            break
        lane = lanes.lanes[k]
        if lane[REACH] < ego[0] * ego[0] / (2.0 * COMMANDED_BRAKING):
            continue
        if lane[REACH] - reserve.short < asked or is_last_chance(lane[REACH], ego[0], reserve.short):
            if seconds_for(ego, lane[THROUGH]) + reserve.spare > soonest_hidden(lane, others):
                return True
            if not is_quiet(lane, others, reserve.watch):
                asked = max(asked, lane[THROUGH])
    return False


@compiled
def decide_on_lanes(view: View, lanes: LaneView, rule: Rule, reserve: Reserve) -> int:
    """The decision on an observation with coverage."""
    way, ego = way_of(view.route), view.ego.astype(np.float64)
    others = known_vehicles(view, way)
    if decide(way, ego, others, oncoming_stretch(view.oncoming, ROUTE_SPACING), rule) == BRAKE:
        return BRAKE
    return BRAKE if must_wait(lanes, ego, others, reserve) else GO


@compiled
def decide_on_all_lanes(views: View, lanes: LaneView, rule: Rule, reserve: Reserve, chosen: Ints) -> None:
    """Write the decisions on observations, stacked along a first axis, to chosen (n,)."""
    for k in range(chosen.shape[0]):
        chosen[k] = decide_on_lanes(view_at(views, k), lane_view_at(lanes, k), rule, reserve)


@dataclass
class CoveragePlanner:
    """The rules on what the ego knows and on what nobody knows: planner-coverage, or alone planner-coverage-own."""

    config: CoverageConfig = field(default_factory=CoverageConfig)
    privileged: bool = False

    def reset(self, seed: int) -> None:
        """Nothing to forget: the rules have no memory."""

    def act(self, observation: Observation) -> int:
        """GO or BRAKE on an observation with coverage."""
        rules = self.config.rules.rule, self.config.reserve
        return decide_on_lanes(view_of(observation), _lanes_of(observation), *rules)

    def act_batch(self, observations: Observation) -> Ints:
        """GO or BRAKE, (n,), on observations stacked along a first axis."""
        chosen = np.empty(len(observations["mask"]), np.int64)
        rules = self.config.rules.rule, self.config.reserve
        decide_on_all_lanes(view_of(observations), _lanes_of(observations), *rules, chosen)
        return chosen


def _lanes_of(observation: Observation) -> LaneView:
    """ConfigError, one line, for an observation without coverage."""
    if "lanes" not in observation:
        raise ConfigError("these rules need to know what was seen to be empty: make the environment with coverage=True")
    return LaneView(observation["lanes"], observation["lane_mask"])
