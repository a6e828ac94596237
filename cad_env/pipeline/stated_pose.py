"""The pose that a message states, as bytes: the sender's heading by odometry, and one fix with its accuracy, or none.

    heading         two bytes, in units of 0.01 degree below 36,000: of the sender's body in the frame of the message
    fix             one byte: 1 if there is one, else 0; and if there is one
        x, y        zigzag varints of cm, in the world
        heading     two bytes, as above
        accuracy    two varints, from 1 on: standard deviations in cm, of each axis, and in 0.01 degree

Where the body is in the frame of the message says the newest node of track 0.
"""

import math
from dataclasses import dataclass

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.pipeline.varint import (
    REACH,
    TRUNCATED,
    UNITS,
    VARINT_BYTES,
    put_fixed,
    put_varint,
    take_fixed,
    take_varint,
    to_units,
)
from cad_env.types import Bytes, Floats

POSE_BYTES = 5 + 4 * VARINT_BYTES  # no stated pose takes more
STATED = 7  # numbers of a stated pose: heading, then x, y, heading, accuracy (m), accuracy (rad), and 1.0 for a fix
NO_POSE = 14  # a heading of 360 degrees or more, a fix that is neither there nor not, an accuracy out of range
_CIRCLE = 36_000  # units
_COARSEST = 18_000  # of either accuracy


@dataclass(frozen=True)
class StatedPose:
    """What a message states of its sender's pose."""

    heading: float  # rad, of its body in the frame of the message
    fix: tuple[float, float, float] | None = None  # m, m, rad in the world
    accuracy: tuple[float, float] = (0.0, 0.0)  # m, rad: standard deviations of a fix

    def numbers(self) -> Floats:
        """(STATED,) as the compiled stages see it."""
        x, y, heading = self.fix or (0.0, 0.0, 0.0)
        return np.array([self.heading, x, y, heading, *self.accuracy, float(self.fix is not None)])


def stated_pose(numbers: Floats) -> StatedPose:
    """Back from (STATED,) numbers."""
    heading, x, y, yaw, metres, radians, there = numbers.tolist()
    return StatedPose(heading, (x, y, yaw), (metres, radians)) if there else StatedPose(heading)


@compiled_part
def _to_angle(radians: float) -> int:
    return math.floor(radians % (2.0 * math.pi) * _CIRCLE / (2.0 * math.pi) + 0.5) % _CIRCLE


@compiled_part
def _to_accuracy(value: float, unit: float) -> int:
    return int(min(max(math.ceil(value / unit - 1e-9), 1), _COARSEST))


@compiled
def put_stated_pose(buffer: Bytes, at: int, stated: Floats) -> int:
    """Write a pose (STATED,); answers where the next value goes. Coordinates are the caller's to keep within REACH."""
    at = put_fixed(buffer, at, _to_angle(stated[0]), 2)
    buffer[at] = stated[6] != 0.0
    at += 1
    if stated[6] == 0.0:
        return at
    for axis in range(2):
        units = to_units(stated[1 + axis])
        at = put_varint(buffer, at, units << 1 ^ units >> 63)
    at = put_fixed(buffer, at, _to_angle(stated[3]), 2)
    at = put_varint(buffer, at, _to_accuracy(stated[4], 1.0 / UNITS))
    return put_varint(buffer, at, _to_accuracy(stated[5], 2.0 * math.pi / _CIRCLE))


@compiled
def take_stated_pose(buffer: Bytes, at: int, end: int, stated: Floats) -> int:
    """Read what `put_stated_pose` writes; answers where the next value is, or the negative of a reason."""
    for k in range(STATED):
        stated[k] = 0.0
    at = _take_angle(buffer, at, end, stated[0:])
    if at < 0:
        return at
    if at >= end:
        return -TRUNCATED
    there, at = int(buffer[at]), at + 1
    if there > 1:
        return -NO_POSE
    return _take_fix(buffer, at, end, stated) if there else at


@compiled_part
def _take_fix(buffer: Bytes, at: int, end: int, stated: Floats) -> int:
    for axis in range(2):
        folded, at = take_varint(buffer, at, end)
        if at < 0:
            return at
        units = folded >> 1 ^ -(folded & 1)
        if abs(units) > REACH * UNITS:
            return -NO_POSE
        stated[1 + axis] = units / UNITS
    at = _take_angle(buffer, at, end, stated[3:])
    if at < 0:
        return at
    for axis in range(2):
        value, at = take_varint(buffer, at, end)
        if at < 0:
            return at
        if not 1 <= value <= _COARSEST:
            return -NO_POSE
        stated[4 + axis] = value * (1.0 / UNITS if axis == 0 else 2.0 * math.pi / _CIRCLE)
    stated[6] = 1.0
    return at


@compiled_part
def _take_angle(buffer: Bytes, at: int, end: int, angle: Floats) -> int:
    if at + 2 > end:
        return -TRUNCATED
    units = take_fixed(buffer, at, 2)
    if units >= _CIRCLE:
        return -NO_POSE
    angle[0] = units * (2.0 * math.pi / _CIRCLE)
    return at + 2
