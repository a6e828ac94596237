"""Points thinned and as bytes, and the envelope around them: to a centimetre, and no hostile bytes are believed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cad_env.lidar.envelope import ENVELOPE_SIZE, Envelope, opened, seal
from cad_env.lidar.points import GROUND, KEPT, MOST_POINTS, POINT_REACH, RawPoints, relative, thinned
from cad_env.pipeline.varint import DecodeError

coordinates = st.floats(-POINT_REACH, POINT_REACH)
clouds = st.integers(0, 40).flatmap(lambda count: arrays(np.float64, (count, 3), elements=coordinates))
crowded = st.builds(
    lambda seed, count, side: np.random.default_rng(seed).integers(-side, side, (count, 3)) / 100.0,
    st.integers(0, 2**31), st.integers(0, 300), st.sampled_from([60, 400, 3000]),
)  # fmt: skip


def voxels(cloud: np.ndarray) -> list[tuple[int, ...]]:
    return [tuple(math.floor(cm + 0.5) // 100 for cm in (100.0 * point).tolist()) for point in cloud]


@given(crowded, st.integers(1, 400))
def test_thinning_keeps_the_first_point_of_each_cube_above_the_ground(cloud: np.ndarray, most: int):
    high = [point for point in cloud if point[2] > GROUND]
    first = dict(reversed(list(zip(voxels(high), high, strict=True))))
    order = list(dict.fromkeys(voxels(high)))
    kept = [first[voxel] for voxel in order]
    shown = min(len(kept), most)
    assert thinned(cloud, most).tolist() == [kept[k * len(kept) // shown].tolist() for k in range(shown)]


def test_a_cloud_on_the_edge_of_cubes_is_not_thinned_otherwise_by_the_last_bit():
    wall = np.stack([np.full(500, 3.0), np.linspace(-20, 20, 500), np.ones(500)], axis=1)
    beside = wall - [1e-12, 0.0, 1e-12]
    assert np.abs(thinned(wall, 1000) - thinned(beside, 1000)).max() < 1e-9


@given(clouds)
def test_law_5_what_is_decoded_is_what_was_sent_to_half_a_centimetre(cloud: np.ndarray):
    payload = RawPoints().encode([cloud, cloud[:1]])[0]
    assert len(payload) == 4 + 6 * len(cloud)
    heard = RawPoints(most=MOST_POINTS).decode(payload)
    said = thinned(np.floor(cloud * 100.0 + 0.5) / 100.0, MOST_POINTS)
    assert heard.shape == said.shape
    assert np.abs(heard - said).max(initial=0.0) < 1e-9
    assert all(np.abs(cloud - point).max(axis=1).min() <= 0.005 + 1e-9 for point in heard)
    assert len(RawPoints(most=3).decode(payload)) <= 3


@given(clouds)
def test_a_cloud_in_centimetres_is_said_as_it_is(cloud: np.ndarray):
    units = np.floor(cloud * 100.0 + 0.5).astype(np.int16)
    assert RawPoints().encode([units]) == RawPoints().encode([cloud])


def test_a_raw_message_is_thinned_as_its_points_in_metres_are():
    every = np.arange(-(2**15), 2**15).astype(np.int16)
    for axis in range(3):
        cloud = np.full((len(every), 3), 21, np.int16)
        cloud[:, axis] = every
        heard = RawPoints(most=MOST_POINTS).decode(RawPoints().encode([cloud])[0])
        assert heard.tobytes() == thinned(cloud * 0.01, MOST_POINTS).tobytes()


@given(clouds, st.floats(-1e5, 1e5), st.floats(-20.0, 20.0))
def test_a_pose_in_the_frame_of_another_is_where_it_is_seen_from_there(cloud: np.ndarray, x: float, turn: float):
    for here in cloud:
        ahead, aside, more = relative((x, 3.0, turn), here)
        cos, sin = math.cos(here[2]), math.sin(here[2])
        assert here[0] + ahead * cos - aside * sin == pytest.approx(x, abs=1e-6)
        assert here[1] + ahead * sin + aside * cos == pytest.approx(3.0, abs=1e-6)
        assert here[2] + more == pytest.approx(turn, abs=1e-9)


def test_a_message_decodes_to_no_more_than_it_says():
    many = np.random.default_rng(0).uniform(1.0, 100.0, (5000, 3))
    assert RawPoints().most == KEPT
    assert RawPoints().decode(RawPoints().encode([many])[0]).shape == (KEPT, 3)


@pytest.mark.parametrize("wrong", [np.full((2, 3), 400.0), np.full((1, 3), np.nan), np.zeros((3, 2)), np.zeros(3)])
def test_what_cannot_be_said_is_not_said_wrongly(wrong: np.ndarray):
    with pytest.raises(ValueError, match="cloud"):
        RawPoints().encode([wrong])


@given(st.binary(max_size=200), st.integers(0, 40))
def test_law_5_hostile_bytes_raise_only_decode_error(junk: bytes, count: int):
    for payload in (junk, count.to_bytes(4, "little") + junk, b"\xff\xff\xff\x7f" + junk):
        try:
            points = RawPoints().decode(payload)
        except DecodeError:
            continue
        assert np.isfinite(points).all()
        assert np.abs(points).max(initial=0.0) <= 327.68


@given(st.binary(max_size=200), st.integers(0, 2**16 - 1))
def test_law_5_a_hostile_envelope_raises_only_decode_error(junk: bytes, sender: int):
    whole = seal(Envelope(sender, 2.0, (1.0, 2.0, 0.5), junk))
    for message in (junk, whole[:-1], whole + b"\0", b"?" + junk + whole, whole[: ENVELOPE_SIZE - 1], b"CP\1" + junk):
        with pytest.raises(DecodeError):
            opened(message)


envelopes = st.builds(
    Envelope, st.integers(0, 2**16 - 1), st.integers(0, 10**6).map(lambda step: step / 10.0),
    st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(-20.0, 20.0)), st.binary(max_size=50),
)  # fmt: skip


@given(envelopes, st.data())
def test_an_envelope_holds_its_sender_time_and_pose_and_no_changed_bit_goes_unnoticed(envelope: Envelope, data):
    message = seal(envelope)
    found = opened(message)
    assert len(message) == ENVELOPE_SIZE + len(envelope.content)
    assert (found.sender, found.content) == (envelope.sender, envelope.content)
    assert found.time == pytest.approx(envelope.time, abs=1e-9)
    assert found.pose[:2] == pytest.approx(envelope.pose[:2], abs=0.005 + 1e-9)
    assert abs(math.remainder(found.pose[2] - envelope.pose[2], 2 * math.pi)) < 1e-6
    assert seal(found) == message
    bit = data.draw(st.integers(0, 8 * len(message) - 1))
    changed = bytearray(message)
    changed[bit // 8] ^= 1 << bit % 8
    with pytest.raises(DecodeError):
        opened(bytes(changed))
