"""Bytes that nobody sent: nothing hostile gets further than DecodeError."""

import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cad_env.numerics.jit import compiled
from cad_env.pipeline.codec import (
    CAPACITY,
    CORRUPT,
    DECODE_REASONS,
    DECODED,
    FORMAT,
    IDENTITY,
    MAX_BYTES,
    NO_NODE,
    SPELLING,
    TRAILING,
    DecodeError,
    decode,
    decode_message,
    encode,
    read,
    write,
)
from cad_env.pipeline.graph_arrays import empty_graph_arrays
from cad_env.pipeline.varint import LONG_VARINT, OUTSIDE, TRUNCATED, crc32
from cad_env.types import FRAMES, Bytes, GraphArrays
from tests.cad_env.pipeline.test_codec import GOLDEN, golden_graph, scene


def with_crc(body: bytes) -> bytes:
    return body + zlib.crc32(body).to_bytes(4, "little")


def refusal(payload: bytes) -> str:
    with pytest.raises(DecodeError) as caught:
        decode(payload)
    return str(caught.value)


@given(st.binary(max_size=80))
def test_any_bytes_are_refused_or_are_the_one_spelling_of_a_graph(body: bytes):
    for payload in (body, with_crc(body), with_crc(bytes.fromhex(GOLDEN)[:12] + body)):
        try:
            said = decode_message(payload)
        except DecodeError:
            continue
        assert encode(said.graph, depth=payload[3], places=said.places, pose=said.pose) == payload


@given(st.binary(max_size=100))
def test_the_crc_is_the_one_of_zlib(data: bytes):
    assert crc32(np.array(bytearray(data), np.uint8), len(data)) == zlib.crc32(data)


HEAD = bytes.fromhex("4347010f0101070040e20100")  # one track, 15 frames deep


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", TRUNCATED),
        (bytes.fromhex(GOLDEN)[:15], TRUNCATED),
        (with_crc(HEAD), TRUNCATED),
        (with_crc(HEAD + bytes([0, 1, 0, 0, 0])), TRUNCATED),
        (with_crc(HEAD + bytes([0x80, 0, 1, 0, 0, 0, 0])), LONG_VARINT),
        (with_crc(HEAD + bytes([0xFF] * 5 + [1, 1, 0, 0, 0, 0])), LONG_VARINT),
        (with_crc(HEAD + bytes([0, 1, 0, 0x81, 0xDA, 0xC4, 9, 0, 0])), OUTSIDE),
        (with_crc(b"cg" + HEAD[2:] + bytes([0, 1, 0, 0, 0, 0])), FORMAT),
        (with_crc(HEAD[:2] + b"\x05" + HEAD[3:] + bytes([0, 1, 0, 0, 0, 0])), FORMAT),
        (with_crc(HEAD[:3] + b"\x00" + HEAD[4:] + bytes([0, 1, 0, 0, 0, 0])), FORMAT),
        (with_crc(HEAD[:3] + b"\x10" + HEAD[4:] + bytes([0, 1, 0, 0, 0, 0])), FORMAT),
        (with_crc(HEAD[:4] + b"\x02" + HEAD[5:] + bytes([0, 1, 0, 0, 0, 0])), FORMAT),
        (with_crc(HEAD + bytes([0, 1, 0, 0, 0, 0]))[:-1] + b"x", CORRUPT),
        (with_crc(HEAD + bytes([0, 0, 0, 0, 0, 0])), NO_NODE),
        (with_crc(HEAD[:3] + b"\x02" + HEAD[4:] + bytes([0, 4, 0, 0, 0, 0])), NO_NODE),
        (with_crc(HEAD[:5] + b"\x02" + HEAD[6:] + bytes([0, 1, 0, 0, 0, 0]) * 2), IDENTITY),
        (with_crc(HEAD + bytes([0x80, 0x80, 0x80, 0x80, 0x10, 1, 0, 0, 0, 0])), IDENTITY),
        (with_crc(HEAD + bytes([0, 3, 0x80, 0, 0, 0, 0, 2, 0])), SPELLING),
        (with_crc(HEAD + bytes([0, 1, 0, 0, 0, 0, 0])), TRAILING),
    ],
)
def test_each_rule_has_its_refusal(payload: bytes, reason: int):
    assert refusal(payload).endswith(DECODE_REASONS[reason])


