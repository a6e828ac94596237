"""The routes of a map -> the lanes on which somebody may come, in places, and where the routes conflict."""

import math
from typing import NamedTuple

import numpy as np

from cad_env.scenarios.routes import ALONG_ANGLE
from cad_env.types import Floats
from cad_env.world.lanes import CONFLICTS, PLACE, PLACES, TOP_SPEED, Lanes, empty_lanes
from cad_env.world.state import Routes

IN_THE_WAY = 2.0  # m between the middles of two lanes, below which a car on each would touch the other
SAME_ORIGIN = 10.0  # m from the start of a route; what runs along another one there is the same stream, no conflict
MERGED = 20.0  # m after two lanes have become one, from where on who follows whom is settled
OPPOSED_ANGLE = math.radians(30.0)  # rad from the opposite of a way, within which a lane comes towards it
SIDEWAYS = 10.0  # m/s2, more than tyres hold: no faster does anybody drive through a bend
HARDEST = 8.0  # m/s2 that anybody brakes with before it
HALF_CAR = 2.1  # m, half the length of the shortest car
BEND = 0.15  # m by which a straight piece may miss the middle of its lane


class Conflict(NamedTuple):
    """Where a route meets another one: m along itself and along the other."""

    other: int
    reach: float
    through: float
    entry: float
    exit: float
    opposed: bool


