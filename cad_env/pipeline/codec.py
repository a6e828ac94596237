"""A graph as bytes: what one vehicle puts on the air, and the only bytes that another accepts.

A message stands alone; no receiver needs an earlier one. It holds the newest `depth` frames in whole centimetres:

    "CG"  version  depth  resolution (cm)  number of tracks     six bytes
    sender                                                      two bytes, the lowest first (as in all that follows)
    time of the newest frame (ms)                               four bytes
    for each track:
        id and kind                                             varint of 2 id + kind
        frames and height                                       two bytes: bit a is set if the track was seen `a`
                                                                frames before the newest, bit 15 if its height varies
        x, then y, then z                                       each walks from the newest node to the oldest
    in versions 2 and 4, which places of which lanes are vouched for   see `intervals`
    in versions 3 and 4, the pose of the sender                 see `stated_pose`
    CRC-32 of all before                                        four bytes

In versions 1 and 2 positions are in the world; in versions 3 and 4 in the sender's own odometry frame, and the first
track is its body in the newest frame.

The first node of a walk is the difference to the first track's newest position, which itself is coded in full: the
first track of a vehicle's graph is its own body, and what it sees is close. Each older node is the difference to what
the newer ones predict, last + pace x gap: docs/perception-and-radio.md has the rule and a worked example. Differences
are zigzag varints: one byte up to 63 cm. A height that stays the same is written once.

The prediction follows half of each surprise, which divides the variance that noisy positions cause by 1.8 against
the line through two nodes, and is only shifts and sums of integers: every machine reads the same bytes alike.
A graph has one spelling and `decode` accepts no other, so what was accepted would be written alike again.
The CRC finds corruption. It is no authentication: anyone can write a message that is accepted.
"""

from dataclasses import dataclass

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.pipeline.graph_arrays import as_graph, empty_graph_arrays, graph_arrays
from cad_env.pipeline.intervals import FORMAT_LANES, max_places_bytes, put_places, take_places
from cad_env.pipeline.stated_pose import (
    POSE_BYTES,
    STATED,
    StatedPose,
    put_stated_pose,
    stated_pose,
    take_stated_pose,
)
from cad_env.pipeline.varint import (
    REACH,
    TRUNCATED,
    VARINT_BYTES,
    DecodeError,
    crc32,
    frames_seen,
    named_before,
    newest_column,
    put_fixed,
    put_varint,
    put_walk,
    set_nodes,
    take_fixed,
    take_varint,
    take_walk,
    to_units,
    varies_along,
)
from cad_env.types import CAR, FRAMES, MAX_TRACKS, TRUCK, Bytes, Floats, Graph, GraphArrays, Ints
from cad_env.world.lanes import PLACES

VERSION = 1
WITH_PLACES = 2  # the version of a message that also says what its sender has seen to be empty
WITH_POSE, WITH_POSE_AND_PLACES = 3, 4  # versions of a message in its sender's own frame, which states its pose
FORMAT_TRACKS = 255  # that the format can count
MAX_SENDER = 2**16 - 1
MAX_TIME = 2**32 - 1  # ms
MAX_ID = 2**31 - 1

_MAGIC = 0x4743  # "CG"
_RESOLUTION = 1  # cm
_HEADER = 12  # bytes
_CRC = 4  # bytes
_START = np.int64(_HEADER)  # of a numpy type: numba compiles a function anew for every plain number in a call of it
_NO_PLACES = np.zeros((0, PLACES), np.uint8)
_VARIES = 15  # the bit of the frames that says that the height is not one


def max_bytes(tracks: int, lanes: int = 0) -> int:
    """No message of so many tracks, and places on so many lanes, is longer.

    >>> max_bytes(0)
    16
    """
    places = max_places_bytes(lanes) if lanes else 0
    return _HEADER + tracks * (VARINT_BYTES + 2 + 3 * FRAMES * VARINT_BYTES) + places + _CRC


