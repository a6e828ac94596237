"""Bytes from outside on the air: what is not true of itself is refused whole, and nothing held is touched."""

import copy
import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from document_decoder import RefusedError, decode_graph
from scenes import started, steps

from cad_env.envs.parallel import CADParallelEnv
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.lidar.envelope import Envelope, seal
from cad_env.pipeline.codec import MAX_BYTES, encode, max_bytes
from cad_env.pipeline.graph_arrays import as_graph, slide
from cad_env.pipeline.radio import LOST, REACHES
from cad_env.scenarios import SCENARIOS
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import CAR, FRAMES, GO, MAX_TRACKS, Graph, GraphArrays
from tests.cad_env.pipeline.test_codec import scene
from tests.cad_env.pipeline.test_codec_hostile import with_crc

SEED = 5
CLOUD = {"azimuths": 64, "beams": 4}


def everything(graph: Graph) -> Graph:
    """Shares all that is known, by way of Python."""
    return graph


def go(simulation: Simulation) -> None:
    """One step in which all go."""
    simulation.step(np.full(len(simulation.agents), GO))


def soon(simulation: Simulation, sender: int) -> Graph:
    """What a vehicle knows, as if said in the next step."""
    return replace(simulation.own_graph(sender), time=(simulation.steps + 1) / 10)


def kept(simulation: Simulation, receiver: int, sender: int) -> GraphArrays:
    """A copy of what a receiver holds of a sender."""
    return GraphArrays(*(part[receiver, sender].copy() for part in simulation.fleet.kept))


def facts(arrays: GraphArrays) -> list[Any]:
    """What is in the rows in use."""
    graph = as_graph(arrays, 0, 0.0)
    return [part.tolist() for part in (graph.track, graph.position, graph.mask, graph.kind)]


def begun(way: str, count: int = 12, **options: Any) -> Simulation:
    """An episode in which messages were sent for a while."""
    rules = {"compiled": {}, "python": {"share": everything}}[way]
    simulation = started(SEED, **{"radio": "ideal", **rules, **options})
    for _ in steps(simulation, count):
        pass
    return simulation


EVERY_WAY = pytest.mark.parametrize("way", ["compiled", "python"])
LIES = {
    "another vehicle": lambda graph, count: encode(replace(graph, sender=2)),
    "one vehicle more": lambda graph, count: encode(replace(graph, sender=count)),
    "vehicle 1000": lambda graph, count: encode(replace(graph, sender=1000)),
    "vehicle 65535": lambda graph, count: encode(replace(graph, sender=2**16 - 1)),
    "33 tracks": lambda graph, count: encode(replace(scene(tracks=33), sender=1, time=graph.time)),
    "255 tracks, one frame": lambda graph, count: encode(replace(scene(tracks=255), sender=1, time=graph.time), 1),
    "a step ahead": lambda graph, count: encode(replace(graph, time=graph.time + 0.1)),
    "far ahead": lambda graph, count: encode(replace(graph, time=(2**32 - 1) / 1000)),
    "a step ago": lambda graph, count: encode(replace(graph, time=graph.time - 0.1)),
    "the beginning": lambda graph, count: encode(replace(graph, time=0.0)),
    "a wrong CRC": lambda graph, count: encode(graph)[:-1] + b"x",
    "nothing": lambda graph, count: b"",
    "half of it": lambda graph, count: encode(graph)[:40],
    "noise": lambda graph, count: bytes(range(256)) * 20,
}


@EVERY_WAY
@pytest.mark.parametrize("lie", LIES.values(), ids=LIES)
def test_a_message_that_lies_is_refused_whole_by_all_it_reaches(way: str, lie: Any):
    simulation = begun(way)
    count = len(simulation.agents)
    payload = lie(soon(simulation, 1), count)
    if len(payload) > MAX_BYTES:
        pytest.fail("no such message can be on the air")
    before = {(r, v): kept(simulation, r, v) for r in range(count) for v in range(count)}
    simulation.inject(1, payload)
    go(simulation)
    report = simulation.fleet.report
    assert report.messages_refused.tolist() == [int(r != 1) for r in range(count)]
    assert report.sent_bytes[1] == len(payload)
    assert simulation.info()["messages_refused"] == 1
    assert report.received_bytes[0] == report.sent_bytes[2:].sum()
    for r in range(count):
        slide(before[r, 1])
        assert facts(kept(simulation, r, 1)) == facts(before[r, 1])
        for v in range(2, count):  # the messages of the others are as ever
            assert r == v or kept(simulation, r, v).mask[0, -1]


