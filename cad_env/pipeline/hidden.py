"""Where a vehicle may be that nobody has reported: for each receiver, sets of places on the lanes that its way meets.

Every set starts full. Each step it grows downstream by what a vehicle at TOP_SPEED drives, then every place that the
receiver itself or a message vouches for is taken out. What was vouched for so many steps ago is now empty only where
nothing can have come from outside it since. Silence, losses and delays need no case of their own: what nobody vouches
for grows back. A vehicle that is reported as standing closes its lane: nothing grows past it.

The sets hold the places of vehicles that are known too, so that one whose track is lost is hidden again. They are left
out only of what is shown.
"""

import math
from typing import NamedTuple

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part, inlined_part
from cad_env.types import FRAMES, STEP, TRUCK, Bytes, Floats, GraphArrays, Ints
from cad_env.world.geometry import ALONG
from cad_env.world.lanes import CONFLICTS, PLACE, PLACES, Lanes

NOT_YET = -1_000_000  # in place of the step of what is known of a lane
ON_IT = 1.0  # m from the middle of a lane, within which a vehicle keeps others from passing it there
HALF = (2.1, 4.0)  # m, half the length of the shortest car and truck that the scenes know
STANDING_SPEED = 0.5  # m/s of a track of LONG frames or more, below which it is taken to stand
LONG = 8  # frames from the oldest node of a track to its newest
FRESH = 10  # frames, after which a node does not tell where a vehicle is any more
PATIENCE = 20  # steps lost, after which who is hidden is taken to stand
_MOST = 250  # steps that are counted
FOLLOWS = 4  # places behind a known vehicle, in which whoever is hidden moves as it does
UNDER, LEADS, CLOSED = 1, 2, 3  # in `known`: nobody else can be there; it moves along the lane; nobody comes through


class Hidden(NamedTuple):
    """What R receivers do not know, of L lanes of P places each that their own ways meet, as `Lanes.other` has them."""

    places: Bytes  # (R, L, P) 0 where nobody can be; else 1 and the steps that it must have lost against TOP_SPEED
    heard: Ints  # (R, L) int64 the newest step of which anything is known of a lane, NOT_YET for none
    wall: Bytes  # (R, L, P) 0 where nobody comes to a place from the one before it, else 1
    known: Bytes  # (R, L, P) UNDER, LEADS or CLOSED by a known vehicle, else 0


def new_hidden(receivers: int, lanes: Lanes) -> Hidden:
    """Nobody has vouched for anything."""
    shape = (receivers, CONFLICTS if len(lanes.start) else 0)
    return Hidden(
        places=np.ones((*shape, PLACES), np.uint8),
        heard=np.full(shape, NOT_YET, np.int64),
        wall=np.ones((*shape, PLACES), np.uint8),
        known=np.zeros((*shape, PLACES), np.uint8),
    )


@inlined_part
def hidden_at(hidden: Hidden, r: int) -> Hidden:
    """The sets of receiver `r`."""
    return Hidden(hidden.places[r], hidden.heard[r], hidden.wall[r], hidden.known[r])


@compiled_part
def grow(hidden: Hidden, lanes: Lanes, route: int) -> None:
    """One step later: whoever is hidden may have come one place on."""
    for k in range(hidden.places.shape[0]):
        b = lanes.other[route, k]
        if b < 0:
            continue
        places, wall, known = hidden.places[k], hidden.wall[k], hidden.known[k]
        for i in range(PLACES - 1, 0, -1):
            came, stayed = places[i - 1] * wall[i], places[i]
            if stayed:
                stayed = min(stayed + 1, _MOST)
            places[i] = stayed if came == 0 or 0 < stayed < came else came
        _flow(places, known)
        for i in range(min(lanes.first[b] + 1, PLACES)):  # where vehicles enter what is known of a lane
            places[i] = 1


@inlined_part
def _flow(places: Bytes, known: Bytes) -> None:
    """Whoever is hidden under a known vehicle that moves, or just behind it, moves with it."""
    near = 0
    for i in range(PLACES - 1, -1, -1):
        near = FOLLOWS + 1 if known[i] == LEADS else near - 1
        if near > 0 and places[i]:
            places[i] = 1


@compiled_part
def take_out(hidden: Hidden, lanes: Lanes, route: int, vouched: Bytes, step: int, age: int) -> None:
    """Take out the places vouched (B, P) in step `step - age`, as far as nothing can have come to them since."""
    for k in range(hidden.places.shape[0]):
        b = lanes.other[route, k]
        if b < 0:
            continue
        places, streak, told = hidden.places[k], 0, False
        for i in range(PLACES):
            streak = streak + 1 if vouched[b, i] else 0
            told |= streak > 0
            if streak > age:
                places[i] = 0
        if told:
            hidden.heard[k] = max(hidden.heard[k], step - age)


