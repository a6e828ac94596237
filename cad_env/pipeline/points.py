"""Points: how many are thinned to few, and raw points as bytes.

A raw message is what a lidar reports, ground and all, in whole centimetres of the sender's own frame:

    number of points                                            four bytes, the lowest first (as in what follows)
    for each point: x, y, z                                     two bytes each, signed, cm
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cad_env.compiled import compiled
from cad_env.config import check_range
from cad_env.pipeline.codec_bits import DecodeError
from cad_env.types import Floats, Ints

KEPT = 128  # points that thinning leaves unless asked otherwise
GROUND = 0.2  # m, up to which a return is the road's
VOXEL = 100  # cm, the edge of the cube that keeps one point
MOST_POINTS = 2**20  # points of a cloud
REACH = 327.67  # m, the largest coordinate of two bytes of centimetres

_COUNT = 4  # bytes
_POINT = 6  # bytes
# Spreads voxels over a table: Teschner et al., "Optimized spatial hashing for collision detection", VMV 2003.
_SPREAD = (73856093, 19349663, 83492791)
_CENTIMETRE, _METRE = np.float64(0.01), np.float64(1.0)


def thinned(cloud: Floats, most: int = KEPT) -> Floats:
    """(k <= most, 3) m of a cloud (n, 3) m: no ground, the first point in each cube of 1 m, and of these every so many.

    >>> thinned(np.array([[5.2, 0.0, 0.0], [5.2, 0.1, 0.9], [5.4, 0.2, 0.9], [8.0, 0.0, 1.1]])).tolist()
    [[5.2, 0.1, 0.9], [8.0, 0.0, 1.1]]
    """
    return _thin(np.ascontiguousarray(cloud, np.float64), _METRE, most)


@compiled
def _thin(points: Floats, unit: float, most: int) -> Floats:
    """As `thinned`, of points (n, 3) in units of so many metres."""
    first = np.empty(points.shape[0], np.int64)
    count = 0
    for i in range(points.shape[0]):
        if points[i, 2] * unit > GROUND:
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
    left = 0
    for c in range(count):
        i, key, at = chosen[c], 0, 0
        for axis in range(3):
            # From whole centimetres, so that a wall on the edge of a voxel does not flicker with the last bit.
            place = math.floor(points[i, axis] * unit * 100.0 + 0.5) // VOXEL
            place = min(max(place, -(1 << 20)), (1 << 20) - 1) + (1 << 20)
            key, at = key << 21 | place, at ^ place * _SPREAD[axis]
        at &= size - 1
        while table[at] != -1 and table[at] != key:
            at = (at + 1) & (size - 1)
        if table[at] == -1:
            table[at] = key
            chosen[left] = i
            left += 1
    return left


@compiled
def _to_centimetres(cloud: Floats, units: Ints) -> bool:
    """Fill units (n, 3) int16; False if a coordinate of the cloud is beyond REACH, or no number."""
    fits = True
    for i in range(cloud.shape[0]):
        for axis in range(3):
            value = cloud[i, axis]
            inside = abs(value) <= REACH
            fits &= inside
            units[i, axis] = math.floor(value * 100.0 + 0.5) if inside else 0
    return fits


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
        check_range("most points of a message", self.most, 1, MOST_POINTS)

    @property
    def width(self) -> int:
        """No features."""
        return 0

    def encode(self, clouds: Sequence[Floats]) -> list[bytes]:
        """Each cloud (n, 3) m as bytes, to the nearest centimetre; ValueError for what two bytes cannot hold."""
        return [_written(np.ascontiguousarray(cloud, np.float64)) for cloud in clouds]

    def decode(self, payload: bytes) -> Floats:
        """(k <= most, 3) m, thinned; DecodeError for any bytes that `encode` does not write."""
        count = int.from_bytes(payload[:_COUNT], "little")
        if len(payload) < _COUNT or count > MOST_POINTS or len(payload) != _COUNT + _POINT * count:
            raise DecodeError(f"raw points of {len(payload)} bytes refused: they are not a count and so many points")
        units = np.frombuffer(payload, "<i2", 3 * count, _COUNT).reshape(count, 3)
        return _thin(units.astype(np.int16, copy=False), _CENTIMETRE, self.most)


def _written(cloud: Floats) -> bytes:
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) > MOST_POINTS:
        raise ValueError(f"a cloud must be (n <= {MOST_POINTS}, 3), got {cloud.shape}")
    payload = np.empty(_COUNT + _POINT * len(cloud), np.uint8)
    payload[:_COUNT] = np.frombuffer(len(cloud).to_bytes(_COUNT, "little"), np.uint8)
    units = payload[_COUNT:].view(np.int16).reshape(cloud.shape)
    if not _to_centimetres(cloud, units):
        raise ValueError(f"coordinates of a cloud must be from {-REACH:g} to {REACH:g} m, got {np.abs(cloud).max():g}")
    if sys.byteorder == "big":
        units.byteswap(inplace=True)
    return payload.tobytes()
