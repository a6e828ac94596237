"""Rules for a junction without lights: priority to the right, on any knowledge, own, shared or true.

As in `cad_env.rules.planner` the ego runs along its way as its driver would and every other vehicle keeps its
velocity; whoever would touch the ego then is in conflict with it. Who of the two waits:

- A vehicle from the right goes first, and so does one that comes towards an ego that turns left.
- Two that hardly move do not ask for the side: the one clearly nearer to where their ways meet goes first. So those
  who all have somebody on their right do not wait for ever.
- Over all others the ego goes first, as long as it can trust them to stop; at the last moment at which it could still
  stop itself, it brakes for whoever would have to brake harder than `trusted`.

The ego waits `hold` metres before the ground that both need, so that it keeps the lanes before it free.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cad_env.checks import check_numbers
from cad_env.numerics.jit import compiled
from cad_env.pipeline.observe import View, view_of
from cad_env.rules.planner import (
    SLOWEST,
    TRUCK_SIZE,
    box_on_way,
    contact_ahead,
    known_vehicles,
    not_on_way,
    seconds_for,
    stopping_distance,
    way_of,
)
from cad_env.types import BRAKE, GO, ROUTE_SPACING, Floats, Observation
from cad_env.world.dynamics import wrapped
from cad_env.world.geometry import boxes_touch
from cad_env.world.state import OFF, Routes, Truth, World

SQUARE = 0.25 * math.pi  # rad around a right angle, within which another comes from the side
WAY = 80.0  # m of its way that the ego looks at
STEP_ON_WAY = 0.5  # m
CAR_CORE = 3.4  # m of a car that stands, which are taken up whatever it heads to
_PASSING = 0.3  # m by which the ego is longer and wider where it passes who stands


class PriorityRule(NamedTuple):
    """A PriorityConfig as compiled code sees it."""

    clear: float
    hold: float
    inside: float
    reserve: float
    trusted: float
    slow: float
    nearer: float
    ahead: float
    behind: float
    margin: float


@dataclass(frozen=True)
class PriorityConfig:
    """How careful the rules are."""

    clear: float = 26.0  # m beyond its stopping distance, up to which the ego looks for conflicts: over the junction
    hold: float = 12.0  # m before a conflict, where the ego waits for whoever goes first
    inside: float = 5.0  # m before a conflict, from where on it waits only if it would touch somebody else
    reserve: float = 4.0  # m before a conflict, where it waits for whoever does not stop though the ego goes first
    trusted: float = 1.5  # m/s2, up to which others are taken to brake for the ego
    slow: float = 3.0  # m/s, below which a vehicle hardly moves
    nearer: float = 0.5  # m by which one of two that hardly move must be nearer to go first
    ahead: float = 0.5  # s of its travel by which a vehicle is lengthened in front ...
    behind: float = 0.3  # s ... and behind
    margin: float = 0.5  # m around every vehicle

    def __post_init__(self) -> None:
        limits = {
            "clear": (0.0, 60.0), "hold": (0.0, 30.0), "inside": (0.0, 30.0), "reserve": (0.0, 30.0),
            "trusted": (0.0, 10.0), "slow": (0.0, 20.0), "nearer": (0.0, 20.0), "ahead": (0.0, 10.0),
            "behind": (0.0, 10.0), "margin": (0.0, 5.0),
        }  # fmt: skip
        check_numbers(self, "", limits)

    @property
    def rule(self) -> PriorityRule:
        """The compiled code's view."""
        return PriorityRule(*(float(getattr(self, name)) for name in PriorityRule._fields))


