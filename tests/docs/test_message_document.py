"""docs/perception-and-radio.md is enough to read the messages: a decoder written from it alone reads real ones."""

from collections.abc import Iterator

import numpy as np
import pytest
from document_decoder import Message, RefusedError, decode_graph, decode_points
from scenes import started, steps

from cad_env.lidar.envelope import opened
from cad_env.pipeline.codec import DecodeError, decode_with_places, encode
from cad_env.pipeline.intervals import intervals_of
from cad_env.scenarios import SCENARIOS
from cad_env.types import FRAMES, Graph
from tests.cad_env.pipeline.test_codec import GOLDEN, golden_graph, scene
from tests.cad_env.pipeline.test_codec_hostile import with_crc


def sent(**options) -> Iterator[bytes]:
    """The messages that are on the air in an episode."""
    simulation = started(11, radio="ideal", traffic="dense", **options)
    for _ in steps(simulation, 100):
        air, slot = simulation.fleet.air, simulation.steps % len(simulation.fleet.air.step)
        for v in np.flatnonzero(air.on_air[slot] & (air.step[slot] == simulation.steps)):
            yield air.payload[slot, v, : air.length[slot, v]].tobytes()


def agree(message: Message, read: tuple[Graph, np.ndarray | None]) -> None:
    """Both read the same."""
    graph, places = read
    assert message.empty == (None if places is None else without_last_empty(intervals_of(places)))
    assert (message.sender, message.time_ms) == (graph.sender, round(1000 * graph.time))
    assert [(track.id, track.kind) for track in message.tracks] == list(
        zip(graph.track.tolist(), graph.kind.tolist(), strict=True)
    )
    for row, track in enumerate(message.tracks):
        ages = np.flatnonzero(graph.mask[row][::-1])
        assert list(track.nodes) == ages.tolist()
        centimetres = np.rint(100 * graph.position[row, FRAMES - 1 - ages]).astype(int)
        assert np.array(list(track.nodes.values())).tolist() == centimetres.tolist()


def without_last_empty(lanes: list[list[tuple[int, int]]]) -> list[list[tuple[int, int]]]:
    """The lanes up to the last one with an interval."""
    return lanes[: max((b + 1 for b, lane in enumerate(lanes) if lane), default=0)]


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize(("depth", "coverage"), [(3, False), (FRAMES, False), (3, True)])
def test_hundreds_of_real_messages_are_read_alike(scenario: str, depth: int, coverage: bool) -> None:
    messages = list(sent(scenario=scenario, depth=depth, sensor={"miss": 0.2}, coverage=coverage))
    assert len(messages) > 150
    tracks = 0
    for payload in messages:
        message = decode_graph(payload)
        agree(message, decode_with_places(payload))
        assert message.depth == depth
        tracks += len(message.tracks)
    assert tracks > 3 * len(messages)


def test_the_worked_example_and_the_rule_for_heights_are_read_alike() -> None:
    agree(decode_graph(bytes.fromhex(GOLDEN)), (golden_graph(), None))
    walk = bytes.fromhex("d21802410a")
    payload = with_crc(bytes.fromhex("4347010f01010700dc050000") + bytes([0, 15, 0]) + walk + bytes(4) + bytes(1))
    message = decode_graph(payload)
    assert [x for x, _, _ in message.tracks[0].nodes.values()] == [1577, 1578, 1546, 1535]
    agree(message, decode_with_places(payload))


def test_what_is_spoilt_is_refused_by_both_or_read_alike_by_both() -> None:
    rng, ends = np.random.default_rng(4), set()
    good = [bytes.fromhex(GOLDEN), *(payload for payload in sent(scenario="left_turn"))][:40]
    bumpy = scene(tracks=2)
    bumpy.position[1, ::2, 2] += 0.01
    good += [encode(bumpy), *list(sent(scenario="overtaking", coverage=True))[:40]]
    for case in range(8000):
        body = bytearray(good[case % len(good)][:-4])
        for _ in range(rng.integers(1, 4)):
            body[rng.integers(len(body))] = rng.choice([0, 1, 2, 127, 128, 255, rng.integers(256)])
        payload = with_crc(bytes(body[: rng.integers(12, len(body) + 1)] if case % 5 == 0 else body))
        try:
            read = decode_with_places(payload)
        except DecodeError:
            ends.add("refused")
            with pytest.raises(RefusedError):
                decode_graph(payload)
            continue
        ends.add("read")
        agree(decode_graph(payload), read)
    assert ends == {"refused", "read"}


def test_messages_of_raw_points_are_read_alike() -> None:
    simulation = started(5, radio="ideal", cloud={"azimuths": 64, "beams": 8}, sensor={"gnss_yaw_noise": 0.1})
    read = 0
    for _ in steps(simulation, 20):
        for message in simulation.sharing._air[simulation.steps].message:
            found, envelope = decode_points(message), opened(message)
            assert (found.sender, found.time_ms) == (envelope.sender, round(1000 * envelope.time))
            assert (found.x, found.y, found.heading) == pytest.approx(envelope.pose, abs=1e-12)
            units = np.frombuffer(envelope.content, "<i2", offset=4).reshape(-1, 3)
            assert [list(point) for point in found.points] == units.tolist()
            read += 1
    assert read > 50
