"""Versions 3 and 4 of the message: a pose comes back as it was stated, in one spelling, and nothing hostile gets in."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cad_env.numerics.jit import compiled
from cad_env.pipeline.codec import (
    DECODE_REASONS,
    DECODED,
    FORMAT,
    NO_BODY,
    TRAILING,
    DecodeError,
    decode_message,
    encode,
    max_bytes,
    read,
    read_with_places,
    read_with_pose,
    write_with_pose,
)
from cad_env.pipeline.graph_arrays import empty_graph_arrays
from cad_env.pipeline.intervals import places_of
from cad_env.pipeline.stated_pose import NO_POSE, POSE_BYTES, STATED, StatedPose
from cad_env.pipeline.varint import LONG_VARINT, TRUNCATED, crc32
from cad_env.types import MAX_TRACKS, Bytes, GraphArrays
from cad_env.world.lanes import PLACES
from tests.cad_env.pipeline.test_codec import GOLDEN, golden_graph, scene
from tests.cad_env.pipeline.test_codec_hostile import hurt, refusal, with_crc

POSE = StatedPose(math.radians(90.0), (12.34, -0.5, math.radians(359.99)), (1.5, math.radians(0.5)))
# Heading 9000, a fix, 1234 and -50 as zigzag varints, heading 35999, 150 cm, 50 hundredths of a degree.
GOLDEN_POSE = "2823" + "01" + "a413" + "63" + "9f8c" + "9601" + "32"
HALF_AN_ANGLE = math.radians(0.005) + 1e-9

angles = st.floats(-7.0, 7.0)
coordinates = st.floats(-100_000.0, 100_000.0)
poses = st.builds(
    StatedPose,
    angles,
    st.none() | st.tuples(coordinates, coordinates, angles),
    st.tuples(st.floats(0.0, 180.0), st.floats(0.0, math.pi)),
)


def apart(one: float, other: float) -> float:
    return abs(math.remainder(one - other, 2.0 * math.pi))


@given(poses, st.booleans())
def test_a_pose_comes_back_and_is_written_alike(pose: StatedPose, with_places: bool) -> None:
    places = places_of([[(3, 12)]]) if with_places else None
    payload = encode(golden_graph(), places=places, pose=pose)
    assert len(payload) <= len(encode(golden_graph(), places=places)) + POSE_BYTES
    back = decode_message(payload)
    assert apart(back.pose.heading, pose.heading) < HALF_AN_ANGLE
    assert (back.pose.fix is None, back.places is None) == (pose.fix is None, not with_places)
    if pose.fix is not None:
        assert np.abs(np.subtract(back.pose.fix[:2], pose.fix[:2])).max() <= 0.005 + 1e-9
        assert apart(back.pose.fix[2], pose.fix[2]) < HALF_AN_ANGLE
        for stated, meant, unit in zip(back.pose.accuracy, pose.accuracy, (0.01, math.radians(0.01)), strict=True):
            assert -1e-6 < stated - meant < 1.01 * unit  # never better than it is
    assert encode(back.graph, places=back.places, pose=back.pose) == payload


def test_the_format_is_what_it_was() -> None:
    body = bytes.fromhex(GOLDEN[:4] + "03" + GOLDEN[6:-8] + GOLDEN_POSE)
    assert encode(golden_graph(), pose=POSE) == with_crc(body)
    assert decode_message(with_crc(body)).pose.accuracy == pytest.approx(POSE.accuracy)


def test_who_expects_one_kind_of_message_takes_no_other() -> None:
    usual, posed = encode(golden_graph()), encode(golden_graph(), pose=POSE)
    header, rows, places = np.zeros(3, np.int64), empty_graph_arrays(), np.zeros((8, PLACES), np.uint8)
    buffer = np.array(bytearray(posed), np.uint8)
    assert read(buffer, len(posed), header, rows) == FORMAT
    assert read_with_places(buffer, len(posed), header, rows, places) == FORMAT
    buffer = np.array(bytearray(usual), np.uint8)
    assert read_with_pose(buffer, len(usual), header, rows, places, np.zeros(STATED)) == FORMAT


START = bytes.fromhex(GOLDEN[:4] + "03" + GOLDEN[6:-8])
FIX = bytes.fromhex(GOLDEN_POSE)


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (START, TRUNCATED),
        (START + FIX[:2], TRUNCATED),
        (START + FIX[:-1], TRUNCATED),
        (START + FIX + b"\0", TRAILING),
        (START + bytes([0xA0, 0x8C]) + b"\0", NO_POSE),  # 360 degrees
        (START + FIX[:2] + b"\2" + FIX[3:], NO_POSE),
        (START + FIX[:6] + bytes([0xA0, 0x8C]) + FIX[8:], NO_POSE),
        (START + FIX[:8] + b"\0" + FIX[10:], NO_POSE),  # no error at all
        (START + FIX[:8] + bytes([0xD1, 0x8C, 0x01]) + FIX[10:], NO_POSE),  # more than 180 m
        (START + FIX[:3] + bytes([0xFF] * 4 + [0x7F]) + FIX[5:], NO_POSE),  # beyond REACH
        (START + FIX[:5] + bytes([0xE3, 0x00]) + FIX[6:], LONG_VARINT),
    ],
)
def test_each_rule_has_its_refusal(payload: bytes, reason: int) -> None:
    assert refusal(with_crc(payload)).endswith(DECODE_REASONS[reason])


def test_a_pose_without_a_body_is_refused_on_both_sides() -> None:
    nobody = replace(golden_graph(), track=np.array([5, 300]))
    with pytest.raises(ValueError, match="must have its sender's body"):
        encode(nobody, pose=POSE)
    payload = bytearray(encode(nobody)[:-4] + FIX)
    payload[2] = 3
    assert refusal(with_crc(bytes(payload))).endswith(DECODE_REASONS[NO_BODY])


@pytest.mark.parametrize(
    "pose", [StatedPose(math.nan), StatedPose(0.0, (1e6, 0.0, 0.0)), replace(POSE, accuracy=(-1, 0))]
)
def test_what_cannot_be_stated_is_refused_in_one_line(pose: StatedPose) -> None:
    with pytest.raises(ValueError, match="must be from"):
        encode(golden_graph(), pose=pose)


@given(st.binary(max_size=40))
def test_any_bytes_are_refused_or_are_the_one_spelling_of_a_pose(tail: bytes) -> None:
    try:
        said = decode_message(with_crc(START + tail))
    except DecodeError:
        return
    assert encode(said.graph, places=said.places, pose=said.pose) == with_crc(START + tail)


@compiled
def attack(good: Bytes, noise: Bytes, again: Bytes, rows: GraphArrays, places: Bytes, met: Bytes) -> int:
    """Hurt and seal a message once per row of `noise`; counts what was accepted but would be written otherwise."""
    wrong, buffer, stated = 0, np.zeros(4 * len(good), np.uint8), np.zeros(7)
    header = np.zeros(3, np.int64)
    for case in range(noise.shape[0]):
        buffer[: len(good)] = good
        length = hurt(buffer, len(good) - 4, case % 4, noise[case])
        crc = crc32(buffer, length)
        for index in range(4):
            buffer[length + index] = crc >> 8 * index & 255
        status = read_with_pose(buffer, length + 4, header, rows, places, stated)
        met[status] = 1
        if status == DECODED:
            said = places if buffer[2] == 4 else places[:0]
            size = write_with_pose(again, header[0], header[1], header[2], rows, said, stated)
            wrong += size != length + 4 or (again[:size] != buffer[:size]).any()
    return wrong


@pytest.mark.parametrize("places", [None, places_of([[(3, 12)], [], [(0, 2), (120, 128)]])])
def test_no_hurt_message_is_accepted_in_a_second_spelling(places: Bytes | None) -> None:
    met, again = np.zeros(len(DECODE_REASONS), np.uint8), np.zeros(max_bytes(MAX_TRACKS, 8) + POSE_BYTES, np.uint8)
    rows, room, rng = empty_graph_arrays(), np.zeros((8, PLACES), np.uint8), np.random.default_rng(1)
    for graph in (golden_graph(), scene(tracks=1)):
        good = np.array(bytearray(encode(graph, places=places, pose=POSE)), np.uint8)
        noise = rng.integers(0, 256, (20_000, 12), dtype=np.uint8)
        assert attack(good, noise, again, rows, room, met) == 0
    assert met[[DECODED, TRUNCATED, FORMAT, TRAILING, NO_POSE]].all()