def test_the_message_that_those_refusals_spoil_is_accepted():
    assert decode(with_crc(HEAD + bytes([0, 1, 0, 0, 0, 0]))).track.tolist() == [0]


def test_more_bytes_than_any_graph_needs_are_refused_unread():
    assert "no graph takes more" in refusal(bytes(10_000_000))


def test_more_tracks_than_rows_are_refused_before_they_are_read():
    payload = np.array(bytearray(encode(scene(tracks=5))), np.uint8)
    assert read(payload, len(payload), np.zeros(3, np.int64), empty_graph_arrays(rows=4)) == CAPACITY
    assert read(payload, len(payload), np.zeros(3, np.int64), empty_graph_arrays(rows=5)) == DECODED


def test_a_length_beyond_the_buffer_is_refused():
    assert read(np.zeros(20, np.uint8), 21, np.zeros(3, np.int64), empty_graph_arrays()) == TRUNCATED


def test_a_vehicle_with_all_its_rows_in_use_fits_the_buffer():
    rows, buffer = empty_graph_arrays(), np.zeros(MAX_BYTES, np.uint8)
    rows.used[0], rows.mask[:], rows.track[:] = len(rows.track), True, 2**31 - 1 - np.arange(len(rows.track))
    rows.position[:] = np.random.default_rng(0).choice([-1e5, 1e5], rows.position.shape)
    assert MAX_BYTES * 0.7 < write(buffer, 0, 0, FRAMES, rows) <= MAX_BYTES
    rows.position[3, 5, 0] = np.inf
    assert write(buffer, 0, 0, FRAMES, rows) == -1


@compiled
def hurt(buffer: Bytes, length: int, way: int, noise: Bytes) -> int:
    """Flip, cut, extend or overwrite a message; answers its new length."""
    if way == 0:
        buffer[noise[0] % length] ^= 1 << noise[1] % 8
    elif way == 1:
        length = int(noise[0]) % length
    elif way == 2:
        for extra in range(noise[0] % 8):
            buffer[length] = noise[1 + extra]
            length += 1
    else:
        start = 12 + int(noise[0]) % (length - 12)
        for index in range(start, min(length, start + 10)):
            buffer[index] = noise[index - start + 1]
    return length


@compiled
def attack(good: Bytes, noise: Bytes, seal: bool, again: Bytes, rows: GraphArrays, met: Bytes) -> int:
    """Hurt a message once per row of `noise`; counts what was accepted but would be written otherwise."""
    wrong, buffer = 0, np.zeros(4 * len(good), np.uint8)
    header = np.zeros(3, np.int64)
    for case in range(noise.shape[0]):
        buffer[: len(good)] = good
        length = hurt(buffer, len(good) - 4 if seal else len(good), case % 4, noise[case])
        if seal:  # an attacker can count a CRC too, so the rules behind it must hold alone
            crc = crc32(buffer, length)
            for index in range(4):
                buffer[length + index] = crc >> 8 * index & 255
            length += 4
        status = read(buffer, length, header, rows)
        met[status] = 1
        if status == DECODED:
            size = write(again, header[0], header[1], header[2], rows)
            wrong += size != length or (again[:size] != buffer[:size]).any()
    return wrong


@pytest.mark.parametrize("seal", [False, True])
def test_no_hurt_message_is_accepted_in_a_second_spelling(seal: bool):
    met, again, rows = np.zeros(len(DECODE_REASONS), np.uint8), np.zeros(MAX_BYTES, np.uint8), empty_graph_arrays()
    rng = np.random.default_rng(0)
    bumpy = scene(tracks=2)
    bumpy.position[1, :, 2] += rng.integers(0, 2, FRAMES) * 0.01
    for graph in (golden_graph(), bumpy, scene(tracks=1, noise=0.0)):
        good = np.array(bytearray(encode(graph)), np.uint8)
        noise = rng.integers(0, 256, (20_000, 12), dtype=np.uint8)
        assert attack(good, noise, seal, again, rows, met) == 0
    assert met[CORRUPT] != seal
    if seal:
        assert met[[DECODED, TRUNCATED, LONG_VARINT, OUTSIDE, FORMAT, NO_NODE, IDENTITY, TRAILING]].all()
