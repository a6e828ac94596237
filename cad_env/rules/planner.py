"""The rules: brake if going now would end in a contact. On any knowledge: own, shared or true.

The ego runs along its way as its driver would, up to `clear` metres beyond the place where it could still stop; every
other vehicle keeps its velocity. Crossing, oncoming and merging vehicles count; who is on the ego's own way and heads
along it does not: to follow it is the driver model's work. A vehicle's body is lengthened by what it travels in
`ahead` and `behind` seconds, so that the ego neither cuts in before it nor slips in just behind it: imitating near
misses leads to collisions.
Once waiting would leave the ego in the way, only true contacts count: it goes if that is free and braking is not.
Before a stretch on which it drives in a lane of oncoming traffic the ego looks as far ahead as it needs to be through
with it, and waits at its gate: once it is out there, braking does not help.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cad_env.checks import check_numbers
from cad_env.numerics.jit import compiled
from cad_env.pipeline.observe import View, view_at, view_of
from cad_env.rules.motion import fit_motion, lane_heading
from cad_env.types import BRAKE, GO, ROUTE_SPACING, STEP, TRUCK, Floats, Ints, Observation
from cad_env.world.drivers import COMMANDED_BRAKING, idm_acceleration
from cad_env.world.geometry import ALONG, boxes_touch
from cad_env.world.state import COMMAND_DELAY

SLOWEST = 1.5  # m/s, below which a vehicle is taken to stand
HALF_LANE = 1.75  # m beside a way, up to which a vehicle that heads along it is on it
BEYOND = 100.0  # m before the beginning and past the end of a way, up to which one is on it too
CAR_SIZE, TRUCK_SIZE = (4.8, 2.0), (12.0, 2.6)  # m, what a track of each class is taken to be


class Rule(NamedTuple):
    """A PlannerConfig as compiled code sees it."""

    clear: float
    ahead: float
    behind: float
    margin: float
    gate: float


@dataclass(frozen=True)
class PlannerConfig:
    """How careful the rules are."""

    clear: float = 14.0  # m beyond its stopping distance, up to which the way must be free: over a lane that crosses
    ahead: float = 0.5  # s of its travel by which a vehicle is lengthened in front ...
    behind: float = 0.3  # s ... and behind
    margin: float = 0.5  # m around every vehicle
    gate: float = 32.0  # m beyond its stopping distance, where all of the way through an oncoming lane must be free

    def __post_init__(self) -> None:
        limits = {
            "clear": (0.0, 60.0), "ahead": (0.0, 10.0), "behind": (0.0, 10.0), "margin": (0.0, 5.0),
            "gate": (0.0, 80.0),
        }  # fmt: skip
        check_numbers(self, "", limits)

    @property
    def rule(self) -> Rule:
        """The compiled code's view."""
        return Rule(float(self.clear), float(self.ahead), float(self.behind), float(self.margin), float(self.gate))


@compiled
def box_on_way(way: Floats, arc: float) -> tuple[float, float, float]:
    """(x, y, heading) at an arc length along a polyline whose points are ROUTE_SPACING apart."""
    last = way.shape[0] - 2
    index = min(max(int(arc / ROUTE_SPACING), 0), last)
    share = arc / ROUTE_SPACING - index
    dx, dy = way[index + 1, 0] - way[index, 0], way[index + 1, 1] - way[index, 1]
    return way[index, 0] + share * dx, way[index, 1] + share * dy, math.atan2(dy, dx)


@compiled
def contact_ahead(way: Floats, ego: Floats, others: Floats, braking: bool, seconds: float, ahead: float,
                  behind: float, margin: float) -> bool:  # fmt: skip
    """True if the ego would touch a vehicle that moves within `seconds`.

    way (P, 2) m, from the ego's position on; ego (4,) speed, wanted speed, length, width;
    others (n, 6) x, y, heading, speed, length, width, in the frame of the way.
    """
    speed, arc, time = ego[0], 0.0, 0.0
    for step in range(int(seconds / STEP) + 1):
        x, y, heading = box_on_way(way, arc)
        for k in range(others.shape[0]):
            pace = others[k, 3]
            if pace < SLOWEST:
                continue
            shift = pace * (time + 0.5 * (ahead - behind))
            if boxes_touch(
                x, y, heading, ego[2] + 2.0 * margin, ego[3] + 2.0 * margin,
                others[k, 0] + shift * math.cos(others[k, 2]), others[k, 1] + shift * math.sin(others[k, 2]),
                others[k, 2], others[k, 4] + pace * (ahead + behind), others[k, 5],
            ):  # fmt: skip
                return True
        acceleration = idm_acceleration(speed, ego[1], math.inf, 0.0)
        if braking:  # until the brake bites the ego rolls on
            acceleration = 0.0 if step < COMMAND_DELAY else -COMMANDED_BRAKING
        arc += speed * STEP
        speed = max(speed + acceleration * STEP, 0.0)
        time += STEP
    return False


@compiled
def is_on_way(way: Floats, x: float, y: float, heading: float) -> bool:
    """True if a vehicle at (x, y) is on a way (P, 2), or in line with one of its ends, and heads along it."""
    last = way.shape[0] - 2
    for p in range(last + 1):
        dx, dy = way[p + 1, 0] - way[p, 0], way[p + 1, 1] - way[p, 1]
        length = math.hypot(dx, dy)
        if length < 1e-6:
            continue
        ux, uy = dx / length, dy / length
        along, beside = (x - way[p, 0]) * ux + (y - way[p, 1]) * uy, (y - way[p, 1]) * ux - (x - way[p, 0]) * uy
        first, end = -BEYOND if p == 0 else 0.0, length + BEYOND if p == last else length
        if (
            abs(beside) < HALF_LANE
            and first <= along <= end
            and math.cos(heading) * ux + math.sin(heading) * uy > ALONG
        ):
            return True
    return False