MAX_BYTES = max_bytes(MAX_TRACKS)

# What `read` answers, and why it refuses. 1 to 3 are the reasons of `varint`, 11 to 13 of `intervals`, 14 of
# `stated_pose`.
DECODED, FORMAT, CORRUPT, CAPACITY, NO_NODE, IDENTITY, SPELLING, TRAILING = 0, 4, 5, 6, 7, 8, 9, 10
NO_BODY = 15
DECODE_REASONS = (
    "accepted",
    "it ends too early",
    "a varint longer than its value needs",
    "a position too far out",
    "unknown magic, version, resolution or depth",
    "its CRC-32 does not match",
    "more tracks than there is room for",
    "a track without a node in the frames sent, or with one outside them",
    "a track id that is too large or there twice",
    "a constant height that is spelt out",
    "bytes after the last track",
    "a place beyond the end of its lane",
    "places on a lane that is not there",
    "a last lane without a place",
    "no pose that can be stated",
    "a stated pose without a body",
)


@compiled
def write(buffer: Bytes, sender: int, time_ms: int, depth: int, rows: GraphArrays) -> int:
    """Write the newest `depth` frames of `rows` and answer the length; -1 if a node is not within REACH.

    `buffer` must hold MAX_BYTES, or `max_bytes(count)`. Sender, time and ids are the caller's to keep in range
    and unique. A track without a node in those frames is left out.
    """
    at = _put_graph(buffer, VERSION, sender, time_ms, depth, rows)
    return -1 if at < 0 else put_fixed(buffer, at, crc32(buffer, at), _CRC)


@compiled
def write_with_places(buffer: Bytes, sender: int, time_ms: int, depth: int, rows: GraphArrays, places: Bytes) -> int:
    """As `write`, and also the places (B, P) that are vouched for; `buffer` must hold `max_bytes(MAX_TRACKS, B)`."""
    at = _put_graph(buffer, WITH_PLACES, sender, time_ms, depth, rows)
    if at < 0:
        return -1
    at = put_places(buffer, at, places)
    return put_fixed(buffer, at, crc32(buffer, at), _CRC)


@compiled
def write_with_pose(
    buffer: Bytes, sender: int, time_ms: int, depth: int, rows: GraphArrays, places: Bytes, stated: Floats
) -> int:
    """As `write`, in the sender's own frame, with its pose (STATED,), and places (B, P) if B is not 0.

    `buffer` must hold `max_bytes(MAX_TRACKS, B) + POSE_BYTES`.
    """
    at = _put_graph(buffer, WITH_POSE if places.shape[0] == 0 else WITH_POSE_AND_PLACES, sender, time_ms, depth, rows)
    if at < 0:
        return -1
    if places.shape[0] > 0:
        at = put_places(buffer, at, places)
    at = put_stated_pose(buffer, at, stated)
    return put_fixed(buffer, at, crc32(buffer, at), _CRC)


@compiled_part
def _put_graph(buffer: Bytes, version: int, sender: int, time_ms: int, depth: int, rows: GraphArrays) -> int:
    """All but what comes after the tracks; answers where that goes, or -1."""
    at, tracks = _HEADER, 0
    origin = np.zeros(3, np.int64)
    for row in range(rows.used[0]):
        frames = frames_seen(rows.mask, row, depth)
        if frames == 0:
            continue
        varies = varies_along(rows.position, row, 2, frames)
        at = put_varint(buffer, at, rows.track[row] << 1 | rows.kind[row])
        at = put_fixed(buffer, at, frames | varies << _VARIES, 2)
        newest = newest_column(frames)
        for axis in range(3):
            walked = frames if axis < 2 or varies else 1 << FRAMES - 1 - newest
            at = put_walk(buffer, at, rows.position, row, axis, walked, origin[axis])
            if at < 0:
                return -1
            if tracks == 0:
                origin[axis] = to_units(rows.position[row, newest, axis])
        tracks += 1
    put_fixed(buffer, 0, _MAGIC | version << 16 | depth << 24, 4)
    put_fixed(buffer, 4, _RESOLUTION | tracks << 8 | sender << 16, 4)
    put_fixed(buffer, 8, time_ms, 4)
    return at


