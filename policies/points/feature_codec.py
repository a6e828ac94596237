"""Keypoints with features as bytes: what a vehicle of the compressed row puts on the air.

    version                                                     one byte
    features of a keypoint                                      one byte, one less than there are
    number of keypoints                                         two bytes, the lowest first (as in what follows)
    for each keypoint: x, y, z in the sender's own frame        two bytes each, signed, cm
    for each keypoint: its features                             two bytes each, IEEE 754 binary16
    CRC-32 of all before                                        four bytes

The CRC finds corruption; it is no authentication.
"""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from cad_env.pipeline.varint import DecodeError
from cad_env.types import Floats

VERSION = 1
_MOST_FEATURES, _MOST_KEYPOINTS = 256, 65_535
_REACH = 32_767  # cm
LARGEST = 200.0  # of a feature, either way: what an observation can hold
CENTIMETRES = 100.0  # to the metre

_HEADER, _CRC = struct.Struct("<BBH"), struct.Struct("<I")


def size(keypoints: int, width: int) -> int:
    """Bytes of a message with so many keypoints of so many features.

    >>> size(128, 128)
    33544
    """
    return _HEADER.size + keypoints * (6 + 2 * width) + _CRC.size


def write_keypoints(position: NDArray[np.floating], features: NDArray[np.floating]) -> bytes:
    """Keypoints (k, 3) m with features (k, W) as bytes: to the centimetre, and to eleven significant bits.

    What two bytes cannot hold is clipped: a position at 327 m, a feature at LARGEST.

    >>> len(write_keypoints(np.zeros((128, 3)), np.zeros((128, 128))))
    33544
    """
    count, width = features.shape
    place = np.clip(np.rint(position * CENTIMETRES), -_REACH, _REACH).astype("<i2")
    said = np.clip(features, -LARGEST, LARGEST).astype("<f2")
    message: bytes = _HEADER.pack(VERSION, width - 1, count) + place.tobytes() + said.tobytes()
    return message + _CRC.pack(zlib.crc32(message))


def read_keypoints(payload: bytes, most: int, width: int) -> Floats:
    """(k <= most, 3 + width) positions in m and features; DecodeError for bytes that `write_keypoints` never writes."""
    if len(payload) < _HEADER.size + _CRC.size:
        raise DecodeError(f"keypoints of {len(payload)} bytes refused: they end too early")
    version, named, count = _HEADER.unpack_from(payload)
    if version != VERSION or named + 1 != width or count > most:
        raise DecodeError(f"keypoints refused: version {version}, {named + 1} features, {count} of them")
    end = size(count, width) - _CRC.size
    if len(payload) != end + _CRC.size:
        raise DecodeError(f"keypoints of {len(payload)} bytes refused: {count} take {end + _CRC.size}")
    if _CRC.unpack_from(payload, end)[0] != zlib.crc32(payload[:end]):
        raise DecodeError("keypoints refused: their CRC-32 does not match")
    place = np.frombuffer(payload, "<i2", 3 * count, _HEADER.size).reshape(count, 3)
    said = np.frombuffer(payload, "<f2", width * count, _HEADER.size + 6 * count).reshape(count, width)
    if (place < -_REACH).any() or not (np.abs(said) <= LARGEST).all():
        raise DecodeError("keypoints refused: a number that the encoder does not write")
    return np.concatenate([place / CENTIMETRES, said.astype(np.float64)], axis=1)
