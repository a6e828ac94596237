"""The rules of `planner`, and caution about what the ego cannot see: the alternative to being told.

Besides the vehicles it knows, the ego reckons with one in every place that could hide it, on every lane that its way
may conflict with, coming at a stated speed. It goes on only as far as it could still stop before such a lane, and
over the lane once nothing that is hidden could reach it in the time that takes; until then it creeps, to see more.

What it takes for granted, for an observation holds no map but the way ahead: roads run along or across the last
part of the way; a lane may cross the way anywhere, from either side, but for a stretch in an oncoming lane (nobody
overtakes at a junction), where traffic comes the other way along it; hidden traffic comes straight; no vehicle
comes through one that stands. How large a vehicle is follows from its class, how it stands from where: along the
ego's own road if it is near it, else across.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cad_env.checks import check_numbers
from cad_env.config import SensorConfig
from cad_env.numerics.jit import compiled
from cad_env.pipeline.observe import View, view_at, view_of
from cad_env.pipeline.sense import MOUNT
from cad_env.rules.planner import (
    SLOWEST,
    PlannerConfig,
    Rule,
    box_on_way,
    decide,
    known_vehicles,
    oncoming_stretch,
    seconds_for,
    stopping_distance,
    way_of,
)
from cad_env.types import BRAKE, GO, ROUTE_SPACING, STEP, Floats, Ints, Observation
from cad_env.world.drivers import idm_acceleration
from cad_env.world.geometry import box_hides

ROAD = 7.5  # m beside the ego, within which what stands does so along its own road: two lanes
BODY = 2.4, 1.0  # m, half a hidden car: length and width
LEAST = 0.75  # of its assumed length, what any vehicle of a class has at least: that much of a lane it surely blocks
LOOK = 2.0  # m between the places in which something may hide
SIDES = math.radians(60.0), math.radians(150.0)  # rad between the way and a lane that crosses it


class Caution(NamedTuple):
    """A CautiousConfig as compiled code sees it."""

    speed: float
    reserve: float
    short: float
    lean: float
    creep: float
    range: float


@dataclass(frozen=True)
class CautiousConfig:
    """What the ego reckons with in places that it cannot see."""

    speed: float = 15.0  # m/s at which a hidden vehicle comes
    reserve: float = 0.3  # s that must be left when the ego is over a lane
    short: float = 0.5  # m before a lane that crosses, where the ego stops
    lean: float = 2.0  # m into an oncoming lane that it drives to look: an oncoming vehicle can still pass
    creep: float = 2.5  # m/s at which it goes on to see more: it stops from there within 1 m
    range: float = SensorConfig.range  # m that its sensor reaches
    rules: PlannerConfig = field(default_factory=PlannerConfig)  # about the vehicles that it knows

    def __post_init__(self) -> None:
        limits = {
            "speed": (1.0, 50.0), "reserve": (0.0, 10.0), "short": (0.0, 10.0), "lean": (0.0, 10.0),
            "creep": (0.0, 5.0), "range": (1.0, 500.0),
        }  # fmt: skip
        check_numbers(self, "", limits)

    @property
    def caution(self) -> Caution:
        """The compiled code's view."""
        numbers = (self.speed, self.reserve, self.short, self.lean, self.creep, self.range)
        speed, reserve, short, lean, creep, reach = map(float, numbers)
        return Caution(speed, reserve, short, lean, creep, reach)


@compiled
def boxes_of(others: Floats, axis: float) -> Floats:
    """(n, 6) as `others` in `contact_ahead`, with a heading for what stands; axis: the way's last heading, rad."""
    boxes: Floats = others.copy()
    across = axis + 0.5 * math.pi
    own = axis if abs(math.cos(axis)) > abs(math.cos(across)) else across  # the road that the ego is on now
    for k in range(len(boxes)):
        if boxes[k, 3] < SLOWEST:
            beside = abs(boxes[k, 1] * math.cos(own) - boxes[k, 0] * math.sin(own))
            boxes[k, 2] = own if beside < ROAD else own + 0.5 * math.pi
    return boxes


@compiled
def closed_from(boxes: Floats, x: float, y: float, ux: float, uy: float) -> float:
    """m before (x, y) on a lane of direction u, from where on a standing vehicle keeps all others back; inf: none."""
    closed = math.inf
    for k in range(len(boxes)):
        if boxes[k, 3] >= SLOWEST:
            continue
        dx, dy = boxes[k, 0] - x, boxes[k, 1] - y
        before, beside = -(dx * ux + dy * uy), abs(dy * ux - dx * uy)
        along = abs(ux * math.cos(boxes[k, 2]) + uy * math.sin(boxes[k, 2])) > math.sqrt(0.5)
        length, width = 0.5 * LEAST * boxes[k, 4], 0.5 * boxes[k, 5]
        if before > 0.0 and beside < (width if along else length) + 0.8 * BODY[1]:
            closed = min(closed, before - (length if along else width))
    return closed


@compiled
def point_is_hidden(boxes: Floats, caution: Caution, sx: float, sy: float, x: float, y: float) -> bool:
    """True if the sensor at (sx, sy) does not see the point (x, y)."""
    if math.hypot(x - sx, y - sy) > caution.range:
        return True
    for k in range(len(boxes)):
        if box_hides(sx, sy, x, y, boxes[k, 0], boxes[k, 1], math.cos(boxes[k, 2]), math.sin(boxes[k, 2]),
                     boxes[k, 4], boxes[k, 5]):  # fmt: skip
            return True
    return False


