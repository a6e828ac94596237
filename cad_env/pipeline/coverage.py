"""What a vehicle sees to be empty: places of lanes in which a vehicle, were one there, would by now be a known track.

A place is *seen* in a frame if a vehicle with its centre anywhere in it would be: the first of the five points that
sensing asks for is the centre, and asking for it alone claims less than asking for all. A place is *vouched for* if it
and all places in which a vehicle could have been that is in it now were seen in each of the newest frames, so many that
the vehicle would be a track by now, and nothing that is known of is in it. Vehicles drive forwards, up to TOP_SPEED.

Everything is in the frame of the vehicle's own fix, as its detections are: a wrong fix vouches for places beside those
that were seen. So what is said to others is shrunk by what the fix may be wrong.
"""

import math
from typing import NamedTuple

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part, inlined_part
from cad_env.pipeline.sense import MOUNT, Sensing
from cad_env.pipeline.track import BIRTH_HITS, Tracks
from cad_env.types import FRAMES, Bytes, Floats, Ints
from cad_env.world.lanes import PLACE, PLACES, Lanes
from cad_env.world.state import OFF, World

SLACK = 0.4  # m that the centre of a vehicle may be off the place that stands for it: every box is taken to be larger
ON_LANE = 1.75  # m from the middle of a lane, within which what is there is on it
OCCUPIED = 2.5  # m before and behind the centre of a known vehicle, in which no place is empty
_BODY = 4.2  # m before and behind the centre of a vehicle, where nobody else's can be: there it hides none but itself
UNKNOWN = 0.005  # of the vehicles that are in sight for so many frames, the share that may have no track


class Coverage(NamedTuple):
    """What V vehicles have seen to be empty on B lanes of P places; F frames make sure that a vehicle has a track."""

    seen: Bytes  # (V, B, F, P) 1 where a vehicle would have been seen in each of the newest 1, 2, ... F frames
    vouched: Bytes  # (V, B, P) 1 where there is none now
    corner: Floats  # scratch: (N, 4, 2) m, of boxes that are SLACK larger to every side
    near: Floats  # scratch: (N, 3) m, of who is in reach: its centre, seen from the eye, and the radius around its box


def new_coverage(vehicles: int, world: int, lanes: Lanes, miss: float) -> Coverage:
    """Nothing has been seen yet by so many `vehicles` among those of a `world`."""
    count = len(lanes.start)
    return Coverage(
        seen=np.zeros((vehicles, count, frames_needed(miss), PLACES), np.uint8),
        vouched=np.zeros((vehicles, count, PLACES), np.uint8),
        corner=np.zeros((world if count else 0, 4, 2)),
        near=np.zeros((world if count else 0, 3)),
    )


def frames_needed(miss: float) -> int:
    """Frames in sight, BIRTH_HITS or more, after which at most UNKNOWN of all vehicles have no track; 0: never so few.

    What has a track, confirmed or not, is in no vouched place. Before it is confirmed two misses in a row end a track,
    and for a fast vehicle one right after the first detection begins it anew: its next detection is out of the gate.

    >>> frames_needed(0.0), frames_needed(0.05), frames_needed(0.1), frames_needed(1.0)
    (3, 3, 5, 0)
    """
    hit = 1.0 - miss
    none, once, once_missed, twice, twice_missed = 1.0, 0.0, 0.0, 0.0, 0.0  # probabilities; the rest is confirmed
    for frame in range(1, FRAMES + 1):
        none, once, once_missed, twice, twice_missed = (
            miss * (none + once_missed + twice_missed), hit * (none + once_missed), miss * once, hit * once,
            miss * twice,
        )  # fmt: skip
        if frame >= BIRTH_HITS and none <= UNKNOWN:
            return frame
    return 0


@compiled
def outer_corners(world: World, outlines: Floats, corner: Floats) -> None:
    """Write the corners of all boxes, SLACK larger to every side, to corner (N, 4, 2); outlines as `sense.outline`."""
    for k in range(corner.shape[0]):
        cos, sin = outlines[k, 0], outlines[k, 1]
        along, across = 0.5 * world.size[k, 0] + SLACK, 0.5 * world.size[k, 1] + SLACK
        for c in range(4):
            ahead = along if c < 2 else -along
            left = across if c % 2 == 0 else -across
            corner[k, c, 0] = world.position[k, 0] + ahead * cos - left * sin
            corner[k, c, 1] = world.position[k, 1] + ahead * sin + left * cos


