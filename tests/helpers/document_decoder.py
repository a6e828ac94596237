"""Decoders of both message formats, written from docs/perception-and-radio.md alone: nothing of the project is used."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

CENTIMETRES = 100
FURTHEST = 100_000 * CENTIMETRES


class RefusedError(ValueError):
    """The document says that a receiver refuses these bytes."""


@dataclass
class Track:
    """One track of a message: centimetres by how many frames before the newest it was there."""

    id: int
    kind: int
    nodes: dict[int, tuple[int, int, int]] = field(default_factory=dict)


@dataclass
class Message:
    """A message of a graph."""

    depth: int
    sender: int
    time_ms: int
    tracks: list[Track]
    empty: list[list[tuple[int, int]]] | None  # version 2: of each lane, its intervals [first place, one past the last)


@dataclass
class Points:
    """A message of raw points."""

    sender: int
    time_ms: int
    x: float  # m
    y: float  # m
    heading: float  # rad
    points: list[tuple[int, int, int]]  # cm


def _checked(holds: bool, rule: str) -> None:
    if not holds:
        raise RefusedError(rule)


class Reader:
    """Takes numbers from bytes."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def fixed(self, width: int) -> int:
        """A number of so many bytes, the lowest first."""
        _checked(self.at + width <= len(self.data), "ends too early")
        self.at += width
        return int.from_bytes(self.data[self.at - width : self.at], "little")

    def varint(self) -> int:
        """Seven bits a byte, the lowest first."""
        groups = [self.fixed(1)]
        while groups[-1] & 128:
            groups.append(self.fixed(1))
            _checked(len(groups) <= 5, "a varint of more than 5 bytes")
        _checked(len(groups) == 1 or groups[-1] != 0, "a varint with more bytes than it needs")
        return sum((group & 127) << 7 * place for place, group in enumerate(groups))

    def surprise(self) -> int:
        """A zigzag varint: 2n, or -2n - 1."""
        folded = self.varint()
        return -(folded + 1) // 2 if folded % 2 else folded // 2

    def walk(self, ages: list[int], prediction: int) -> Iterator[int]:
        """One coordinate, cm, of the nodes so many frames before the newest, from the newest on."""
        pace = value = before = 0
        for number, age in enumerate(ages):
            gap = age - before
            if number > 0:
                prediction = value + pace * gap
            surprise = self.surprise()
            value, before = prediction + surprise, age
            _checked(abs(value) <= FURTHEST, "a coordinate too far out")
            if number == 1:
                pace = surprise // 2 ** (gap - 1)
            elif number > 1:
                pace += surprise // 2**gap
            yield value


def _sealed(payload: bytes, least: int) -> bytes:
    """A message without its CRC, which is right."""
    _checked(len(payload) >= least, "ends too early")
    _checked(zlib.crc32(payload[:-4]) == int.from_bytes(payload[-4:], "little"), "its CRC is another")
    return payload[:-4]


def decode_graph(payload: bytes) -> Message:
    """The message of these bytes, or RefusedError."""
    reader = Reader(_sealed(payload, 16))
    _checked(reader.data[:2] == b"CG", "another magic")
    reader.fixed(2)
    version = reader.fixed(1)
    _checked(version in (1, 2), "another version")
    depth = reader.fixed(1)
    _checked(1 <= depth <= 15, "another depth")
    _checked(reader.fixed(1) == 1, "another resolution")
    count, sender, time_ms = reader.fixed(1), reader.fixed(2), reader.fixed(4)
    tracks: list[Track] = []
    for _ in range(count):
        first = tracks[0].nodes[min(tracks[0].nodes)] if tracks else (0, 0, 0)
        tracks.append(_track(reader, depth, first))
    empty = _lanes(reader) if version == 2 else None
    _checked(reader.at == len(reader.data), "goes on after its end")
    _checked(len({track.id for track in tracks}) == count, "an id is there twice")
    return Message(depth, sender, time_ms, tracks, empty)


def _lanes(reader: Reader) -> list[list[tuple[int, int]]]:
    lanes: list[list[tuple[int, int]]] = []
    count = reader.varint()
    _checked(count <= 255, "more lanes than there can be")
    for _ in range(count):
        intervals: list[tuple[int, int]] = []
        for _ in range(reader.varint()):
            first = reader.varint() + (intervals[-1][1] + 1 if intervals else 0)
            intervals.append((first, first + reader.varint() + 1))
            _checked(intervals[-1][1] <= 128, "a place beyond the end of its lane")
        lanes.append(intervals)
    _checked(not lanes or bool(lanes[-1]), "a last lane without an interval")
    return lanes


def _track(reader: Reader, depth: int, first: tuple[int, int, int]) -> Track:
    name, bits = reader.varint(), reader.fixed(2)
    varies, ages = bits >> 15 == 1, [age for age in range(15) if bits >> age & 1]
    _checked(name // 2 <= 2**31 - 1, "an id too large")
    _checked(bool(ages) and ages[-1] < depth, "no frame, or one that is not within the depth")
    x, y = list(reader.walk(ages, first[0])), list(reader.walk(ages, first[1]))
    z = list(reader.walk(ages if varies else ages[:1], first[2]))
    _checked(not varies or len(set(z)) > 1, "a height that is the same is spelt out")
    if not varies:
        z *= len(ages)
    return Track(name // 2, name % 2, dict(zip(ages, zip(x, y, z, strict=True), strict=True)))


def decode_points(payload: bytes) -> Points:
    """The message of raw points of these bytes, or RefusedError."""
    body = _sealed(payload, 29)
    magic, version, sender, time_ms, x, y, heading, count = struct.unpack_from("<2sBHIiiiI", body)
    _checked((magic, version) == (b"CP", 1), "another magic or version")
    _checked(abs(heading) <= 3_141_592, "more than half a turn")
    _checked(len(body) == 25 + 6 * count, "not a count and so many points")
    return Points(
        sender, time_ms, x / CENTIMETRES, y / CENTIMETRES, heading * 1e-6, list(struct.iter_unpack("<3h", body[25:]))
    )
