"""Version 2 of the message: places come back as they were sent, in one spelling, and nothing hostile gets through."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cad_env.numerics.jit import compiled
from cad_env.pipeline.codec import (
    DECODE_REASONS,
    DECODED,
    FORMAT,
    MAX_BYTES,
    TRAILING,
    DecodeError,
    decode,
    decode_with_places,
    encode,
    max_bytes,
    read,
    read_with_places,
    write_with_places,
)
from cad_env.pipeline.graph_arrays import empty_graph_arrays
from cad_env.pipeline.intervals import BEYOND_LANE, FORMAT_LANES, NO_LANE, NO_PLACE, intervals_of, places_of
from cad_env.pipeline.varint import LONG_VARINT, TRUNCATED, crc32
from cad_env.types import MAX_TRACKS, Bytes, GraphArrays
from cad_env.world.lanes import PLACES
from tests.cad_env.pipeline.test_codec import GOLDEN, golden_graph, scene
from tests.cad_env.pipeline.test_codec_hostile import hurt, refusal, with_crc

# Lane 0 from place 3 to 11, lane 2 places 0 and 1 and from 120 to the end.
INTERVALS = [[(3, 12)], [], [(0, 2), (120, 128)]]
GOLDEN_PLACES = "03" + "010308" + "00" + "0200017507"


@st.composite
def place_sets(draw: st.DrawFn) -> np.ndarray:
    """Places by chance, mostly in a few intervals."""
    lanes = draw(st.integers(0, 9))
    edges = st.lists(st.integers(0, PLACES), max_size=8)
    rows = [np.cumsum(np.bincount(np.array(draw(edges), int), minlength=PLACES + 1)[:PLACES]) % 2 for _ in range(lanes)]
    return np.array(rows, np.uint8).reshape(lanes, PLACES)


@given(place_sets())
def test_places_come_back_and_are_written_alike(places: np.ndarray) -> None:
    payload = encode(golden_graph(), places=places)
    assert len(payload) <= max_bytes(2, max(len(places), 1))
    _, back = decode_with_places(payload)
    assert (back[: len(places)] == places).all()
    assert not back[len(places) :].any()
    assert encode(golden_graph(), places=back) == payload


def test_the_format_is_what_it_was() -> None:
    payload = encode(golden_graph(), places=places_of(INTERVALS))
    graph = GOLDEN[:4] + "02" + GOLDEN[6:-8]
    assert payload == with_crc(bytes.fromhex(graph + GOLDEN_PLACES))
    assert intervals_of(decode_with_places(payload)[1])[:4] == [*INTERVALS, []]


def test_a_message_without_places_is_of_version_1_and_with_an_empty_set_a_byte_longer() -> None:
    plain = encode(golden_graph())
    assert plain.hex() == GOLDEN
    assert decode_with_places(plain)[1] is None
    assert len(encode(golden_graph(), places=np.zeros((8, PLACES), np.uint8))) == len(plain) + 1


def test_the_worst_set_fits() -> None:
    combs = np.zeros((FORMAT_LANES, PLACES), np.uint8)
    combs[:, ::2] = 1
    payload = encode(scene(tracks=255), places=combs)
    assert len(payload) <= max_bytes(255, FORMAT_LANES)
    assert (decode_with_places(payload)[1] == combs).all()


def test_places_that_cannot_be_sent_are_refused() -> None:
    with pytest.raises(ValueError, match=r"places must be \(B, 128\) of at most 255 lanes, got \(2, 5\)"):
        encode(golden_graph(), places=np.zeros((2, 5), np.uint8))
    with pytest.raises(ValueError, match="256"):
        encode(golden_graph(), places=np.zeros((256, PLACES), np.uint8))


HEAD = bytes.fromhex("4347020f0101070040e20100") + bytes([0, 1, 0, 0, 0, 0])  # one track in one frame


@pytest.mark.parametrize(
    ("tail", "reason"),
    [
        ([], TRUNCATED),
        ([1], TRUNCATED),
        ([1, 1, 0], TRUNCATED),
        ([1, 0], NO_PLACE),
        ([2, 1, 0, 0, 0], NO_PLACE),
        ([1, 1, 127, 1], BEYOND_LANE),
        ([1, 1, 0x80, 1, 0], BEYOND_LANE),
        ([1, 2, 0, 126, 0, 0], BEYOND_LANE),
        ([1, 1, 0, 0xFF, 0xFF, 0xFF, 0xFF, 0x7F], BEYOND_LANE),
        ([1, 0x80, 0, 0, 0], LONG_VARINT),
        ([0x80, 2], NO_LANE),
        ([0, 0], TRAILING),
        ([1, 1, 0, 0, 0], TRAILING),
    ],
)
def test_each_rule_of_places_has_its_refusal(tail: list[int], reason: int) -> None:
    assert refusal(with_crc(HEAD + bytes(tail))).endswith(DECODE_REASONS[reason])


def test_what_those_refusals_spoil_is_accepted() -> None:
    for tail in ([0], [1, 1, 0, 127], [1, 2, 0, 125, 0, 0]):
        assert decode(with_crc(HEAD + bytes(tail))).track.tolist() == [0]


def test_who_shares_no_coverage_knows_the_first_version_alone() -> None:
    payload = np.array(bytearray(with_crc(HEAD + b"\x00")), np.uint8)
    header, rows = np.zeros(3, np.int64), empty_graph_arrays()
    assert read(payload, len(payload), header, rows) == FORMAT
    assert read_with_places(payload, len(payload), header, rows, np.zeros((0, PLACES), np.uint8)) == DECODED


def test_lanes_that_the_map_has_not_are_refused_without_a_word_of_them_being_kept() -> None:
    payload = np.array(bytearray(encode(golden_graph(), places=places_of(INTERVALS))), np.uint8)
    rows, places = empty_graph_arrays(), np.ones((2, PLACES), np.uint8)
    assert read_with_places(payload, len(payload), np.zeros(3, np.int64), rows, places) == NO_LANE
    assert rows.used[0] == 0
    assert not places.any()


@given(st.binary(max_size=60))
def test_any_bytes_are_refused_or_are_the_one_spelling_of_places(body: bytes) -> None:
    for payload in (with_crc(HEAD + body), with_crc(bytes.fromhex(GOLDEN[:4] + "02" + GOLDEN[6:-8]) + body)):
        try:
            graph, places = decode_with_places(payload)
        except DecodeError:
            continue
        assert encode(graph, depth=payload[3], places=places) == payload


@compiled
def attack(good: Bytes, noise: Bytes, seal: bool, again: Bytes, rows: GraphArrays, places: Bytes, met: Bytes) -> int:
    """Hurt a message once per row of `noise`; counts what was accepted but would be written otherwise."""
    wrong, buffer = 0, np.zeros(4 * len(good), np.uint8)
    header = np.zeros(3, np.int64)
    for case in range(noise.shape[0]):
        buffer[: len(good)] = good
        length = hurt(buffer, len(good) - 4 if seal else len(good), case % 4, noise[case])
        if seal:
            crc = crc32(buffer, length)
            for index in range(4):
                buffer[length + index] = crc >> 8 * index & 255
            length += 4
        status = read_with_places(buffer, length, header, rows, places)
        met[status] = 1
        if status == DECODED and buffer[2] == 2:
            size = write_with_places(again, header[0], header[1], header[2], rows, places)
            wrong += size != length or (again[:size] != buffer[:size]).any()
    return wrong


@pytest.mark.parametrize("seal", [False, True])
def test_no_hurt_message_with_places_is_accepted_in_a_second_spelling(seal: bool) -> None:
    met, again = np.zeros(len(DECODE_REASONS), np.uint8), np.zeros(max_bytes(MAX_TRACKS, 8), np.uint8)
    rows, places, rng = empty_graph_arrays(), np.zeros((8, PLACES), np.uint8), np.random.default_rng(0)
    for tracks, density in ((1, 0.03), (1, 0.5), (2, 0.0)):
        chosen = np.cumsum(rng.random((8, PLACES)) < density, axis=1) % 2
        good = np.array(bytearray(encode(scene(tracks=tracks, noise=0.0), places=chosen)), np.uint8)
        noise = rng.integers(0, 256, (20_000, 12), dtype=np.uint8)
        assert attack(good, noise, seal, again, rows, places, met) == 0
    if seal:
        assert met[[DECODED, TRUNCATED, LONG_VARINT, TRAILING, BEYOND_LANE, NO_LANE, NO_PLACE]].all()


def test_the_longest_message_of_the_first_version_is_what_it_was() -> None:
    assert max_bytes(MAX_TRACKS) == MAX_BYTES == 16 + 32 * 232