@compiled_part
def look_at_lanes(world: World, outlines: Floats, lanes: Lanes, observer: int, sensor: Sensing, pose: Floats,
                  seen: Bytes, corner: Floats, near: Floats, row: Ints) -> None:  # fmt: skip
    """One frame of what an observer sees of all lanes, by its own fix `pose`: seen (B, F, P).

    corner as from `outer_corners`; near (N, 3) and row (N,) are scratch.
    """
    x, y = world.position[observer, 0], world.position[observer, 1]
    wrong = pose[2] - world.heading[observer]
    cos, sin = math.cos(wrong), math.sin(wrong)
    ahead = MOUNT * world.size[observer, 0]
    eye = (x + ahead * outlines[observer, 0], y + ahead * outlines[observer, 1])
    reach = sensor.range - SLACK
    count = _in_reach(world, outlines, observer, eye, reach, near, row)
    frames = seen.shape[1]
    for b in range(seen.shape[0] if frames > 0 else 0):
        for k in range(frames - 1, 0, -1):
            _age(seen[b, k - 1], seen[b, k])
        for i in range(PLACES):
            seen[b, 0, i] = 0
        for s in range(lanes.pieces[b], lanes.pieces[b + 1]):
            # Where the piece is if the fix is right about the observer: what is seen there is placed by the fix.
            px, py = lanes.piece[s, 0] - pose[0], lanes.piece[s, 1] - pose[1]
            ux, uy = lanes.piece[s, 2], lanes.piece[s, 3]
            line = (x + px * cos + py * sin, y + py * cos - px * sin, ux * cos + uy * sin, uy * cos - ux * sin)
            first, last = lanes.piece_places[s, 0], lanes.piece_places[s, 1]
            _look_along(corner, near, row, count, eye, reach, line, lanes.piece[s, 4], seen[b, 0, first:last])
        for k in range(1, frames):
            for i in range(PLACES):
                seen[b, k, i] &= seen[b, 0, i]


@inlined_part
def _age(newer: Bytes, older: Bytes) -> None:
    """A frame later: where a vehicle would have been seen for one frame more, wherever it then was."""
    older[0] = 0
    came, stayed, now = newer[: PLACES - 1], newer[1:], older[1:]
    for i in range(PLACES - 1):
        now[i] = came[i] & stayed[i]


@inlined_part
def _in_reach(world: World, outlines: Floats, observer: int, eye: tuple[float, float], reach: float, near: Floats,
              row: Ints) -> int:  # fmt: skip
    """Write to near and row who may hide anything within reach, and answer how many."""
    count = 0
    for k in range(outlines.shape[0]):
        if k == observer or world.driver[k] == OFF:
            continue
        dx, dy = world.position[k, 0] - eye[0], world.position[k, 1] - eye[1]
        radius = outlines[k, 2] + 2.0 * SLACK
        if dx * dx + dy * dy < (reach + radius) * (reach + radius):
            near[count, 0], near[count, 1], near[count, 2], row[count] = dx, dy, radius, k
            count += 1
    return count


@inlined_part
def _look_along(corner: Floats, near: Floats, row: Ints, count: int, eye: tuple[float, float], reach: float,
                line: tuple[float, float, float, float], length: float, seen: Bytes) -> None:  # fmt: skip
    """Set the places seen (n,) of a straight piece of a lane: those within reach that no box hides any part of."""
    x, y, ux, uy = line
    along = (eye[0] - x) * ux + (eye[1] - y) * uy
    side = (eye[1] - y) * ux - (eye[0] - x) * uy
    sign, height = (1.0, side) if side >= 0.0 else (-1.0, -side)
    if height >= reach:
        return
    half, size = math.sqrt(reach * reach - height * height), length / seen.shape[0]
    first = max(math.ceil((along - half) / size), 0)
    last = min(math.floor((along + half) / size), seen.shape[0])
    if last <= first:
        return
    for i in range(first, last):
        seen[i] = 1
    low, high = first * size - along, last * size - along
    to_low, to_high = math.sqrt(low * low + height * height), math.sqrt(high * high + height * height)
    for n in range(count):
        dx, dy, radius = near[n, 0], near[n, 1], near[n, 2]
        a, b = dx * ux + dy * uy, sign * (dy * ux - dx * uy)  # along the line and towards it, from the eye
        # Boxes beside the triangle of the eye and the places: most are.
        if b > radius or b + height < -radius or low * b + height * a < -radius * to_low:
            continue
        if high * b + height * a > radius * to_high:
            continue
        start, end = _shadow(corner[row[n]], line, sign, along, height)
        body = along + (a - _BODY if abs(b + height) < ON_LANE else math.inf)
        for i in range(max(first, math.floor(start / size)), min(last, math.floor(min(end, length) / size) + 1)):
            # Only where another one could be does a shadow hide anybody.
            if max(i * size, start) < body or min((i + 1) * size, end) > body + 2.0 * _BODY:
                seen[i] = 0