@compiled
def not_on_way(way: Floats, others: Floats) -> Floats:
    """(m, 6) those of `others` (see `contact_ahead`) whom the ego does not just follow or lead."""
    kept = np.empty_like(others)
    n = 0
    for k in range(others.shape[0]):
        if others[k, 3] >= SLOWEST and not is_on_way(way, others[k, 0], others[k, 1], others[k, 2]):
            kept[n] = others[k]
            n += 1
    return kept[:n]


@compiled
def seconds_for(ego: Floats, distance: float) -> float:
    """Seconds that the ego (4,) takes for a distance, m, if it goes."""
    speed, arc, time = ego[0], 0.0, 0.0
    while arc < distance:
        arc += speed * STEP
        speed += idm_acceleration(speed, ego[1], math.inf, 0.0) * STEP
        time += STEP
    return time


@compiled
def stopping_distance(speed: float) -> float:
    """m that the ego still covers if it brakes now."""
    return speed * COMMAND_DELAY * STEP + 0.5 * speed * speed / COMMANDED_BRAKING


@compiled
def oncoming_stretch(oncoming: Ints, spacing: float) -> tuple[float, float]:
    """(m, m) from where to where the way is in an oncoming lane, by its points (P,) so many metres apart; inf: not."""
    start = end = math.inf
    for p in range(oncoming.shape[0]):
        if oncoming[p]:
            start, end = min(start, p * spacing), (p + 1) * spacing
        elif start < math.inf:
            break
    return start, end


@compiled
def seconds_to_look(ego: Floats, stretch: tuple[float, float], rule: Rule) -> float:
    """s for which the way must be free: `clear` m beyond where the ego (4,) could stop, or through an oncoming lane."""
    seconds = seconds_for(ego, stopping_distance(ego[0]) + rule.clear)
    if stretch[0] <= stopping_distance(ego[0]) + rule.gate:
        seconds = max(seconds, seconds_for(ego, stretch[1]))
    return seconds


@compiled
def decide(way: Floats, ego: Floats, others: Floats, stretch: tuple[float, float], rule: Rule) -> int:
    """GO or BRAKE by the rules of this module; `stretch` as from `oncoming_stretch`, the rest as in `contact_ahead`."""
    others = not_on_way(way, others)
    seconds, ahead, behind = seconds_to_look(ego, stretch, rule), rule.ahead, rule.behind
    if stretch[0] < stopping_distance(ego[0]):  # too late to wait: only true contacts count
        ahead = behind = 0.0
    if not contact_ahead(way, ego, others, False, seconds, ahead, behind, rule.margin):
        return GO
    going = contact_ahead(way, ego, others, False, seconds, 0.0, 0.0, rule.margin)
    stopping = contact_ahead(way, ego, others, True, seconds, 0.0, 0.0, rule.margin)
    return GO if stopping and not going else BRAKE


@compiled
def way_of(route: Floats) -> Floats:
    """The way from the ego on, which is the origin, (P + 1, 2) m, by the route (P, 2) of an observation."""
    way = np.zeros((route.shape[0] + 1, 2))
    for p in range(route.shape[0]):
        way[p + 1, 0], way[p + 1, 1] = route[p, 0], route[p, 1]
    return way


@compiled
def known_vehicles(view: View, way: Floats) -> Floats:
    """Every track of an observation whose motion is known, as a row (n, 6) of `others` in `contact_ahead`."""
    others = np.empty((view.mask.shape[0], 6))
    n = 0
    for k in range(view.mask.shape[0]):
        if fit_motion(view.tracks[k], view.mask[k], view.odometry, others[n]):
            others[n, 2] = lane_heading(way, others[n, 2])
            length, width = TRUCK_SIZE if view.kind[k] == TRUCK else CAR_SIZE
            others[n, 4], others[n, 5] = length, width
            n += 1
    return others[:n]


@compiled
def decide_on_view(view: View, rule: Rule) -> int:
    """The planner's decision on an observation."""
    way = way_of(view.route)
    others = known_vehicles(view, way)
    stretch = oncoming_stretch(view.oncoming, ROUTE_SPACING)
    return decide(way, view.ego.astype(np.float64), others, stretch, rule)


@compiled
def decide_on_views(views: View, rule: Rule, chosen: Ints) -> None:
    """Write the planner's decisions on observations, stacked along a first axis, to chosen (n,)."""
    for k in range(chosen.shape[0]):
        chosen[k] = decide_on_view(view_at(views, k), rule)


@dataclass
class Planner:
    """The rules on what the ego knows: the planner-own and planner-shared methods, by what is shared with it."""

    config: PlannerConfig = field(default_factory=PlannerConfig)
    privileged: bool = False

    def reset(self, seed: int) -> None:
        """Nothing to forget: the rules have no memory."""

    def act(self, observation: Observation) -> int:
        """GO or BRAKE on an observation."""
        return decide_on_view(view_of(observation), self.config.rule)

    def act_batch(self, observations: Observation) -> Ints:
        """GO or BRAKE, (n,), on observations stacked along a first axis."""
        chosen = np.empty(len(observations["mask"]), np.int64)
        decide_on_views(view_of(observations), self.config.rule, chosen)
        return chosen