@compiled
def read(buffer: Bytes, length: int, header: Ints, rows: GraphArrays) -> int:
    """Read buffer[:length] into `header`, (3,) int64 sender, time in ms and depth, and `rows`; answers DECODED.

    Any other answer is an index of DECODE_REASONS and leaves no row in use. Absent nodes get position 0.
    """
    rows.used[0] = 0
    status = _check_envelope(buffer, length, VERSION, VERSION)
    if status != DECODED:
        return status
    at = _take_graph(buffer, length, header, rows)
    return -at if at < 0 else _end(rows, int(buffer[5]), at, length)


@compiled
def read_with_places(buffer: Bytes, length: int, header: Ints, rows: GraphArrays, places: Bytes) -> int:
    """As `read`, of both versions, with the places (B, P) that are vouched for: none by the first version."""
    at = _take_graph_and_places(buffer, length, VERSION, WITH_PLACES, header, rows, places)
    return -at if at < 0 else _end(rows, int(buffer[5]), at, length)


@compiled
def read_with_pose(buffer: Bytes, length: int, header: Ints, rows: GraphArrays, places: Bytes, stated: Floats) -> int:
    """As `read_with_places`, of the versions that state a pose, and that pose (STATED,)."""
    at = _take_graph_and_places(buffer, length, WITH_POSE, WITH_POSE_AND_PLACES, header, rows, places)
    if at >= 0:
        at = take_stated_pose(buffer, at, length - _CRC, stated)
    if at >= 0 and (buffer[5] == 0 or rows.track[0] != 0 or not rows.mask[0, FRAMES - 1]):
        return NO_BODY
    return -at if at < 0 else _end(rows, int(buffer[5]), at, length)


@compiled_part
def _take_graph_and_places(buffer: Bytes, length: int, without: int, with_places: int, header: Ints,
                           rows: GraphArrays, places: Bytes) -> int:  # fmt: skip
    """Read a message of one of two versions up to the places, which one of them has; answers as `_take_graph`."""
    rows.used[0] = 0
    places[:] = 0
    status = _check_envelope(buffer, length, without, with_places)
    if status != DECODED:
        return -status
    at = _take_graph(buffer, length, header, rows)
    if at >= 0 and buffer[2] == with_places:
        at = take_places(buffer, at, length - _CRC, places)
    return int(at)


@compiled_part
def _take_graph(buffer: Bytes, length: int, header: Ints, rows: GraphArrays) -> int:
    """Read header and tracks; answers where the tracks end, or the negative of the reason."""
    tracks = int(buffer[5])
    if tracks > rows.track.shape[0]:
        return -CAPACITY
    header[0], header[1], header[2] = take_fixed(buffer, 6, 2), take_fixed(buffer, 8, 4), int(buffer[3])
    at, end = _START, length - _CRC
    origin = np.zeros(3, np.int64)
    for row in range(tracks):
        at = _take_track(buffer, at, end, rows, row, header[2], origin)
        if at < 0:
            return int(at)
    return int(at)


@compiled_part
def _end(rows: GraphArrays, tracks: int, at: int, length: int) -> int:
    """Put the rows in use if the message ends where it should."""
    if at != length - _CRC:
        return TRAILING
    rows.used[0] = tracks
    return DECODED


