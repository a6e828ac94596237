"""Which places of which lanes, as bytes: for each lane its intervals, from its first place on.

    number of lanes     varint; the last one has an interval, all after it have none
    for each lane:
        intervals       varint
        for each:       two varints: places left out since the one before (the first: since place 0), less 1 after the
                        first, as two intervals do not touch; and places in it, less 1

One spelling for each set of places, and integers only.
"""

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.pipeline.varint import put_varint, take_varint
from cad_env.types import Bytes
from cad_env.world.lanes import PLACES

FORMAT_LANES = 255  # that the format can count
BEYOND_LANE = 11  # a place is beyond the end of its lane
NO_LANE = 12  # there are fewer lanes
_EIGHT = 0x0101010101010101  # eight places that are all set
NO_PLACE = 13  # the last lane has no place


def max_places_bytes(lanes: int) -> int:
    """No set of places on so many lanes takes more."""
    return 2 + lanes * (1 + 2 * (PLACES // 2))


@compiled
def put_places(buffer: Bytes, at: int, chosen: Bytes) -> int:
    """Write which places of chosen (B, P) are set; answers where the next value goes."""
    lanes, eight = chosen.shape[0], chosen.view(np.int64)  # places at once, most of which are alike
    while lanes > 0 and not eight[lanes - 1].any():
        lanes -= 1
    at = put_varint(buffer, at, lanes)
    for b in range(lanes):
        places, where, count = chosen[b], at, 0  # of half as many intervals as places at most: one byte
        at += 1
        i = before = 0
        while i < PLACES:
            if places[i] == 0:
                i += 8 if i % 8 == 0 and eight[b, i // 8] == 0 else 1
                continue
            start = i
            while i < PLACES and places[i] != 0:
                i += 8 if i % 8 == 0 and eight[b, i // 8] == _EIGHT else 1
            at = put_varint(buffer, at, start - before - (count > 0))
            at = put_varint(buffer, at, i - start - 1)
            before, count = i, count + 1
        buffer[where] = count
    return at


@compiled
def take_places(buffer: Bytes, at: int, end: int, chosen: Bytes) -> int:
    """Read what `put_places` writes to chosen (B, P); answers where the next value is, or the negative of a reason."""
    chosen[:] = 0
    lanes, at = take_varint(buffer, at, end)
    if at < 0:
        return at
    if lanes > chosen.shape[0]:
        return -NO_LANE
    for b in range(lanes):
        count, at = take_varint(buffer, at, end)
        if at < 0:
            return at
        if b == lanes - 1 and count == 0:
            return -NO_PLACE
        at = _take_intervals(buffer, at, end, chosen[b], count)
        if at < 0:
            return at
    return at


@compiled_part
def _take_intervals(buffer: Bytes, at: int, end: int, places: Bytes, count: int) -> int:
    i = 0
    for k in range(count):
        gap, at = take_varint(buffer, at, end)
        if at < 0:
            return at
        more, at = take_varint(buffer, at, end)
        if at < 0:
            return at
        start = i + gap + (k > 0)
        i = start + more + 1
        if i > PLACES:
            return -BEYOND_LANE
        for place in range(start, i):
            places[place] = 1
    return at


def places_of(intervals: list[list[tuple[int, int]]]) -> Bytes:
    """(B, P) of the intervals [first place, one past the last) of each lane.

    >>> places_of([[], [(3, 5)]])[1, :6].tolist()
    [0, 0, 0, 1, 1, 0]
    """
    chosen = np.zeros((len(intervals), PLACES), np.uint8)
    for b, lane in enumerate(intervals):
        for first, last in lane:
            chosen[b, first:last] = 1
    return chosen


def intervals_of(chosen: Bytes) -> list[list[tuple[int, int]]]:
    """Of every lane of chosen (B, P), its intervals [first place, one past the last).

    >>> intervals_of(places_of([[], [(3, 5), (6, 7)]]))
    [[], [(3, 5), (6, 7)]]
    """
    edge = np.diff(np.pad(np.asarray(chosen, bool), ((0, 0), (1, 1))).astype(np.int8), axis=1)
    return [
        list(zip(np.flatnonzero(lane == 1).tolist(), np.flatnonzero(lane == -1).tolist(), strict=True)) for lane in edge
    ]