@compiled
def meeting_of(way: Floats, ego: Floats, other: Floats, margin: float) -> tuple[float, float]:
    """(m, m) that the fronts of the ego and of another are away from the ground that both need; inf: there is none.

    way (P, 2) m, from the ego on; ego (4,) speed, wanted speed, length, width; other (6,) x, y, heading, speed, length,
    width, straight on.
    """
    cos, sin = math.cos(other[2]), math.sin(other[2])
    aside = 0.5 * (ego[3] + other[5]) + margin
    for step in range(int(WAY / STEP_ON_WAY)):
        x, y, _ = box_on_way(way, step * STEP_ON_WAY)
        dx, dy = x - other[0], y - other[1]
        along = dx * cos + dy * sin
        if abs(dy * cos - dx * sin) < aside and along > -0.5 * other[4]:
            return step * STEP_ON_WAY - 0.5 * ego[2], along - 0.5 * other[4] - aside
    return math.inf, math.inf


@compiled
def has_priority(way: Floats, other: Floats) -> bool:
    """True if a vehicle (6,) goes before the ego: from its right, towards its left turn, or in its own direction."""
    heading = box_on_way(way, 0.0)[2]
    turn = wrapped(other[2] - heading)
    if abs(turn) > math.pi - SQUARE:
        return turns_left(way)
    return bool(turn > -SQUARE)


@compiled
def must_brake_for(way: Floats, ego: Floats, other: Floats, rule: PriorityRule) -> bool:
    """True if the ego has to brake now for a vehicle (6,) that it would touch if it went on."""
    own, theirs = meeting_of(way, ego, other, rule.margin)
    if own == math.inf:  # it is there already
        return True
    room, needed = own - stopping_distance(ego[0]), 0.5 * other[3] ** 2 / max(theirs, 0.1)
    first = has_priority(way, other)
    if ego[0] < rule.slow and other[3] < rule.slow and abs(own - theirs) > rule.nearer:
        first = theirs < own
    if first:
        return bool(room < rule.hold)
    return bool(room < rule.reserve and needed > rule.trusted)


@compiled
def decide_by_priority(way: Floats, ego: Floats, others: Floats, rule: PriorityRule) -> int:
    """GO or BRAKE by the rules of this module; way, ego and others (n, 6) as in `planner.contact_ahead`."""
    if is_blocked(way, ego, others, rule):
        return BRAKE
    others = not_on_way(way, others)
    if brakes_on(way, ego, others, False, rule):
        return BRAKE
    if turns_left(way) and brakes_on(straight_on(way), ego, others, True, rule):
        return BRAKE
    return GO


@compiled
def is_blocked(way: Floats, ego: Floats, others: Floats, rule: PriorityRule) -> bool:
    """True if a vehicle that stands is in the ego's way, no farther than it takes to stop."""
    reach = stopping_distance(ego[0]) + rule.reserve
    for k in range(others.shape[0]):
        if others[k, 3] < SLOWEST and not _touches(way, ego, others[k], 0.0) and _touches(way, ego, others[k], reach):
            return True
    return False


@compiled
def _touches(way: Floats, ego: Floats, other: Floats, reach: float) -> bool:
    """True if the ego would touch a vehicle (6,) as it stands now on its next metres."""
    for step in range(int(reach / STEP_ON_WAY) + 1):
        x, y, heading = box_on_way(way, step * STEP_ON_WAY)
        if boxes_touch(
            x, y, heading, ego[2] + _PASSING, ego[3] + _PASSING, other[0], other[1], other[2], other[4], other[5]
        ):  # fmt: skip
            return True
    return False


@compiled
def brakes_on(way: Floats, ego: Floats, others: Floats, only_right: bool, rule: PriorityRule) -> bool:
    """True if the ego has to brake for anybody, or for anybody from its right, if it drives along a way."""
    seconds = seconds_for(ego, stopping_distance(ego[0]) + rule.clear)
    for k in range(others.shape[0]):
        one = others[k : k + 1]
        if only_right and not is_from_right(way, others[k]):
            continue
        ahead, behind = rule.ahead, rule.behind
        if meeting_of(way, ego, others[k], rule.margin)[0] < rule.inside:
            ahead = behind = 0.0  # to stop there would leave the ego in others' way: only true contacts count
        if not contact_ahead(way, ego, one, False, seconds, ahead, behind, rule.margin):
            continue
        if must_brake_for(way, ego, others[k], rule):
            going = contact_ahead(way, ego, one, False, seconds, 0.0, 0.0, rule.margin)
            halting = contact_ahead(way, ego, one, True, seconds, 0.0, 0.0, rule.margin)
            if going or not halting:
                return True
    return False