@compiled_part
def note_known(hidden: Hidden, lanes: Lanes, route: int, merged: GraphArrays, frame: Floats) -> None:
    """Mark where the vehicles of a merged graph are: nobody else is, and nobody comes past those that stand.

    frame (3,): the change of frames from that of the graph to that of the lanes.
    """
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    for k in range(hidden.places.shape[0]):
        for i in range(PLACES):
            hidden.wall[k, i], hidden.known[k, i] = 1, 0
    for g in range(merged.used[0]):
        x, y, vx, vy, age, length = _motion(merged, g)
        x, y = frame[0] + x * cos - y * sin, frame[1] + x * sin + y * cos
        vx, vy = vx * cos - vy * sin, vx * sin + vy * cos
        if age > FRESH:
            continue
        stands = length >= LONG and vx * vx + vy * vy < STANDING_SPEED * STANDING_SPEED
        half = HALF[0] + (HALF[1] if merged.kind[g] == TRUCK else HALF[0])
        for k in range(hidden.places.shape[0]):
            b = lanes.other[route, k]
            if b >= 0:
                arc, beside, later = place_beside(lanes, b, x, y, x + vx, y + vy)
                if beside < ON_IT:
                    along = PLACE * (later - arc) > ALONG * math.hypot(vx, vy)
                    under = LEADS if along and not stands else UNDER
                    ahead = arc + STEP * age * (later - arc)
                    _mark(hidden.known[k], hidden.wall[k], arc, ahead, half, stands, under)


@inlined_part
def _motion(merged: GraphArrays, g: int) -> tuple[float, float, float, float, int, int]:
    """Where the newest node of a row is, m, its mean velocity, m/s, its age, and the frames since the oldest one."""
    newest, oldest = FRAMES - 1, 0
    while not merged.mask[g, newest] and newest > 0:
        newest -= 1
    while not merged.mask[g, oldest] and oldest < newest:
        oldest += 1
    x, y, length = merged.position[g, newest, 0], merged.position[g, newest, 1], newest - oldest
    if length == 0:
        return x, y, 0.0, 0.0, FRAMES - 1 - newest, 0
    vx = (x - merged.position[g, oldest, 0]) / (STEP * length)
    vy = (y - merged.position[g, oldest, 1]) / (STEP * length)
    return x, y, vx, vy, FRAMES - 1 - newest, length


@inlined_part
def place_beside(lanes: Lanes, b: int, x: float, y: float, to_x: float, to_y: float) -> tuple[float, float, float]:
    """(places along lane b, m beside its middle, places along it of a second point) of a point; inf where it is not."""
    nearest, best = math.inf, -1
    for s in range(lanes.pieces[b], lanes.pieces[b + 1]):
        dx, dy = x - lanes.piece[s, 0], y - lanes.piece[s, 1]
        side = abs(dy * lanes.piece[s, 2] - dx * lanes.piece[s, 3])
        if side < nearest:
            a = dx * lanes.piece[s, 2] + dy * lanes.piece[s, 3]
            if -0.5 * PLACE <= a <= lanes.piece[s, 4] + 0.5 * PLACE:
                nearest, best = side, s
    if best < 0:
        return 0.0, nearest, 0.0
    piece, first, last = lanes.piece[best], lanes.piece_places[best, 0], lanes.piece_places[best, 1]
    size = piece[4] / (last - first)
    arc = first + ((x - piece[0]) * piece[2] + (y - piece[1]) * piece[3]) / size
    ahead = first + ((to_x - piece[0]) * piece[2] + (to_y - piece[1]) * piece[3]) / size
    return arc, nearest, ahead


@inlined_part
def _mark(known: Bytes, wall: Bytes, arc: float, ahead: float, half: float, stands: bool,
          under: int) -> None:  # fmt: skip
    last = math.floor(ahead + half / PLACE) + 1  # it may be seen late, or be longer
    for i in range(max(math.ceil(ahead - half / PLACE), 0), min(last, PLACES)):
        known[i] = max(known[i], under)
    place = math.floor(arc)
    if stands and 0 <= place < PLACES:
        known[place] = CLOSED
        if place + 2 < PLACES:  # one further, for a noisy node
            wall[place + 2] = 0


@compiled
def foremost(places: Bytes, known: Bytes, first: int, last: int) -> int:
    """The foremost place, from `first` to `last`, in which a vehicle may be hidden that can come on; -1: none.

    Who could be hidden only just behind a known vehicle follows it, and is not asked for.
    """
    i = last
    while i >= first:
        if known[i] == CLOSED:
            return -1
        if 0 < places[i] <= PATIENCE and not known[i]:
            end = i
            while end >= first and places[end] and not known[end]:
                end -= 1
            behind = i + 1 < known.shape[0] and known[i + 1] == LEADS
            if not behind or i - end > FOLLOWS or end < first:
                return i
            i = end
        else:
            i -= 1
    return -1
