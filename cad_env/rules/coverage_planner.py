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
    contact_ahead,
    decide,
    known_vehicles,
    not_on_way,
    oncoming_stretch,
    seconds_for,
    seconds_to_look,
    stopping_distance,
    way_of,
)
from cad_env.types import BRAKE, GO, ROUTE_SPACING, STEP, Floats, Ints, Observation
from cad_env.world.drivers import COMMANDED_BRAKING, MAX_ACCELERATION
from cad_env.world.geometry import ALONG

_REACH, _THROUGH, _HIDDEN, _TIME = (LANE_FEATURES.index(name) for name in ("reach", "through", "hidden", "time"))

NOSE, STANDING_NOSE = 0.3, 0.9  # m into a lane, where the front of who drives on, and of who waits, is in nobody's way
BRAKES = 1.0  # m/s2, more than any vehicle slows down by that does not brake
ELSEWHERE, AHEAD, LATE, ON = 0, 1, 2, 3  # where the ego is to a lane


class Reserve(NamedTuple):
    """A CoverageConfig as compiled code sees it."""

    short: float
    spare: float
    meeting: float
    watch: float


@dataclass(frozen=True)
class CoverageConfig:
    """How the ego treats what nobody vouches for."""

    short: float = 0.5  # m before a lane, where it stops to wait
    spare: float = 0.3  # s that must be left when it is through
    meeting: float = 1.0  # s of its travel by which a vehicle that comes towards it is lengthened in front
    watch: float = 60.0  # m of a lane that must be vouched for, if the ego is to stand on it
    rules: PlannerConfig = field(default_factory=PlannerConfig)  # about the vehicles that it knows

    def __post_init__(self) -> None:
        limits = {"short": (0.0, 10.0), "spare": (0.0, 10.0), "meeting": (0.0, 10.0), "watch": (0.0, 200.0)}
        check_numbers(self, "", limits)

    @property
    def reserve(self) -> Reserve:
        """The compiled code's view."""
        return Reserve(float(self.short), float(self.spare), float(self.meeting), float(self.watch))


@compiled
def is_last_chance(reach: float, speed: float, short: float) -> bool:
    """Whether the ego, going on for one more step, could no longer stop `short` m before what is `reach` m away."""
    faster = speed + MAX_ACCELERATION * STEP
    return reach - speed * STEP - stopping_distance(faster) < short


@compiled
def before_on(lane: Floats, other: Floats) -> float:
    """m before the conflict of a lane (F,), at which a vehicle (6,) on it is; negative: beyond it; inf: beside it."""
    dx, dy = other[0] - lane[0], other[1] - lane[1]
    if not abs(dy * lane[2] - dx * lane[3]) < HALF_LANE:
        return math.inf
    return float(-(dx * lane[2] + dy * lane[3]))


@compiled
def heads_along(lane: Floats, other: Floats) -> bool:
    """Whether a vehicle (6,) heads as a lane (F,) does."""
    return bool(math.cos(other[2]) * lane[2] + math.sin(other[2]) * lane[3] > ALONG)


@compiled
def distance_on(lane: Floats, other: Floats) -> float:
    """m before the conflict of a lane (F,), at which a vehicle (6,) that moves towards it on that lane is; inf: not."""
    before = before_on(lane, other)
    if other[3] < SLOWEST or not heads_along(lane, other) or not 0.0 < before < BEYOND:
        return math.inf
    return before


@compiled
def closed_at(lane: Floats, others: Floats) -> float:
    """m before the conflict of a lane (F,), at which the first of `others` that stands on it is; inf: none does."""
    nearest = math.inf
    for k in range(others.shape[0]):
        before = before_on(lane, others[k])
        if others[k, 3] < SLOWEST and 0.0 < before < nearest:
            nearest = before
    return nearest


@compiled
def is_quiet(lane: Floats, others: Floats, watch: float) -> bool:
    """True for a lane (F,) that is vouched for `watch` m, on which none of `others` can come to the conflict."""
    if lane[_HIDDEN] < watch:
        return False
    closed, coming = closed_at(lane, others), 0
    for k in range(others.shape[0]):
        coming += distance_on(lane, others[k]) < closed
    return coming == 0


@compiled
def soonest_hidden(lane: Floats, others: Floats) -> float:
    """s until who is hidden on a lane (F,) could be at the conflict: not before those known whom it has before it."""
    time = float(lane[_TIME])
    for k in range(others.shape[0]):
        before = distance_on(lane, others[k])
        if before < lane[_HIDDEN]:
            time = max(time, float(before / others[k, 3]))
    return time