@compiled
def is_from_right(way: Floats, other: Floats) -> bool:
    """True if a vehicle (6,) comes from the ego's right."""
    return bool(abs(wrapped(other[2] - box_on_way(way, 0.0)[2]) - 0.5 * math.pi) < SQUARE)


@compiled
def turns_left(way: Floats) -> bool:
    """True if a way turns left."""
    return bool(wrapped(box_on_way(way, WAY)[2] - box_on_way(way, 0.0)[2]) > SQUARE)


@compiled
def straight_on(way: Floats) -> Floats:
    """(P, 2) m, straight on from the beginning of a way: where whoever comes from the right may expect the ego."""
    x, y, heading = box_on_way(way, 0.0)
    straight = np.empty_like(way)
    for p in range(way.shape[0]):
        straight[p, 0] = x + p * ROUTE_SPACING * math.cos(heading)
        straight[p, 1] = y + p * ROUTE_SPACING * math.sin(heading)
    return straight


@compiled
def priority_on_view(view: View, rule: PriorityRule) -> int:
    """The decision on an observation."""
    way = way_of(view.route)
    others = known_vehicles(view, way)
    for k in range(others.shape[0]):
        if others[k, 3] < SLOWEST:
            others[k, 2] = 0.0  # a track that stands does not tell where it heads
            others[k, 4] = others[k, 5] = TRUCK_SIZE[1] if others[k, 4] == TRUCK_SIZE[0] else CAR_CORE
    return decide_by_priority(way, view.ego.astype(np.float64), others, rule)


@compiled
def priority_on_truth(world: World, routes: Routes, row: int, rule: PriorityRule) -> int:
    """The decision for one vehicle of the world."""
    count, n = world.speed.shape[0], 0
    others = np.empty((count, 6))
    for k in range(count):
        if k != row and world.driver[k] != OFF:
            others[n, 0], others[n, 1] = world.position[k, 0], world.position[k, 1]
            others[n, 2], others[n, 3] = world.heading[k], world.speed[k]
            others[n, 4], others[n, 5] = world.size[k, 0], world.size[k, 1]
            n += 1
    ego = np.array([world.speed[row], world.target_speed[row], world.size[row, 0], world.size[row, 1]])
    return decide_by_priority(way_on_map(world, routes, row), ego, others[:n], rule)


@compiled
def way_on_map(world: World, routes: Routes, row: int) -> Floats:
    """(P, 2) m, the way of a vehicle from where it is."""
    way, last = np.empty((int(WAY / ROUTE_SPACING) + 1, 2)), routes.point.shape[1] - 1
    for p in range(way.shape[0]):
        index = min(int((world.progress[row] + p * ROUTE_SPACING) / routes.spacing + 0.5), last)
        way[p, 0], way[p, 1] = routes.point[world.route[row], index, 0], routes.point[world.route[row], index, 1]
    way[0, 0], way[0, 1] = world.position[row, 0], world.position[row, 1]
    return way


@dataclass
class PriorityPlanner:
    """The rules on what a vehicle sees and is sent, or, if privileged, on the truth."""

    config: PriorityConfig = field(default_factory=PriorityConfig)
    privileged: bool = False

    def reset(self, seed: int) -> None:
        """Nothing to forget: the rules have no memory."""

    def act(self, observation: Observation | Truth) -> int:
        """GO or BRAKE on an observation, or on the truth."""
        if isinstance(observation, Truth):
            return priority_on_truth(observation.world, observation.routes, observation.row, self.config.rule)
        return priority_on_view(view_of(observation), self.config.rule)
