"""The parts of a message below its meaning: numbers, the walk along one coordinate of a track, and the CRC-32.

Every value stays far inside int64, so that compiled and plain Python arithmetic agree to the last bit. A function
that takes from a buffer never looks beyond `end`; where it finds no acceptable value, the place it answers is the
negative of the reason.
"""

import math

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.types import FRAMES, Bools, Bytes, Floats, GraphArrays, Ints

REACH = 100_000.0  # m, the largest coordinate
UNITS = 100  # units a metre: the resolution is 1 cm
VARINT_BYTES = 5  # 35 bits: more than the largest residual and the largest id need
TRUNCATED = 1  # the varint is cut off by the end
LONG_VARINT = 2  # the varint has more bytes than its value needs, or than any value here needs
OUTSIDE = 3  # a coordinate is beyond REACH, or no number

_LIMIT = int(REACH) * UNITS


def _crc_tables() -> Ints:
    """(8, 256) of the reversed polynomial of IEEE 802.3; table k looks one byte up that is k bytes further on."""
    table = np.zeros((8, 256), np.int64)
    for byte in range(256):
        rest = byte
        for _ in range(8):
            rest = rest >> 1 ^ (0xEDB88320 if rest & 1 else 0)
        table[0, byte] = rest
    for ahead in range(1, 8):
        table[ahead] = table[0, table[ahead - 1] & 255] ^ table[ahead - 1] >> 8
    return table


_TABLE = _crc_tables()


class DecodeError(ValueError):
    """These bytes are not a message that the encoder of their kind writes."""


@compiled
def crc32(buffer: Bytes, length: int) -> int:
    """The CRC-32 of buffer[:length], as zlib counts it; eight bytes at a time, for one look-up waits on the last."""
    crc = 0xFFFFFFFF
    whole = length - length % 8
    for at in range(0, whole, 8):
        crc ^= take_fixed(buffer, at, 4)
        more = take_fixed(buffer, at + 4, 4)
        crc = (
            _TABLE[7, crc & 255] ^ _TABLE[6, crc >> 8 & 255] ^ _TABLE[5, crc >> 16 & 255] ^ _TABLE[4, crc >> 24]
            ^ _TABLE[3, more & 255] ^ _TABLE[2, more >> 8 & 255] ^ _TABLE[1, more >> 16 & 255] ^ _TABLE[0, more >> 24]
        )  # fmt: skip
    for at in range(whole, length):
        crc = _TABLE[0, (crc ^ int(buffer[at])) & 255] ^ crc >> 8
    return crc ^ 0xFFFFFFFF


@compiled
def put_fixed(buffer: Bytes, at: int, value: int, width: int) -> int:
    """Write `value` in `width` bytes, the lowest first; answers where the next value goes."""
    for index in range(width):
        buffer[at + index] = value >> 8 * index & 255
    return at + width


@compiled
def take_fixed(buffer: Bytes, at: int, width: int) -> int:
    """The value of `width` bytes, the lowest first; the caller has checked that they are there."""
    value = 0
    for index in range(width):
        value |= int(buffer[at + index]) << 8 * index
    return value


@compiled
def put_varint(buffer: Bytes, at: int, value: int) -> int:
    """Write `value` >= 0 in groups of seven bits, the lowest first; answers where the next value goes."""
    while value > 127:
        buffer[at] = value & 127 | 128
        value >>= 7
        at += 1
    buffer[at] = value
    return at + 1


@compiled
def take_varint(buffer: Bytes, at: int, end: int) -> tuple[int, int]:
    """(value, where the next one begins); the place is -TRUNCATED or -LONG_VARINT where the bytes are no varint."""
    value = 0
    for index in range(VARINT_BYTES):
        if at + index >= end:
            return 0, -TRUNCATED
        byte = int(buffer[at + index])
        value |= (byte & 127) << 7 * index
        if byte < 128:
            # A last group of zero adds nothing to the value: it could be written without.
            return (0, -LONG_VARINT) if byte == 0 and index > 0 else (value, at + index + 1)
    return 0, -LONG_VARINT


