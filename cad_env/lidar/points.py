"""Points: how many are thinned to few, and raw points as bytes.

A raw message is what a lidar reports, ground and all, in whole centimetres of the sender's own frame:

    number of points                                            four bytes, the lowest first (as in what follows)
    for each point: x, y, z                                     two bytes each, signed, cm
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cad_env.checks import check_whole, settle
from cad_env.numerics.jit import compiled, inlined_part
from cad_env.pipeline.varint import DecodeError
from cad_env.types import Floats, Ints

KEPT = 128  # points that thinning leaves unless asked otherwise
GROUND = 0.2  # m, up to which a return is the road's
VOXEL = 100  # cm, the edge of the cube that keeps one point
MOST_POINTS = 2**20  # points of a cloud
POINT_REACH = 327.67  # m, the largest coordinate of two bytes of centimetres
TOO_LARGE = f"coordinates of a cloud must be from {-POINT_REACH:g} to {POINT_REACH:g} m"

_COUNT = 4  # bytes
_POINT = 6  # bytes
# Spreads voxels over a table: Teschner et al., "Optimized spatial hashing for collision detection", VMV 2003.
_SPREAD = (73856093, 19349663, 83492791)
_CENTIMETRE, _METRE = np.float64(0.01), np.float64(1.0)
_GROUND, _GROUND_CENTIMETRES = np.float64(GROUND), np.int16(20)


def thinned(cloud: Floats, most: int = KEPT) -> Floats:
    """(k <= most, 3) m of a cloud (n, 3) m: no ground, the first point in each cube of 1 m, and of these every so many.

    >>> thinned(np.array([[5.2, 0.0, 0.0], [5.2, 0.1, 0.9], [5.4, 0.2, 0.9], [8.0, 0.0, 1.1]])).tolist()
    [[5.2, 0.1, 0.9], [8.0, 0.0, 1.1]]
    """
    return _thin(np.ascontiguousarray(cloud, np.float64), _METRE, _GROUND, most)


@compiled
def _thin(points: Floats, unit: float, ground: float, most: int) -> Floats:
    """As `thinned`, of points (n, 3) in units of so many metres; the height of the ground is in these units too."""
    first = np.empty(points.shape[0], np.int64)
    count = 0
    for i in range(points.shape[0]):
        if points[i, 2] > ground:
            first[count] = i
            count += 1
    count = _first_in_voxels(points, unit, first, count)
    kept = min(count, most)
    few = np.empty((kept, 3))
    for k in range(kept):
        i = first[k * count // kept]
        for axis in range(3):
            few[k, axis] = points[i, axis] * unit
    return few


@compiled
def _first_in_voxels(points: Floats, unit: float, chosen: Ints, count: int) -> int:
    """Leave of the points chosen[:count] the first of every voxel, in place, and answer how many."""
    size = 16
    while size < 2 * count:
        size *= 2
    table = np.full(size, -1, np.int64)  # open addressing: the key of a voxel, which is never negative
    left, x, y, before, last = 0, 0, 0, -1, 0
    for c in range(count):
        i = chosen[c]
        # What is the same as of the point before is not computed anew: the beams of an azimuth meet one wall.
        if c == 0 or points[i, 0] != points[last, 0]:
            x = _cell(points[i, 0], unit)
        if c == 0 or points[i, 1] != points[last, 1]:
            y = _cell(points[i, 1], unit)
        z, last = _cell(points[i, 2], unit), i
        key = x << 42 | y << 21 | z
        if key == before:
            continue
        before, at = key, (x * _SPREAD[0] ^ y * _SPREAD[1] ^ z * _SPREAD[2]) & (size - 1)
        while table[at] != -1 and table[at] != key:
            at = (at + 1) & (size - 1)
        if table[at] == -1:
            table[at] = key
            chosen[left] = i
            left += 1
    return left


@inlined_part
def _cell(place: float, unit: float) -> int:
    """Along one axis the number of the voxel, from 0 to 2**21 - 1, that a coordinate is in."""
    # From whole centimetres, so that a wall on the edge of a voxel does not flicker with the last bit.
    cell = math.floor(place * unit * 100.0 + 0.5) // VOXEL
    return min(max(cell, -(1 << 20)), (1 << 20) - 1) + (1 << 20)


def relative(pose: Sequence[float] | Floats, to: Sequence[float] | Floats) -> tuple[float, float, float]:
    """A pose x, y (m), heading (rad) in the frame of another.

    >>> [round(part, 9) for part in relative((3.0, 5.0, 2.0), (1.0, 1.0, math.pi / 2))]
    [4.0, -2.0, 0.429203673]
    """
    dx, dy, cos, sin = pose[0] - to[0], pose[1] - to[1], math.cos(to[2]), math.sin(to[2])
    return dx * cos + dy * sin, dy * cos - dx * sin, pose[2] - to[2]


@compiled
def _to_centimetres(cloud: Floats, units: Ints) -> bool:
    """Fill units (n, 3) int16; False if a coordinate of the cloud is beyond POINT_REACH, or no number."""
    fits = True
    for i in range(cloud.shape[0]):
        for axis in range(3):
            value = cloud[i, axis]
            inside = abs(value) <= POINT_REACH
            fits &= inside
            units[i, axis] = int(nearest_cm(value)) if inside else 0
    return fits


@inlined_part
def nearest_cm(metres: float) -> float:
    """Whole centimetres; half of one is rounded up."""
    return float(np.floor(metres * 100.0 + 0.5))  # no whole number: a processor makes several floats whole at once


class Reads(NamedTuple):
    """What an encoder is given of a cloud."""

    thinned: int = 0  # points that `thinned` leaves at most; 0: every return, the ground's among them
    centimetres: bool = False  # every return to the nearest cm, int16, in place of m


@dataclass(frozen=True)
class RawPoints:
    """The codec of raw sharing: every return is sent, and the receiver thins what arrives to `most` points.

    >>> codec = RawPoints()
    >>> payloads = codec.encode([np.array([[10.0, -2.5, 1.004], [3.0, 0.0, 0.0]])])
    >>> len(payloads[0]), codec.decode(payloads[0]).tolist()
    (16, [[10.0, -2.5, 1.0]])
    """

    most: int = KEPT

    def __post_init__(self) -> None:
        settle(self, "most", check_whole("most points of a message", self.most, 1, MOST_POINTS))

    @property
    def width(self) -> int:
        """No features."""
        return 0

    @property
    def reads(self) -> Reads:
        """Everything, as it is written."""
        return Reads(centimetres=True)

    def encode(self, clouds: Sequence[Floats | Ints]) -> list[bytes]:
        """Each cloud (n, 3) m as bytes, to the nearest centimetre; ValueError for what two bytes cannot hold.

        A cloud of int16 is in centimetres.
        """
        return [_written(cloud) for cloud in clouds]

    def decode(self, payload: bytes) -> Floats:
        """(k <= most, 3) m, thinned; DecodeError for any bytes that `encode` does not write."""
        count = int.from_bytes(payload[:_COUNT], "little")
        if len(payload) < _COUNT or count > MOST_POINTS or len(payload) != _COUNT + _POINT * count:
            raise DecodeError(f"raw points of {len(payload)} bytes refused: they are not a count and so many points")
        units = np.frombuffer(payload, "<i2", 3 * count, _COUNT).reshape(count, 3)
        return _thin(units.astype(np.int16, copy=False), _CENTIMETRE, _GROUND_CENTIMETRES, self.most)


def _written(cloud: Floats | Ints) -> bytes:
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) > MOST_POINTS:
        raise ValueError(f"a cloud must be (n <= {MOST_POINTS}, 3), got {cloud.shape}")
    units = cloud
    if cloud.dtype != np.int16:
        units = np.empty(cloud.shape, np.int16)
        if not _to_centimetres(np.ascontiguousarray(cloud, np.float64), units):
            raise ValueError(f"{TOO_LARGE}, got {np.abs(cloud).max():g}")
    return b"".join((len(units).to_bytes(_COUNT, "little"), np.ascontiguousarray(units, "<i2").data))
