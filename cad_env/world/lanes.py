"""The lanes of a map on which somebody may come: every route cut into places, and where the routes conflict.

A place is PLACE metres of a route, in which the centre of a vehicle may be. It is as long as a vehicle at TOP_SPEED
drives in one step, so that whoever is in place i now is in i or i + 1 in the next step. Of every route the last PLACES
before the end of its last conflict with another one are kept.
"""

from typing import NamedTuple

import numpy as np

from cad_env.types import STEP, Floats, Ints

TOP_SPEED = 20.0  # m/s, no vehicle that nobody has seen is faster; none of the scenes that ship is
PLACE = TOP_SPEED * STEP  # m
PLACES = 128  # of a lane: 256 m
CONFLICTS = 4  # lanes that a route conflicts with, at the most; of more, those that it meets first


class Lanes(NamedTuple):
    """The lanes of a map with B routes, in S straight pieces; L = CONFLICTS. Lane b is that of route b."""

    start: Floats  # (B,) m along its route, where place 0 of a lane begins; negative where the route is shorter
    first: Ints  # (B,) int64 the first place that is on the map
    pieces: Ints  # (B + 1,) int64 the pieces of lane b are those from pieces[b] to before pieces[b + 1]
    piece: Floats  # (S, 5) x, y (m) where a piece begins, cos and sin of its direction, its length (m)
    piece_places: Ints  # (S, 2) int64 the first place of its lane on it, and one past the last
    other: Ints  # (B, L) int64 the lanes that a route conflicts with, in the order in which it meets them; -1: none
    reach: Floats  # (B, L) m along the route, from where on a centre there is in the way of the other lane
    through: Floats  # (B, L) m along the route, up to where it is
    entry: Floats  # (B, L) m along the other route, from where on a centre there is in the way of this one
    exit: Floats  # (B, L) m along the other route, up to where it is
    opposed: Ints  # (B, L) int8 1 where the other one comes towards this one, along it
    limit: Floats  # (B,) m/s that nobody on a lane exceeds before its conflicts
    soonest: Floats  # (B, L, P + 1) s from the beginning of place p of the other lane to `entry`, at its limit
    conflict: Floats  # (B, L, 4) x, y (m) of the other lane at `entry`, cos and sin of its direction there


def empty_lanes() -> Lanes:
    """No lanes: of whoever shares no coverage."""
    pairs = (0, CONFLICTS)
    return Lanes(
        start=np.zeros(0),
        first=np.zeros(0, np.int64),
        pieces=np.zeros(1, np.int64),
        piece=np.zeros((0, 5)),
        piece_places=np.zeros((0, 2), np.int64),
        other=np.full(pairs, -1, np.int64),
        reach=np.zeros(pairs),
        through=np.zeros(pairs),
        entry=np.zeros(pairs),
        exit=np.zeros(pairs),
        opposed=np.zeros(pairs, np.int8),
        limit=np.zeros(0),
        soonest=np.zeros((*pairs, PLACES + 1)),
        conflict=np.zeros((*pairs, 4)),
    )