@compiled
def to_units(metres: float) -> int:
    """To the nearest unit, a half always upwards; beyond any accepted value if that is outside."""
    # Written as a negation, the test also catches what is not a number.
    if not abs(metres) <= REACH:
        return 2 * _LIMIT
    return math.floor(metres * UNITS + 0.5)


@compiled
def frames_seen(mask: Bools, row: int, depth: int) -> int:
    """Bit a is set if the row has a node `a` frames before the newest, for the newest `depth` frames."""
    frames = 0
    for age in range(depth):
        frames |= int(mask[row, FRAMES - 1 - age]) << age
    return frames


@compiled
def newest_column(frames: int) -> int:
    """The column of the newest node."""
    age = 0
    while not frames >> age & 1:
        age += 1
    return FRAMES - 1 - age


@compiled
def varies_along(position: Floats, row: int, axis: int, frames: int) -> bool:
    """Whether one coordinate of the nodes `frames` of a row is not the same in all of them."""
    first = position[row, newest_column(frames), axis]
    for age in range(FRAMES):
        now = position[row, FRAMES - 1 - age, axis]
        if frames >> age & 1 and now != first and to_units(now) != to_units(first):
            return True
    return False


@compiled_part
def _next_pace(pace: int, surprise: int, gap: int, nodes: int) -> int:
    """Units per frame after a node, the `nodes`-th from 0, that was a surprise after `gap` frames.

    The second node is the first to show a motion, so all of its surprise counts, then half of each.
    Halving again for each frame of a gap stands for the division by the gap.
    """
    if nodes == 0:
        return 0
    return pace + (surprise >> (gap - 1 if nodes == 1 else gap))


@compiled
def put_walk(buffer: Bytes, at: int, position: Floats, row: int, axis: int, frames: int, value: int) -> int:
    """Write one coordinate of the nodes `frames` of a row; `value` is the best guess before the newest.

    Answers where the next walk begins, or -OUTSIDE. Bit a of `frames` is the node `a` frames before the newest.
    """
    pace, gap, nodes = 0, 0, 0
    for age in range(FRAMES):
        gap += 1
        if frames >> age & 1:
            now = to_units(position[row, FRAMES - 1 - age, axis])
            if abs(now) > _LIMIT:
                return -OUTSIDE
            surprise = now - value - pace * gap
            folded = surprise << 1 ^ surprise >> 63
            if folded < 128:
                buffer[at] = folded
                at += 1
            else:
                at = put_varint(buffer, at, folded)
            pace = _next_pace(pace, surprise, gap, nodes)
            value, gap, nodes = now, 0, nodes + 1
    return at


@compiled
def take_walk(buffer: Bytes, at: int, end: int, position: Floats, row: int, axis: int, frames: int, value: int) -> int:
    """Read what `put_walk` writes; answers where the next walk begins, or the negative of the reason."""
    pace, gap, nodes = 0, 0, 0
    for age in range(FRAMES):
        gap += 1
        if frames >> age & 1:
            if at < end and buffer[at] < 128:
                folded, at = int(buffer[at]), at + 1
            else:
                folded, at = take_varint(buffer, at, end)
                if at < 0:
                    return at
            surprise = folded >> 1 ^ -(folded & 1)
            value += pace * gap + surprise
            if abs(value) > _LIMIT:
                return -OUTSIDE
            position[row, FRAMES - 1 - age, axis] = value / UNITS
            pace = _next_pace(pace, surprise, gap, nodes)
            gap, nodes = 0, nodes + 1
    return at


@compiled
def named_before(track: Ints, row: int) -> bool:
    """Whether a row before this one has its id."""
    known = False
    for other in range(row):
        known |= track[other] == track[row]
    return known


@compiled
def set_nodes(rows: GraphArrays, row: int, frames: int, varies: int) -> None:
    """Set the mask, give every node its height where it is one, and clear what is absent."""
    height = rows.position[row, newest_column(frames), 2]
    for column in range(FRAMES):
        present = frames >> FRAMES - 1 - column & 1 == 1
        rows.mask[row, column] = present
        if not present:
            rows.position[row, column, :] = 0.0
        elif not varies:
            rows.position[row, column, 2] = height