@compiled
def is_braking(odometry: Floats) -> bool:
    """Whether the ego slows down, by its poses (T, 3): its brake has been on for the delay of a command."""
    x, y = odometry[-2, 0], odometry[-2, 1]
    now, before = math.hypot(x, y), math.hypot(odometry[-3, 0] - x, odometry[-3, 1] - y)
    return now - before < -BRAKES * STEP * STEP


@compiled
def standing_to(lane: Floats, ego: Floats, brakes: bool, short: float) -> int:
    """Where the ego (4,), which `brakes` or not, is to a lane (F,).

    AHEAD: it can still choose; LATE: it chose to go a step ago, and can no longer stop `short` m before; or ON it.
    """
    speed, reach = ego[0], lane[_REACH]
    nose = STANDING_NOSE if brakes or speed < SLOWEST else NOSE
    if reach + nose < speed * speed / (2.0 * COMMANDED_BRAKING):
        return ON
    if brakes or speed < SLOWEST or not is_last_chance(reach + speed * STEP, speed - MAX_ACCELERATION * STEP, short):
        return AHEAD
    return LATE


@compiled
def must_wait(lanes: LaneView, ego: Floats, brakes: bool, others: Floats, reserve: Reserve) -> bool:
    """True if the ego (4,), which `brakes` or not, must stop now for a lane that it would not be through in time.

    It does not ask for a lane that it can no longer stop before. It enters one only if it need not stop on it for the
    next one, unless it may stand there, because the lane is quiet.
    """
    asked = -math.inf  # m along the way, up to which it must drive if it goes now
    for k in range(lanes.lane_mask.shape[0]):
        if lanes.lane_mask[k] == 0:
            break
        lane = lanes.lanes[k]
        place = standing_to(lane, ego, brakes, reserve.short)
        if place == ON:
            continue
        if lane[_REACH] - reserve.short < asked or is_last_chance(lane[_REACH], ego[0], reserve.short):
            need = seconds_for(ego, lane[_THROUGH])
            spare = reserve.spare if place == AHEAD else 0.0
            if need + spare > soonest_hidden(lane, others):
                return True
            if not is_quiet(lane, others, reserve.watch):
                asked = max(asked, lane[_THROUGH])
    return False


@compiled
def lane_of(lanes: LaneView, ego: Floats, brakes: bool, short: float, other: Floats) -> int:
    """Where the ego is to the lane on which a vehicle (6,) drives, as `standing_to`; ELSEWHERE if it is on none."""
    where = ELSEWHERE
    for k in range(lanes.lane_mask.shape[0]):
        lane = lanes.lanes[k]
        if lanes.lane_mask[k] and heads_along(lane, other) and before_on(lane, other) < math.inf:
            where = max(where, standing_to(lane, ego, brakes, short))
    return where


@compiled
def is_behind(other: Floats) -> bool:
    """Whether a vehicle (6,), in the ego's frame, is behind it and drives as it does: it sees the ego."""
    return bool(other[0] < 0.0 and math.cos(other[2]) >= ALONG)


@compiled
def decide_on_lanes(view: View, lanes: LaneView, rule: Rule, reserve: Reserve) -> int:
    """The decision on an observation with coverage.

    Of those who come on a lane that the ego has entered only true contacts count, since to stop there is no way out;
    before a lane that it has not entered it can always wait.
    """
    way, ego = way_of(view.route), view.ego.astype(np.float64)
    stretch, brakes = oncoming_stretch(view.oncoming, ROUTE_SPACING), is_braking(view.odometry)
    known = known_vehicles(view, way)
    others = known[np.array([not is_behind(each) for each in known], np.bool_)]
    place = np.array([lane_of(lanes, ego, brakes, reserve.short, each) for each in others], np.int64)
    if decide(way, ego, others[place == ELSEWHERE], stretch, rule) == BRAKE:
        return BRAKE
    seconds = seconds_to_look(ego, stretch, rule)
    longer = rule.ahead if stretch[0] == math.inf else reserve.meeting
    for where in (AHEAD, LATE, ON):
        met = not_on_way(way, others[place == where])
        ahead, behind = (longer, rule.behind) if where == AHEAD else (0.0, 0.0)
        if not contact_ahead(way, ego, met, False, seconds, ahead, behind, rule.margin):
            continue
        if where != ON or not contact_ahead(way, ego, met, True, seconds, 0.0, 0.0, 0.0):
            return BRAKE
    return BRAKE if must_wait(lanes, ego, brakes, others, reserve) else GO


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