@compiled_part
def _check_envelope(buffer: Bytes, length: int, oldest: int, newest: int) -> int:
    """DECODED for a message of a version from `oldest` to `newest` that is whole, or why it is none."""
    if length < _HEADER + _CRC or length > buffer.shape[0]:
        return TRUNCATED
    known = take_fixed(buffer, 0, 2) == _MAGIC and oldest <= buffer[2] <= newest and buffer[4] == _RESOLUTION
    if not known or not 1 <= buffer[3] <= FRAMES:
        return FORMAT
    if crc32(buffer, length - _CRC) != take_fixed(buffer, length - _CRC, _CRC):
        return CORRUPT
    return DECODED


@compiled_part
def _take_track(buffer: Bytes, at: int, end: int, rows: GraphArrays, row: int, depth: int, origin: Ints) -> int:
    name, at = take_varint(buffer, at, end)
    if at < 0:
        return at
    if at + 2 > end:
        return -TRUNCATED
    frames = take_fixed(buffer, at, 2)
    varies, frames = frames >> _VARIES, frames & (1 << _VARIES) - 1
    if frames == 0 or frames >> depth:
        return -NO_NODE
    rows.track[row], rows.kind[row] = name >> 1, name & 1
    if rows.track[row] > MAX_ID or named_before(rows.track, row):
        return -IDENTITY
    newest = newest_column(frames)
    at += 2
    for axis in range(3):
        walked = frames if axis < 2 or varies else 1 << FRAMES - 1 - newest
        at = take_walk(buffer, at, end, rows.position, row, axis, walked, origin[axis])
        if at < 0:
            return at
        if row == 0:
            origin[axis] = to_units(rows.position[row, newest, axis])
    if varies and not varies_along(rows.position, row, 2, frames):
        return -SPELLING
    set_nodes(rows, row, frames, varies)
    return at


def encode(graph: Graph, depth: int = FRAMES, places: Bytes | None = None, pose: StatedPose | None = None) -> bytes:
    """The newest `depth` frames of a graph as a message; ValueError where the graph is not one that can be sent.

    places (B, P): those that the sender has seen to be empty, in a message of version 2; None: version 1. With a pose
    the graph is in the sender's own frame, and the message of version 4, or 3 without places.

    >>> still = np.zeros((1, FRAMES, 3))
    >>> graph = Graph(7, 1.5, np.array([0]), still, np.ones((1, FRAMES), bool), np.array([CAR], np.int8))
    >>> len(encode(graph)), len(encode(graph, depth=1)), decode(encode(graph)).time
    (50, 22, 1.5)
    >>> len(encode(graph, places=np.zeros((8, PLACES), np.uint8)))
    51
    >>> len(encode(graph, pose=StatedPose(0.0)))
    53
    """
    check_graph(graph, depth)
    rows, time_ms = graph_arrays(graph), round(graph.time * 1000.0)
    chosen = _NO_PLACES if places is None else _checked_places(places)
    buffer = np.empty(max_bytes(len(graph.track), len(chosen)) + POSE_BYTES, np.uint8)
    if pose is not None:
        size = write_with_pose(buffer, graph.sender, time_ms, depth, rows, chosen, _checked_pose(graph, pose))
    elif places is None:
        size = write(buffer, graph.sender, time_ms, depth, rows)
    else:
        size = write_with_places(buffer, graph.sender, time_ms, depth, rows, chosen)
    return buffer[:size].tobytes()


def decode(payload: bytes) -> Graph:
    """The graph of a message of any version; DecodeError for any bytes that `encode` does not write."""
    return decode_message(payload).graph


def decode_with_places(payload: bytes) -> tuple[Graph, Bytes | None]:
    """The graph of a message, and the places (FORMAT_LANES, P) that its sender vouches for; None if it says none."""
    message = decode_message(payload)
    return message.graph, message.places


@dataclass(frozen=True)
class Message:
    """All that a message says."""

    graph: Graph
    places: Bytes | None  # (FORMAT_LANES, P) that its sender vouches for; None in versions 1 and 3
    pose: StatedPose | None  # None in versions 1 and 2