@EVERY_WAY
@pytest.mark.parametrize("late", [0, 3])
def test_a_message_that_is_true_of_itself_is_believed_whatever_it_says(way: str, late: int):
    simulation = begun(way, radio={"rate": 1e9, "loss": 0.0, "range": 1e6, "delay": 0.1 * late})
    shape = (1, FRAMES)
    place = np.full((*shape, 3), simulation.fleet.trail[0, -1, 0] + 20.0)
    ghost = Graph(1, 0.0, np.array([77]), place, np.ones(shape, np.bool_), np.array([CAR], np.int8))
    simulation.inject(1, encode(replace(ghost, time=(simulation.steps + 1) / 10)))
    for _ in range(1 + late):
        assert 77 not in kept(simulation, 0, 1).track[: kept(simulation, 0, 1).used[0]]
        go(simulation)
    assert simulation.fleet.report.messages_refused.tolist() == [0] * len(simulation.agents)
    held = as_graph(kept(simulation, 0, 1), 1, 0.0)
    row = held.track.tolist().index(77)
    assert held.mask[row].tolist() == [True] * (FRAMES - late) + [False] * late
    np.testing.assert_allclose(held.position[row, held.mask[row]], place[0, late:], atol=0.005)
    go(simulation)  # and from the next step on it sends its own again
    assert simulation.fleet.report.messages_refused[0] == 0
    held = as_graph(kept(simulation, 0, 1), 1, 0.0)
    assert 0 in held.track[held.mask[:, FRAMES - 1 - late]]  # its own body; the ghost is no more
    assert not held.mask[held.track == 77].any()


@EVERY_WAY
def test_an_injected_message_costs_and_is_lost_as_any(way: str):
    tight = begun(way, radio={"rate": 8 * 10 * 150.0, "loss": 0.0})
    tight.inject(0, bytes(151))
    go(tight)
    assert tight.info()["refused"] == "over the byte budget of its slot"
    assert (tight.fleet.report.sent_bytes[0], tight.fleet.report.messages_refused.sum()) == (0, 0)
    none = begun(way, radio="none")
    none.inject(1, encode(soon(none, 1)))
    go(none)
    assert none.info()["messages_sent"] == none.info()["messages_refused"] == 0
    lossy, ends = begun(way, count=3, radio={"loss": 0.5, "range": 1e6}), []
    for _ in range(40):
        lossy.inject(1, b"?")
        go(lossy)
        end, size = lossy.arrival(1, 0)
        assert (size, lossy.info()["messages_refused"]) == (1, int(end == REACHES))
        ends.append(end)
    assert set(ends) == {LOST, REACHES}


@EVERY_WAY
def test_a_bad_message_hides_no_loss_from_those_it_does_not_reach(way: str):
    usual, spoilt = (begun(way, count=3, radio={"loss": 0.4, "range": 1e6}) for _ in range(2))
    for _ in range(30):
        for v in range(1, len(spoilt.agents)):
            spoilt.inject(v, b"?")
        go(usual)
        go(spoilt)
        assert spoilt.fleet.report.lost.tolist() == usual.fleet.report.lost.tolist()


@EVERY_WAY
def test_a_wrong_call_is_refused_in_one_line(way: str):
    simulation = begun(way)
    for sender in (-1, len(simulation.agents), 1.0, "1", None, True):
        with pytest.raises(ValueError, match=r"sender must be a connected vehicle, a whole number from 0 to \d+, got "):
            simulation.inject(sender, b"")
    with pytest.raises(TypeError, match="payload must be bytes, got str"):
        simulation.inject(np.int64(0), "text")  # type: ignore[arg-type]
    with pytest.raises(RuntimeError, match=r"there is no episode yet: call reset\(\) before inject\(\)"):
        Simulation(setup_from({})).inject(0, b"")
    if way == "compiled":
        simulation.inject(1, bytes(MAX_BYTES))
        with pytest.raises(ValueError, match=f"payload must have at most {MAX_BYTES} bytes"):
            simulation.inject(1, bytes(MAX_BYTES + 1))