@compiled_part
def _shadow(corner: Floats, line: tuple[float, float, float, float], sign: float, along: float,
            height: float) -> tuple[float, float]:  # fmt: skip
    """(from, to), m along a line, of what a box with these corners hides from an eye `height` m beside `along`."""
    start, end, least, most = math.inf, -math.inf, math.inf, -math.inf
    level = beyond = before = False
    for c in range(4):
        dx, dy = corner[c, 0] - line[0], corner[c, 1] - line[1]
        a, b = dx * line[2] + dy * line[3], sign * (dy * line[2] - dx * line[3])
        least, most = min(least, a), max(most, a)
        if b >= height - 1e-6:  # no line of sight past this corner comes to the lane
            level = True
        elif b >= 0.0:
            before = True
            hit = along + (a - along) * height / (height - b)
            start, end = min(start, hit), max(end, hit)
        else:
            beyond = True
    if not before and not (level and beyond):
        return 0.0, -1.0
    if beyond:  # the box is over the line
        start, end = min(start, least), max(end, most)
    if level and least < along:
        start = -1e9
    if level and most > along:
        end = 1e9
    return start, end


@compiled_part
def vouch(lanes: Lanes, tracks: Tracks, pose: Floats, frame: Floats, seen: Bytes, vouched: Bytes) -> None:
    """Write to vouched (B, P) what was seen (B, F, P) for long enough and has nothing known in it, by the own fix.

    frame (3,): the change of frames from that of the tracks to that of the lanes, in which `pose` is.
    """
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    frames = seen.shape[1]
    for b in range(vouched.shape[0]):
        some = False
        for i in range(PLACES):
            vouched[b, i] = seen[b, frames - 1, i] if frames > 0 else 0
            some |= vouched[b, i] != 0
        if not some:
            continue
        for s in range(lanes.pieces[b], lanes.pieces[b + 1]):
            places = vouched[b, lanes.piece_places[s, 0] : lanes.piece_places[s, 1]]
            _occupy(lanes.piece[s], pose[0], pose[1], places)
            for i in range(tracks.used[0]):
                x, y = tracks.mean[i, 0], tracks.mean[i, 1]
                _occupy(lanes.piece[s], frame[0] + x * cos - y * sin, frame[1] + x * sin + y * cos, places)


@compiled_part
def shrink(vouched: Bytes, spread: float, shrunk: Bytes) -> None:
    """Write to shrunk (B, P) the places that are vouched for at least two standard deviations, m, within the border."""
    margin = int(2.0 * spread / PLACE + 0.5)
    for b in range(vouched.shape[0]):
        streak = 0
        for i in range(PLACES):
            shrunk[b, i] = 0
            streak = streak + 1 if vouched[b, i] else 0
            if streak > 2 * margin:
                shrunk[b, i - margin] = 1


@inlined_part
def _occupy(piece: Floats, x: float, y: float, places: Bytes) -> None:
    """Nothing is empty around what is at (x, y), if it is on the lane."""
    dx, dy = x - piece[0], y - piece[1]
    if abs(dy * piece[2] - dx * piece[3]) > ON_LANE:
        return
    a, size = dx * piece[2] + dy * piece[3], piece[4] / places.shape[0]
    first, last = math.floor((a - OCCUPIED) / size), math.floor((a + OCCUPIED) / size)
    for i in range(max(0, first), min(places.shape[0], last + 1)):
        places[i] = 0