def lanes_of(routes: Routes, limit: Floats) -> Lanes:
    """The lanes of a map, on which nobody exceeds limit (B,) m/s.

    Routes of one origin do not conflict; who merges does up to MERGED m after the lanes met.
    """
    count = len(routes.length)
    conflicts = [conflicts_of(routes, route)[:CONFLICTS] for route in range(count)]
    ends = [max((c.exit for each in conflicts for c in each if c.other == b), default=None) for b in range(count)]
    start, first, pieces, rows = [], [], [0], []
    for b, end in enumerate(ends):
        last = 0.0 if end is None else min(math.ceil(end / PLACE) * PLACE, routes.length[b] // PLACE * PLACE)
        start.append(last - PLACES * PLACE)
        first.append(PLACES if end is None else max(0, round(-start[-1] / PLACE)))
        rows += _pieces(routes, b, start[-1], first[-1])
        pieces.append(len(rows))
    limit = np.minimum(limit, TOP_SPEED)
    return _with_conflicts(routes, conflicts, np.array(start), limit)._replace(
        limit=limit,
        start=np.array(start), first=np.array(first, np.int64), pieces=np.array(pieces, np.int64),
        piece=np.array([piece for _, piece in rows]).reshape(-1, 5),
        piece_places=np.array([places for places, _ in rows], np.int64).reshape(-1, 2),
    )  # fmt: skip


def conflicts_of(routes: Routes, route: int) -> list[Conflict]:
    """Where a route meets others, in the order of its way."""
    found = [_conflict(routes, route, other) for other in range(len(routes.length)) if other != route]
    return sorted((each for each in found if each is not None), key=lambda each: each.reach)


def _conflict(routes: Routes, a: int, b: int) -> Conflict | None:
    """Where routes a and b take up the same ground; None if they do nowhere, or begin together."""
    way, lane = (routes.point[r, : round(routes.length[r] / routes.spacing) + 1] for r in (a, b))
    apart = np.linalg.norm(way[:, None] - lane[None, :], axis=-1)
    near = apart < IN_THE_WAY
    begin = int(SAME_ORIGIN / routes.spacing)
    if not near.any() or near[:begin, :begin].any():
        return None
    own, theirs = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    turn = routes.heading[b, int(np.argmin(apart[own[0]]))] - routes.heading[a, own[0]]
    along, opposed = math.cos(turn) > math.cos(ALONG_ANGLE), math.cos(turn) < -math.cos(OPPOSED_ANGLE)
    reach, through, entry, end = (routes.spacing * float(k) for k in (own[0], own[-1], theirs[0], theirs[-1]))
    if along:
        through, end = min(through, reach + MERGED), min(end, entry + MERGED)
    if opposed:  # as far as the map says that the own way is in their lane
        there = routes.spacing * np.flatnonzero(routes.oncoming[a, : len(way)])
        reach, through = min([reach, *there[:1]]), max([through, *there[-1:]])
    return Conflict(b, float(reach), float(through), entry, end, opposed)


def _pieces(routes: Routes, route: int, start: float, first: int) -> list[tuple[list[int], list[float]]]:
    """([first place, one past the last], [x, y, cos, sin, length]) of straight pieces, as long as the lane lets."""
    found, place = [], first
    while place < PLACES:
        end = place + 1
        while end < PLACES and _is_straight(routes, route, start + place * PLACE, start + (end + 1) * PLACE):
            end += 1
        here, there = (point_at(routes, route, start + k * PLACE) for k in (place, end))
        length = float(np.hypot(*(there - here)))
        found.append(([place, end], [*here.tolist(), *((there - here) / length).tolist(), length]))
        place = end
    return found


def _is_straight(routes: Routes, route: int, start: float, end: float) -> bool:
    """Whether the chord from `start` to `end`, m along a route, misses no sample between by more than BEND."""
    here, there = point_at(routes, route, start), point_at(routes, route, end)
    cos, sin = (there - here) / np.hypot(*(there - here))
    between = routes.point[route, math.ceil(start / routes.spacing) : int(end / routes.spacing) + 1] - here
    return bool(np.abs(between[:, 1] * cos - between[:, 0] * sin).max(initial=0.0) <= BEND)


def point_at(routes: Routes, route: int, arc: float) -> Floats:
    """(2,) m of a place so far along a route."""
    index = min(int(arc / routes.spacing), routes.point.shape[1] - 2)
    share = arc / routes.spacing - index
    point: Floats = routes.point[route, index] * (1.0 - share) + routes.point[route, index + 1] * share
    return point


def soonest(routes: Routes, conflict: Conflict, start: float, limit: float) -> Floats:
    """(P + 1,) s from the beginning of each place of the other lane until the front of a car from there is in the way.

    It drives at `limit` m/s, but for bends, for which it slows down as late as HARDEST allows.
    """
    arc = start + PLACE * np.arange(PLACES + 1)
    fine = np.arange(conflict.entry, min(arc[0], conflict.entry) - routes.spacing, -routes.spacing)  # towards its start
    sample = np.clip((fine / routes.spacing).astype(int), 1, routes.heading.shape[1] - 2)
    heading = routes.heading[conflict.other]
    bend = np.abs(heading[sample + 1] - heading[sample - 1]) / (2.0 * routes.spacing)
    speed = np.minimum(limit, np.sqrt(SIDEWAYS / np.maximum(bend, 1e-9)))
    for n in range(1, len(speed)):
        speed[n] = min(speed[n], math.sqrt(speed[n - 1] ** 2 + 2.0 * HARDEST * routes.spacing))
    time = np.concatenate([[0.0], np.cumsum(routes.spacing / speed[:-1])])
    found: Floats = np.interp(conflict.entry - HALF_CAR - arc, conflict.entry - fine, time, left=0.0)
    return found


def _with_conflicts(routes: Routes, conflicts: list[list[Conflict]], start: Floats, limit: Floats) -> Lanes:
    pairs = (len(conflicts), CONFLICTS)
    lanes = empty_lanes()._replace(
        other=np.full(pairs, -1, np.int64), reach=np.zeros(pairs), through=np.zeros(pairs), entry=np.zeros(pairs),
        exit=np.zeros(pairs), opposed=np.zeros(pairs, np.int8), soonest=np.zeros((*pairs, PLACES + 1)),
        conflict=np.zeros((*pairs, 4)),
    )  # fmt: skip
    for a, each in enumerate(conflicts):
        for k, found in enumerate(each):
            lanes.other[a, k], lanes.opposed[a, k] = found.other, found.opposed
            lanes.reach[a, k], lanes.through[a, k] = found.reach, found.through
            lanes.entry[a, k], lanes.exit[a, k] = found.entry, found.exit
            lanes.soonest[a, k] = soonest(routes, found, start[found.other], limit[found.other])
            heading = routes.heading[found.other, int(found.entry / routes.spacing)]
            point = point_at(routes, found.other, found.entry)
            lanes.conflict[a, k] = (*point, math.cos(heading), math.sin(heading))
    return lanes
