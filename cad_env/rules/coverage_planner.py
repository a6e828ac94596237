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
from cad_env.rules.planner import PlannerConfig, Rule, decide_on_view, seconds_for, stopping_distance
from cad_env.types import BRAKE, GO, STEP, Floats, Ints, Observation
from cad_env.world.drivers import MAX_ACCELERATION

REACH, THROUGH, TIME = (LANE_FEATURES.index(name) for name in ("reach", "through", "time"))


class Reserve(NamedTuple):
    """A CoverageConfig as compiled code sees it."""

    short: float
    spare: float


@dataclass(frozen=True)
class CoverageConfig:
    """How the ego treats what nobody vouches for."""

    short: float = 1.0  # m before a lane, where it stops to wait
    spare: float = 0.5  # s that must be left when it is through
    rules: PlannerConfig = field(default_factory=PlannerConfig)  # about the vehicles that it knows

    def __post_init__(self) -> None:
        check_numbers(self, "", {"short": (0.0, 10.0), "spare": (0.0, 10.0)})

    @property
    def reserve(self) -> Reserve:
        """The compiled code's view."""
        return Reserve(float(self.short), float(self.spare))


@compiled
def is_last_chance(reach: float, speed: float, short: float) -> bool:
    """Whether the ego, going on for one more step, could no longer stop `short` m before what is `reach` m away."""
    faster = speed + MAX_ACCELERATION * STEP
    return reach - speed * STEP - stopping_distance(faster) < short


@compiled
def must_wait(lanes: LaneView, ego: Floats, reserve: Reserve) -> bool:
    """True if the ego (4,) must stop now for a lane that it would not be through in time.

    Lanes so close behind each other that it cannot stop between them are one. A lane before which it can no longer
    stop, and whatever is one with it, it leaves soonest by going.
    """
    bound, asked = -math.inf, -math.inf  # m along the way, up to which it drives anyway, or would if it goes now
    for k in range(lanes.lane_mask.shape[0]):
        if lanes.lane_mask[k] == 0:
            break
        reach, through = lanes.lanes[k, REACH], lanes.lanes[k, THROUGH]
        if reach < stopping_distance(ego[0]) or reach - reserve.short < bound:
            bound = max(bound, through)
        elif reach - reserve.short < asked or is_last_chance(reach, ego[0], reserve.short):
            if seconds_for(ego, through) + reserve.spare > lanes.lanes[k, TIME]:
                return True
            asked = max(asked, through)
    return False


@compiled
def decide_on_lanes(view: View, lanes: LaneView, rule: Rule, reserve: Reserve) -> int:
    """The decision on an observation with coverage."""
    if decide_on_view(view, rule) == BRAKE or must_wait(lanes, view.ego.astype(np.float64), reserve):
        return BRAKE
    return GO


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