def decode_message(payload: bytes) -> Message:
    """All of a message of any version; DecodeError for any bytes that `encode` does not write."""
    longest = max_bytes(FORMAT_TRACKS, FORMAT_LANES) + POSE_BYTES
    if len(payload) > longest:
        raise DecodeError(f"message of {len(payload)} bytes refused: no graph takes more than {longest}")
    buffer, header, stated = np.array(bytearray(payload), np.uint8), np.zeros(3, np.int64), np.zeros(STATED)
    rows, places = empty_graph_arrays(rows=FORMAT_TRACKS), np.zeros((FORMAT_LANES, PLACES), np.uint8)
    version = payload[2] if len(payload) > 2 else VERSION
    if version in (WITH_POSE, WITH_POSE_AND_PLACES):
        status = read_with_pose(buffer, len(payload), header, rows, places, stated)
    else:
        status = read_with_places(buffer, len(payload), header, rows, places)
    if status != DECODED:
        raise DecodeError(f"message of {len(payload)} bytes refused: {DECODE_REASONS[status]}")
    return Message(
        as_graph(rows, int(header[0]), int(header[1]) / 1000.0),
        places if version in (WITH_PLACES, WITH_POSE_AND_PLACES) else None,
        stated_pose(stated) if version in (WITH_POSE, WITH_POSE_AND_PLACES) else None,
    )


def _checked_pose(graph: Graph, pose: StatedPose) -> Floats:
    """(STATED,) of a pose; ValueError where it, or its graph without a body, is not one that can be stated."""
    if len(graph.track) == 0 or graph.track[0] != 0 or not graph.mask[0, -1]:
        raise ValueError("a graph with a pose must have its sender's body as its first track, in the newest frame")
    _check("heading in rad", pose.heading, -1e6, 1e6)
    if pose.fix is not None:
        for value, most in zip((*pose.fix, *pose.accuracy), (REACH, REACH, 1e6, 180.0, np.pi), strict=True):
            _check("a number of a fix", value, -most if most > 180.0 else 0.0, most)
    return pose.numbers()


def _checked_places(places: Bytes) -> Bytes:
    """(B, P) as bytes; ValueError for what is not a set of places that can be sent."""
    chosen = np.ascontiguousarray(np.asarray(places) != 0, np.uint8)
    if chosen.ndim != 2 or chosen.shape[1] != PLACES or len(chosen) > FORMAT_LANES:
        raise ValueError(f"places must be (B, {PLACES}) of at most {FORMAT_LANES} lanes, got {chosen.shape}")
    return chosen


def check_graph(graph: Graph, depth: int = FRAMES) -> None:
    """Refuse a graph that cannot be sent with a one-line ValueError."""
    tracks = len(graph.track)
    _check("depth", depth, 1, FRAMES)
    _check("sender", graph.sender, 0, MAX_SENDER)
    _check("time in ms", graph.time * 1000.0, 0, MAX_TIME)
    _check("number of tracks", tracks, 0, FORMAT_TRACKS)
    shapes = (graph.position.shape, graph.mask.shape, graph.kind.shape)
    if shapes != ((tracks, FRAMES, 3), (tracks, FRAMES), (tracks,)):
        raise ValueError(f"position, mask and kind of {tracks} tracks x {FRAMES} frames have the shapes {shapes}")
    for track, kind in zip(graph.track, graph.kind, strict=True):
        _check("track id", track, 0, MAX_ID)
        _check("kind", kind, CAR, TRUCK)
    if len(np.unique(graph.track)) < tracks:
        raise ValueError(f"track ids must be unique, got {graph.track.tolist()}")
    for coordinate in graph.position[np.asarray(graph.mask, np.bool_)].flat:
        _check("coordinate in m", coordinate, -REACH, REACH)


def _check(name: str, value: float, low: float, high: float) -> None:
    # Written as a negation, this refuses NaN too.
    if not low <= value <= high:
        raise ValueError(f"{name} must be from {low:g} to {high:g}, got {value!r}")
