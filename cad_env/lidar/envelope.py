"""What a codec wrote, with who sent it, when and from where: the message that is on the air when points are shared.

    "CP"  version                                               three bytes
    sender                                                      two bytes, the lowest first (as in all that follows)
    time (ms)                                                   four bytes
    pose by the sender's GNSS: x, y (cm), heading (1e-6 rad)    four bytes each, signed
    what the codec wrote                                        the rest
    CRC-32 of all before                                        four bytes

As with graphs, the CRC finds corruption and is no authentication.
"""

import math
import struct
import zlib
from typing import NamedTuple

from cad_env.pipeline.varint import DecodeError

VERSION = 1
LIMIT = 2**26  # bytes of a message

_MAGIC = b"CP"
_HEAD = struct.Struct("<2sBHIiii")
_CRC = struct.Struct("<I")
_CENTIMETRE, _MICRORADIAN = 0.01, 1e-6
_HALF_TURN = int(math.pi / _MICRORADIAN)
ENVELOPE_SIZE = _HEAD.size + _CRC.size  # bytes that an envelope adds


class Envelope(NamedTuple):
    """A message that has been opened."""

    sender: int
    time: float  # s
    pose: tuple[float, float, float]  # m, m, rad in (-pi, pi]
    content: bytes


def seal(envelope: Envelope) -> bytes:
    """The message; struct.error or ValueError where a number is not one that fits."""
    x, y, heading = envelope.pose
    turn = math.atan2(math.sin(heading), math.cos(heading))
    head = _HEAD.pack(
        _MAGIC, VERSION, envelope.sender, round(envelope.time * 1000.0), round(x / _CENTIMETRE),
        round(y / _CENTIMETRE), min(max(round(turn / _MICRORADIAN), -_HALF_TURN), _HALF_TURN),
    )  # fmt: skip
    return b"".join((head, envelope.content, _CRC.pack(zlib.crc32(envelope.content, zlib.crc32(head)))))


def opened(message: bytes) -> Envelope:
    """What `seal` closed; DecodeError for any bytes that it does not write.

    >>> opened(seal(Envelope(3, 1.5, (10.0, -2.25, 0.5), b"points")))
    Envelope(sender=3, time=1.5, pose=(10.0, -2.25, 0.5), content=b'points')
    """
    if not ENVELOPE_SIZE <= len(message) <= LIMIT:
        raise DecodeError(f"message of {len(message)} bytes refused: no envelope of points is so long")
    magic, version, sender, time_ms, x, y, heading = _HEAD.unpack_from(message)
    if magic != _MAGIC or version != VERSION:
        raise DecodeError(f"message of {len(message)} bytes refused: unknown magic or version")
    body = memoryview(message)[: -_CRC.size]
    if zlib.crc32(body) != _CRC.unpack_from(message, len(body))[0]:
        raise DecodeError(f"message of {len(message)} bytes refused: its CRC-32 does not match")
    if abs(heading) > _HALF_TURN:
        raise DecodeError(f"message of {len(message)} bytes refused: a heading of more than half a turn")
    pose = x * _CENTIMETRE, y * _CENTIMETRE, heading * _MICRORADIAN
    return Envelope(sender, time_ms / 1000.0, pose, bytes(body[_HEAD.size :]))
