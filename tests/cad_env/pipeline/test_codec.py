"""The codec: what goes in comes out, one spelling for each graph, and what cannot be sent is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cad_env.pipeline.codec import decode, encode, max_bytes
from cad_env.types import CAR, FRAMES, TRUCK, Graph

HALF_A_UNIT = 0.005 + 1e-9  # m

# The sender is a truck; the other is a car seen in three of the newest five frames, whose height is not one.
GOLDEN = "4347010f0102070040e20100010f00d00f630000870700000002d80415808f1cc80100e80e0b34c201010850e3a128"


def golden_graph() -> Graph:
    position = np.zeros((2, FRAMES, 3))
    position[0] = (10.0, -4.52, 0.01)
    position[0, :, 0] -= 0.5 * np.arange(FRAMES)[::-1]
    position[1, -1], position[1, -3], position[1, -5] = (-8.0, 4.96, 0.98), (-7.0, 4.9, 0.97), (-6.0, 5.1, 0.99)
    mask = np.zeros((2, FRAMES), bool)
    mask[0, -4:] = mask[1, [-1, -3, -5]] = True
    return Graph(7, 123.456, np.array([0, 300]), position, mask, np.array([TRUCK, CAR], np.int8))


def scene(tracks: int = 10, noise: float = 0.1, seed: int = 0) -> Graph:
    """Cars on their ways with the noise of sensors, all frames seen."""
    rng = np.random.default_rng(seed)
    speed, heading = rng.uniform(0.0, 15.0, tracks), rng.uniform(-math.pi, math.pi, tracks)
    way = np.cumsum(np.broadcast_to(0.1 * speed[:, None], (tracks, FRAMES)), axis=1)
    position = np.full((tracks, FRAMES, 3), 0.75)
    position[..., :2] = rng.uniform(-60.0, 60.0, (tracks, 1, 2)) + rng.normal(0.0, noise, (tracks, FRAMES, 2))
    position[..., 0] += way * np.cos(heading)[:, None]
    position[..., 1] += way * np.sin(heading)[:, None]
    return Graph(1, 1.4, np.arange(tracks), position, np.ones((tracks, FRAMES), bool), np.zeros(tracks, np.int8))


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    tracks, reach = draw(st.integers(0, 12)), draw(st.sampled_from([0.0, 1.0, 50.0, 10_000.0, 100_000.0]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    position = rng.uniform(-reach, reach, (tracks, FRAMES, 3))
    position[..., 2] = np.where(rng.random((tracks, 1)) < 0.7, position[:, :1, 2], position[..., 2])
    mask = rng.random((tracks, FRAMES)) < draw(st.sampled_from([0.05, 0.5, 0.9, 1.0]))
    ids = draw(st.lists(st.integers(0, 2**31 - 1), min_size=tracks, max_size=tracks, unique=True))
    return Graph(
        draw(st.integers(0, 2**16 - 1)),
        draw(st.integers(0, 2**32 - 1)) / 1000.0,
        np.array(ids, np.int64),
        position,
        mask,
        rng.integers(0, 2, tracks).astype(np.int8),
    )


@given(graphs(), st.integers(1, FRAMES))
def test_a_graph_comes_back_within_half_a_centimetre(graph: Graph, depth: int):
    back = decode(encode(graph, depth))
    newest = graph.mask.copy()
    newest[:, : FRAMES - depth] = False
    sent = newest.any(axis=1)
    assert (back.sender, back.time) == (graph.sender, graph.time)
    assert (back.track == graph.track[sent]).all()
    assert (back.kind == graph.kind[sent]).all()
    assert (back.mask == newest[sent]).all()
    assert np.abs(back.position - graph.position[sent])[back.mask].max(initial=0.0) <= HALF_A_UNIT
    assert (back.position[~back.mask] == 0.0).all()


@given(graphs(), st.integers(1, FRAMES))
def test_what_was_decoded_is_encoded_alike(graph: Graph, depth: int):
    payload = encode(graph, depth)
    assert len(payload) <= max_bytes(len(graph.track))
    assert encode(decode(payload), depth) == payload


def test_the_format_is_what_it_was():
    payload = encode(golden_graph())
    assert payload.hex() == GOLDEN
    assert np.abs(decode(payload).position - golden_graph().position)[golden_graph().mask].max() <= HALF_A_UNIT


def test_a_half_is_rounded_upwards_on_both_sides_of_zero():
    graph = scene(tracks=1)
    graph.position[:] = 0.125  # a half of a centimetre that binary numbers can hold
    assert decode(encode(graph)).position[0, 0, 0] == 0.13
    graph.position[:] = -0.125
    assert decode(encode(graph)).position[0, 0, 0] == -0.12


def test_ten_cars_with_noise_take_less_than_450_bytes():
    assert 350 <= len(encode(scene(tracks=10, noise=0.1))) <= 450
    assert len(encode(scene(tracks=10, noise=0.1), depth=1)) <= 130


def test_a_height_that_stays_costs_three_bytes_at_most_whatever_the_frames():
    flat = scene(tracks=1, noise=0.0)
    bumpy = replace(flat, position=flat.position.copy())
    bumpy.position[0, 3, 2] += 0.01
    assert len(encode(bumpy)) == len(encode(flat)) + FRAMES - 1


def test_a_track_unseen_in_the_newest_frames_is_not_sent():
    graph = scene(tracks=3)
    graph.mask[1, -4:] = False
    assert decode(encode(graph, depth=4)).track.tolist() == [0, 2]
    assert decode(encode(graph, depth=5)).track.tolist() == [0, 1, 2]


def test_255_tracks_fit_and_256_are_refused():
    assert len(decode(encode(scene(tracks=255))).track) == 255
    with pytest.raises(ValueError, match="number of tracks must be from 0 to 255, got 256"):
        encode(scene(tracks=256))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sender": 2**16}, "sender must be from 0 to 65535, got 65536"),
        ({"sender": -1}, "sender"),
        ({"time": -0.1}, "time in ms"),
        ({"time": math.nan}, "time in ms"),
        ({"track": np.array([4, 4])}, r"unique, got \[4, 4\]"),
        ({"track": np.array([0, 2**31])}, "track id"),
        ({"kind": np.array([0, 2])}, "kind"),
        ({"position": np.full((2, FRAMES, 3), np.nan)}, "coordinate in m"),
        ({"position": np.full((2, FRAMES, 3), 100_001.0)}, "coordinate in m must be from -100000 to 100000"),
        ({"position": np.zeros((2, 14, 3))}, "shapes"),
    ],
)
def test_a_graph_that_cannot_be_sent_is_refused_by_name(change: dict, message: str):
    with pytest.raises(ValueError, match=message):
        encode(replace(scene(tracks=2), **change))


@pytest.mark.parametrize("depth", [0, 16])
def test_the_depth_is_1_to_15_frames(depth: int):
    with pytest.raises(ValueError, match=f"depth must be from 1 to 15, got {depth}"):
        encode(scene(), depth)


def test_a_nan_among_the_absent_nodes_is_nobodys_business():
    graph = golden_graph()
    graph.position[~graph.mask] = np.nan
    assert encode(graph).hex() == GOLDEN