@compiled
def body_is_hidden(boxes: Floats, caution: Caution, sensor: float, x: float, y: float, ux: float, uy: float) -> bool:
    """True if the ego would not see a car at (x, y) that heads along u: none of the five points that sensing asks for.

    The sensor is so many metres ahead of the ego's centre.
    """
    for forward, left in ((0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        along, across = forward * BODY[0], left * BODY[1]
        px, py = x + along * ux - across * uy, y + along * uy + across * ux
        if not point_is_hidden(boxes, caution, sensor, 0.0, px, py):
            return False
    return True


@compiled
def may_come(boxes: Floats, caution: Caution, sensor: float, x: float, y: float, ux: float, uy: float,
             first: float, last: float) -> bool:  # fmt: skip
    """True if a car may be hidden `first` to `last` m before (x, y) on the lane of direction u through that place."""
    before, end = first, min(last, closed_from(boxes, x, y, ux, uy) - BODY[0])
    while before < end:
        if body_is_hidden(boxes, caution, sensor, x - before * ux, y - before * uy, ux, uy):
            return True
        before += LOOK
    return False


@compiled
def crossing_is_free(way: Floats, arc: float, axis: float, boxes: Floats, caution: Caution, ego: Floats) -> bool:
    """True if nothing hidden can reach a place, `arc` m along the way, from either side before the ego is past it."""
    x, y, heading = box_on_way(way, arc)
    seconds = seconds_for(ego, arc + BODY[1] + 0.5 * ego[2]) + caution.reserve
    first = BODY[0] + 0.5 * ego[3]  # as near as one can be that is not there yet
    for quarter in range(4):
        lane = axis + 0.5 * math.pi * quarter
        if not math.cos(SIDES[1]) < math.cos(lane - heading) < math.cos(SIDES[0]):
            continue
        if may_come(boxes, caution, MOUNT * ego[2], x, y, math.cos(lane), math.sin(lane), first,
                    first + caution.speed * seconds):  # fmt: skip
            return False
    return True


@compiled
def stretch_is_free(way: Floats, stretch: tuple[float, float], boxes: Floats, caution: Caution, ego: Floats) -> bool:
    """True if nothing hidden can come towards the ego while it drives in an oncoming lane, `stretch` (m, m) ahead."""
    middle = min(int(0.5 * (stretch[0] + stretch[1]) / ROUTE_SPACING), len(way) - 2)
    dx, dy = way[middle, 0] - way[middle + 1, 0], way[middle, 1] - way[middle + 1, 1]
    length = math.hypot(dx, dy)
    seconds = seconds_for(ego, stretch[1] + 0.5 * ego[2]) + caution.reserve
    rest = stretch[1] - middle * ROUTE_SPACING
    return not may_come(boxes, caution, MOUNT * ego[2], way[middle, 0], way[middle, 1], dx / length, dy / length,
                        stretch[0] - middle * ROUTE_SPACING, rest + BODY[0] + caution.speed * seconds)  # fmt: skip


@compiled
def may_go(way: Floats, ego: Floats, boxes: Floats, oncoming: Ints, axis: float, caution: Caution) -> bool:
    """True if one more step of going leads to nowhere that something hidden may come to.

    What the ego cannot stop before any more was judged when it still could.
    """
    faster = ego[0] + max(idm_acceleration(ego[0], ego[1], math.inf, 0.0), 0.0) * STEP
    now = 0.5 * ego[2] + stopping_distance(ego[0])
    then = 0.5 * ego[2] + ego[0] * STEP + stopping_distance(faster)
    stretch = oncoming_stretch(oncoming, ROUTE_SPACING)
    edge = stretch[0] + caution.lean  # or up to a point of the way farther on
    if oncoming[0] == 0 and now - 2.0 * ROUTE_SPACING < edge < then:
        return stretch_is_free(way, stretch, boxes, caution, ego)
    if faster <= caution.creep:
        return True
    place = then + caution.short + BODY[1]
    if oncoming[min(int(place / ROUTE_SPACING), len(oncoming) - 1)]:
        return True
    return crossing_is_free(way, place, axis, boxes, caution, ego)


@compiled
def decide_cautiously(view: View, rule: Rule, caution: Caution) -> int:
    """GO or BRAKE on an observation."""
    way, own = way_of(view.route), view.ego.astype(np.float64)
    others = known_vehicles(view, way)
    if decide(way, own, others, oncoming_stretch(view.oncoming, ROUTE_SPACING), rule) == BRAKE:
        return BRAKE
    axis = math.atan2(way[-1, 1] - way[-2, 1], way[-1, 0] - way[-2, 0])
    return GO if may_go(way, own, boxes_of(others, axis), view.oncoming, axis, caution) else BRAKE


@compiled
def decide_cautiously_on_all(views: View, rule: Rule, caution: Caution, chosen: Ints) -> None:
    """Write the decisions on observations, stacked along a first axis, to chosen (n,)."""
    for k in range(chosen.shape[0]):
        chosen[k] = decide_cautiously(view_at(views, k), rule, caution)


@dataclass
class Cautious:
    """The rules with caution: the cautious-own method."""

    config: CautiousConfig = field(default_factory=CautiousConfig)
    privileged: bool = False

    def reset(self, seed: int) -> None:
        """Nothing to forget: the rules have no memory."""

    def act(self, observation: Observation) -> int:
        """GO or BRAKE on an observation."""
        return int(self.act_batch({name: part[None] for name, part in observation.items()})[0])

    def act_batch(self, observations: Observation) -> Ints:
        """GO or BRAKE, (n,), on observations stacked along a first axis."""
        chosen = np.empty(len(observations["mask"]), np.int64)
        decide_cautiously_on_all(view_of(observations), self.config.rules.rule, self.config.caution, chosen)
        return chosen