def test_every_environment_counts_them():
    single, many, fleet = (
        CADEnv(radio="ideal"),
        CADVectorEnv(3, radio="ideal"),
        CADParallelEnv(radio="ideal", waiting=True),
    )
    assert single.reset(seed=SEED)[1]["messages_refused"] == 0
    assert many.reset(seed=SEED)[1]["messages_refused"].tolist() == [0, 0, 0]
    assert {info["messages_refused"] for info in fleet.reset(seed=SEED)[1].values()} == {0}
    for simulation in (single.simulation, many.batch.simulations[1], fleet.simulation):
        simulation.inject(1, b"?")
    for expected in (1, 0):
        assert single.step(GO)[4]["messages_refused"] == expected
        assert many.step(np.full(3, GO))[4]["messages_refused"].tolist() == [0, expected, 0]
        infos = fleet.step(dict.fromkeys(fleet.agents, GO))[4]
        refused = [infos[agent]["messages_refused"] for agent in fleet.possible_agents]
        assert refused == [expected, 0, expected, expected]


@EVERY_WAY
def test_copies_and_new_episodes_are_worlds_of_their_own(way: str):
    simulation = begun(way)
    simulation.inject(1, b"?")
    for twin in (copy.deepcopy(simulation), pickle.loads(pickle.dumps(simulation))):
        go(twin)
        assert twin.info()["messages_refused"] == 1
    simulation.start(SEED)
    go(simulation)
    assert simulation.info()["messages_refused"] == 0


def test_messages_of_points_are_held_to_the_same_rules():
    def sealed(sender: int, ahead: float, content: bytes) -> Callable[[], bytes]:
        return lambda: seal(Envelope(sender, (simulation.steps + 1) / 10 + ahead, (0.0, 0.0, 0.0), content))

    simulation = started(SEED, cloud=CLOUD, radio="ideal")
    empty = (0).to_bytes(4, "little")
    for write, refused in (
        (sealed(1, 0.0, empty), 0), (sealed(1, 0.05, empty), 0), (sealed(2, 0.0, empty), 1),
        (sealed(60_000, 0.0, empty), 1), (sealed(1, 0.1, empty), 1), (sealed(1, 1e6, empty), 1),
        (sealed(1, 0.0, b"\1\0\0\0"), 1), (lambda: b"", 1), (lambda: bytes(100), 1),
    ):  # fmt: skip
        payload = write()
        simulation.inject(1, payload)
        go(simulation)
        info = simulation.info()
        assert info["messages_refused"] == refused
        others = simulation.fleet.report.sent_bytes[2:].sum()
        assert info["bytes_received"] == others + (0 if refused else len(payload))
        assert simulation.fleet.report.sent_bytes[1] == len(payload)
    go(simulation)
    assert simulation.info()["messages_refused"] == 0


# --- The same with chance ----------------------------------------------------------------------------------------


def crowd(rng: np.random.Generator, tracks: int) -> Graph:
    """Tracks anywhere, seen now and then."""
    position = rng.uniform(-(10.0 ** rng.integers(1, 6)), 10.0 ** rng.integers(1, 6), (tracks, FRAMES, 3))
    mask, kind = rng.random((tracks, FRAMES)) < 0.5, rng.integers(0, 2, tracks).astype(np.int8)
    return Graph(0, 0.0, rng.choice(2**31 - 1, tracks, replace=False), position, mask, kind)


def hostile(rng: np.random.Generator, simulation: Simulation, v: int) -> bytes:
    """A message as an attacker may write it, sometimes one that is acceptable."""
    now, count = simulation.steps + 1, len(simulation.agents)
    if rng.random() < 0.05:
        return rng.bytes(rng.integers(MAX_BYTES + 1))
    graph = simulation.own_graph(v) if rng.random() < 0.6 else crowd(rng, int(rng.choice([0, 1, 5, 20, 32, 33])))
    sender = int(rng.choice([*[v] * 9, (v + 1) % count, count, count + 1, 1000, 65_535, rng.integers(65_536)]))
    ahead = rng.choice([*[0] * 18, 0.04, 0.05, 0.051, -0.05, -0.06, 0.1, -0.1, -now / 10, -1.4, 4e6, 1e9])
    time_ms = min(max(round(1000 * (now / 10 + ahead)), 0), 2**32 - 1)
    payload = encode(replace(graph, sender=sender, time=time_ms / 1000), int(rng.choice([1, 3, 15])))
    body = bytearray(payload[:-4])
    kind = rng.choice(["as it is", "flip", "cut", "grow", "overwrite"], p=[0.6, 0.1, 0.1, 0.1, 0.1])
    if kind == "flip":
        body[rng.integers(len(body))] ^= 1 << rng.integers(8)
    elif kind == "cut":
        del body[rng.integers(len(body)) :]
    elif kind == "grow":
        body += rng.bytes(rng.integers(1, 9))
    elif kind == "overwrite":
        start = int(rng.integers(len(body)))
        body[start : start + 8] = rng.bytes(min(8, len(body) - start))
    sealed = with_crc(bytes(body))
    return (sealed if rng.random() < 0.95 else sealed[:-4] + rng.bytes(4))[:MAX_BYTES]


