"""Keypoints as bytes, and clouds as frames of training."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cad_env.pipeline.varint import DecodeError
from policies.points.feature_codec import LARGEST, read_keypoints, write_keypoints
from policies.points.frames import CloudFrames, Seen, packed_frames, seen
from policies.points.point_transformer import POINT_TRANSFORMER

RNG = np.random.default_rng(0)


def a_message(keypoints: int = 5, width: int = 4) -> bytes:
    return write_keypoints(RNG.uniform(-100, 100, (keypoints, 3)), RNG.normal(size=(keypoints, width)))


def test_keypoints_come_back_to_the_centimetre_and_their_features_to_eleven_bits() -> None:
    position, features = RNG.uniform(-100, 100, (128, 3)), RNG.normal(0, 10, (128, 128))
    payload = write_keypoints(position, features)
    assert len(payload) == 128 * (3 * 2 + 128 * 2) + 8
    found = read_keypoints(payload, 128, 128)
    np.testing.assert_allclose(found[:, :3], position, rtol=0, atol=0.005 + 1e-9)
    np.testing.assert_allclose(found[:, 3:], features, rtol=2**-11, atol=2**-24)


def test_what_two_bytes_cannot_hold_is_clipped() -> None:
    found = read_keypoints(write_keypoints(np.array([[1e6, -1e6, 0]]), np.array([[1e9, -1e9]])), 1, 2)
    assert found.tolist() == [[327.67, -327.67, 0, LARGEST, -LARGEST]]


def test_no_keypoints_are_a_message_too() -> None:
    assert read_keypoints(a_message(0), 128, 4).shape == (0, 7)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=120))
def test_hostile_bytes_are_refused(noise: bytes) -> None:
    with pytest.raises(DecodeError):
        read_keypoints(noise, 128, 4)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 8 * len(a_message()) - 1))
def test_one_flipped_bit_is_found(bit: int) -> None:
    message = bytearray(a_message())
    message[bit // 8] ^= 1 << bit % 8
    with pytest.raises(DecodeError):
        read_keypoints(bytes(message), 128, 4)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 300.0])
def test_numbers_that_are_none_are_refused_even_with_their_crc(value: float) -> None:
    body = struct.pack("<BBH", 1, 1, 1) + struct.pack("<3h", 0, 0, 0) + struct.pack("<2e", value, 0)
    with pytest.raises(DecodeError, match="does not write"):
        read_keypoints(body + struct.pack("<I", zlib.crc32(body)), 128, 2)


@pytest.mark.parametrize(("most", "width"), [(4, 4), (128, 3), (128, 5)])
def test_another_codecs_message_is_refused(most: int, width: int) -> None:
    with pytest.raises(DecodeError):
        read_keypoints(a_message(5, 4), most, width)


def looked(vehicles: int, points: int, room: int = 8) -> Seen:
    observation = {"command": np.eye(6, dtype=np.int8)[2], "ego": np.arange(4, dtype=np.float32)}
    clouds = [RNG.integers(-9000, 9000, (points + v, 3)) / 100 for v in range(vehicles)]
    return seen(clouds, RNG.normal(size=(vehicles, 3)), room, observation)


def test_frames_give_back_the_clouds_that_were_looked_at() -> None:
    looks = [looked(1, 4), looked(3, 0), looked(2, 6)]
    frames = CloudFrames(**packed_frames(looks, [0, 1, 0], vehicles=3))
    assert len(frames) == 3
    numbers = np.array([2, 1, 2])
    batch = frames.batch(numbers)
    assert batch["clouds"].shape == (3, 3, 8, 3)
    for b, frame in enumerate(numbers):
        look = looks[frame]
        assert batch["clouds_mask"][b].sum(1).tolist() == [len(c) for c in look.clouds] + [0] * (3 - len(look.clouds))
        for v, cloud in enumerate(look.clouds):
            found = batch["clouds"][b, v][batch["clouds_mask"][b, v] > 0]
            assert found.dtype == np.float32
            assert np.rint(found * 100).astype(int).tolist() == cloud.tolist()
            assert batch["poses"][b, v].tolist() == look.pose[v].tolist()
        assert not batch["clouds"][b][batch["clouds_mask"][b] == 0].any()


def test_joined_frames_are_these_and_then_the_others() -> None:
    parts = [CloudFrames(**packed_frames([looked(2, 3), looked(1, 5)], [0, 1], 2)) for _ in range(3)]
    whole = parts[0].joined(parts[1:])
    assert whole.label.tolist() == [0, 1] * 3
    for p, part in enumerate(parts):
        one, all_of_them = part.batch(np.arange(2)), whole.batch(np.arange(2) + 2 * p)
        assert all(np.array_equal(one[name], all_of_them[name]) for name in one)


def test_a_merged_frame_reads_as_the_observation_did() -> None:
    cloud, mask = np.zeros((16, 3), np.float32), np.zeros(16, np.int8)
    cloud[:7], mask[:7] = RNG.integers(-9000, 9000, (7, 3)) / 100, 1
    observation = {"cloud": cloud, "cloud_mask": mask, "command": np.eye(6, dtype=np.int8)[0], "ego": np.zeros(4)}
    frames = POINT_TRANSFORMER.frames([POINT_TRANSFORMER.look(None, observation)] * 2, [0, 1])  # type: ignore[arg-type]
    batch = frames.batch(np.array([1]))
    np.testing.assert_allclose(batch["cloud"][0], cloud, atol=1e-5)
    assert batch["cloud_mask"][0].tolist() == mask.tolist()
    assert frames.joined([frames]).batch(np.array([3]))["cloud"].shape == (1, 16, 3)


def test_sixty_thousand_frames_take_less_than_three_hundred_megabytes() -> None:
    frames = CloudFrames(**packed_frames([looked(5, 124, 128)] * 100, [0] * 100, 5))
    size = sum(part.nbytes for part in vars(frames).values() if isinstance(part, np.ndarray))
    assert size * 600 < 300e6