def acceptable(payload: bytes, v: int, step: int) -> bool:
    """Whether the documents say that a message, sent in a step by vehicle v, is received."""
    try:
        message = decode_graph(payload)
    except RefusedError:
        return False
    return message.sender == v and abs(message.time_ms - 100 * step) <= 50 and len(message.tracks) <= MAX_TRACKS


def attacked(seed: int, count: int, **options: Any) -> Iterator[tuple[Simulation, list[bool]]]:
    """Steps of an episode in which the air is full of hostile bytes, and of every vehicle's whether it is received.

    Both ways of sharing are attacked alike, and must tell and know the same; with an ideal radio, what they refuse is
    what the documents refuse, and leaves what is held as it is.
    """
    rng = np.random.default_rng(seed)
    ways = [started(seed, **options, **rules) for rules in ({}, {"share": everything})]
    compiled, python = ways
    vehicles, ideal = len(compiled.agents), options["radio"] == "ideal"
    for _ in range(count):
        if compiled.outcome() is not None:
            break
        verdicts = []
        for v in range(vehicles):
            payload = hostile(rng, compiled, v)
            verdicts.append(acceptable(payload, v, compiled.steps + 1))
            for simulation in ways:
                simulation.inject(v, payload)
        before = {(r, v): kept(compiled, r, v) for r in range(vehicles) for v in range(vehicles)}
        for simulation in ways:
            go(simulation)
        for one, other in zip(compiled.fleet.report, python.fleet.report, strict=True):
            assert one.tolist() == other.tolist()
        for one, other in zip(compiled.fleet.views, python.fleet.views, strict=True):
            assert one.tobytes() == other.tobytes()
        if ideal and set(compiled.fleet.report.refusal.tolist()) == {0}:
            check_verdicts(compiled, before, verdicts)
        yield compiled, verdicts


def check_verdicts(simulation: Simulation, before: dict[tuple[int, int], GraphArrays], verdicts: list[bool]) -> None:
    """What is refused is counted, and leaves what is held as it was."""
    report, vehicles = simulation.fleet.report, range(len(verdicts))
    for r in vehicles:
        refused = [v for v in vehicles if v != r and not verdicts[v]]
        assert report.messages_refused[r] == len(refused)
        assert report.received_bytes[r] == sum(report.sent_bytes[v] for v in vehicles if v != r and verdicts[v])
        for v in (*refused, r):
            slide(before[r, v])
            assert facts(kept(simulation, r, v)) == facts(before[r, v])


def fuzzed(seeds: range, count: int) -> list[int]:
    """How many messages were refused, and how many received, in episodes of all scenarios and two radios."""
    met = [0, 0]
    for seed in seeds:
        scenario = list(SCENARIOS)[seed % 3]
        radio = ("ideal", {"rate": 1e9, "loss": 0.2, "delay": 0.1 * (seed % 15), "range": 200.0})[seed % 2]
        for _, verdicts in attacked(seed, count, scenario=scenario, radio=radio, depth=(15, 3)[seed // 2 % 2]):
            for verdict in verdicts:
                met[verdict] += 1
    return met


def test_an_air_full_of_hostile_bytes_harms_nothing():
    refused, received = fuzzed(range(6), 40)
    assert refused > 300
    assert received > 100


@pytest.mark.slow
def test_an_air_full_of_hostile_bytes_harms_nothing_for_long():
    refused, received = fuzzed(range(100, 250), 150)
    assert refused > 30_000
    assert received > 10_000


def test_no_message_of_32_tracks_is_too_long_to_be_injected():
    assert max_bytes(MAX_TRACKS) == MAX_BYTES
