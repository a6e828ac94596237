"""What is shared by rules from outside: the same radio, budget and accounting as the compiled path."""

import copy
import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import cad_env
from cad_env.envs.parallel import CADParallelEnv
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.pipeline import codec as shipped
from cad_env.pipeline.varint import DecodeError
from cad_env.types import FRAMES, MAX_TRACKS, Graph

SEED = 5
RADIOS = {
    "ideal": {"radio": "ideal"},
    "dsrc": {"radio": "dsrc"},
    "lossy": {"radio": {"loss": 0.4, "delay": 0.2, "burst": 3.0}},
    "tight": {"radio": {"rate": 8 * 10 * 150.0}},
    "none": {"radio": "none"},
    "shallow": {"radio": "dsrc", "depth": 3},
}


def everything(graph: Graph) -> Graph:
    """Shares all that is known."""
    return graph


def nothing(graph: Graph) -> None:
    """Shares nothing."""


def own_body(graph: Graph) -> Graph:
    """Shares where the sender itself is."""
    return replace(graph, track=graph.track[:1], position=graph.position[:1], mask=graph.mask[:1], kind=graph.kind[:1])


class Wrapped:
    """The project's own format, by way of Python."""

    def encode(self, graph: Graph) -> bytes:
        return shipped.encode(graph)

    def decode(self, payload: bytes) -> Graph:
        return shipped.decode(payload)


class Json:
    """Text in place of the project's own format."""

    def encode(self, graph: Graph) -> bytes:
        nodes = [[round(float(x), 2) for x in p] for p in graph.position[graph.mask]]
        return json.dumps(
            [
                graph.sender,
                graph.time,
                graph.track.tolist(),
                graph.kind.tolist(),
                graph.mask.astype(int).tolist(),
                nodes,
            ]
        ).encode()

    def decode(self, payload: bytes) -> Graph:
        sender, time, track, kind, mask, nodes = json.loads(payload)
        there = np.array(mask, np.bool_).reshape(-1, FRAMES)
        position = np.zeros((*there.shape, 3))
        position[there] = nodes
        return Graph(sender, time, np.array(track, np.int64), position, there, np.array(kind, np.int8))


class Liar(Wrapped):
    """Claims to be another vehicle."""

    def encode(self, graph: Graph) -> bytes:
        return shipped.encode(replace(graph, sender=graph.sender + 1))


class Broken(Wrapped):
    """Cannot read what it writes."""

    def decode(self, payload: bytes) -> Graph:
        raise DecodeError("no")


def crowd(tracks: int) -> Graph:
    """A graph with so many tracks."""
    shape = (tracks, FRAMES)
    return Graph(0, 0.0, np.arange(tracks), np.zeros((*shape, 3)), np.ones(shape, np.bool_), np.zeros(tracks, np.int8))


class Vague(Wrapped):
    """Decodes to nothing at all."""

    def decode(self, payload: bytes) -> Graph:
        return None  # type: ignore[return-value]


def episode(steps: int = 40, seed: int = SEED, **options: Any) -> list[Any]:
    """Observations and infos of one episode in which the ego brakes now and then."""
    env = CADEnv(scenario="left_turn", **options)
    found = [env.reset(seed=seed)]
    rng = np.random.default_rng(0)
    for _ in range(steps):
        observation, reward, *_, info = env.step(int(rng.random() < 0.3))
        found.append((observation, info, reward))
        if info["outcome"] is not None:
            break
    return found


def same(one: list[Any], other: list[Any], names: tuple[str, ...] = ()) -> bool:
    """Whether two episodes are equal to the last bit; of infos only some `names`, if there are any."""

    def facts(info: dict[str, Any]) -> list[Any]:
        return [repr(info[name]) for name in names or info]

    return len(one) == len(other) and all(
        all(np.array_equal(a[0][key], b[0][key]) for key in a[0]) and facts(a[1]) == facts(b[1])
        for a, b in zip(one, other, strict=True)
    )


@pytest.mark.parametrize("radio", RADIOS)
@pytest.mark.parametrize("rules", [{"share": everything}, {"codec": Wrapped()}], ids=["share", "codec"])
def test_sharing_all_is_the_compiled_path_to_the_last_bit(radio: str, rules: dict[str, Any]) -> None:
    assert same(episode(**RADIOS[radio]), episode(**RADIOS[radio], **rules))


def test_the_budget_counts_what_is_sent() -> None:
    assert {info["refused"] for _, info, *_ in episode(**RADIOS["tight"], share=everything)} >= {
        None, "over the byte budget of its slot"
    }  # fmt: skip
    own = episode(radio="dsrc", share=own_body)[20][1]
    whole = episode(radio="dsrc")[20][1]
    assert own["messages_sent"] == whole["messages_sent"] > 0
    assert 0 < own["bytes_sent"] < 0.5 * whole["bytes_sent"]


def test_who_is_silent_sends_nothing_and_is_not_refused() -> None:
    silent, alone = episode(radio="dsrc", share=nothing), episode(radio="none")
    assert same(silent, alone, ("speed", "outcome", "min_ttc", "bytes_sent", "bytes_received", "messages_sent"))
    assert {info["refused"] for _, info, *_ in silent} == {None}


def test_a_codec_changes_bytes_and_not_what_is_known() -> None:
    text, own = episode(radio="ideal", codec=Json()), episode(radio="ideal")
    assert text[20][1]["bytes_sent"] > 2 * own[20][1]["bytes_sent"]
    assert all(np.allclose(a[0]["tracks"], b[0]["tracks"], atol=0.006) for a, b in zip(text, own, strict=True))
    assert episode(radio="dsrc", codec=Json())[20][1]["bytes_sent"] == text[20][1]["bytes_sent"]


@pytest.mark.parametrize("codec", [Liar(), Broken()])
def test_a_message_that_cannot_be_used_is_not_received(codec: Any) -> None:
    seen = episode(radio="ideal", codec=codec)
    assert {info["bytes_received"] for _, info, *_ in seen} == {0}
    assert same(seen, episode(radio="none"), ("speed", "outcome", "bytes_received"))


def test_share_cannot_change_what_its_sender_knows() -> None:
    def spoil(graph: Graph) -> None:
        graph.position[:], graph.mask[:] = 0.0, False

    assert same(episode(radio="ideal", share=spoil), episode(radio="none"), ("speed", "outcome"))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda graph: replace(graph, track=graph.track * 0), "track ids must be unique"),
        (lambda graph: replace(graph, position=graph.position * np.nan), "coordinate in m"),
        (lambda graph: replace(graph, mask=graph.mask[:, :3]), "have the shapes"),
        (lambda graph: replace(graph, position=graph.position[0, 0]), "have the shapes"),
        (
            lambda graph: replace(graph, position=None),
            r"position of a graph must be an array of m \(K, T, 3\), got None",
        ),
        (lambda graph: replace(graph, track=graph.track + 0.5), "track of a graph must be an array of whole numbers"),
        (lambda graph: replace(graph, kind=graph.kind.tolist()), "kind of a graph must be an array .*, got list"),
        (lambda graph: replace(graph, mask=graph.mask * 1.0), "mask of a graph must be an array of bools"),
        (lambda graph: replace(graph, kind=graph.kind + 2), "kind must be from 0 to 1"),
        (lambda graph: crowd(MAX_TRACKS + 1), "at most 32 tracks, got 33"),
    ],
)
def test_what_is_no_graph_is_refused_in_one_line(wrong: Callable[[Graph], Graph], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        episode(radio="ideal", share=wrong)


def test_anything_but_a_graph_or_bytes_is_refused() -> None:
    with pytest.raises(TypeError, match="share must return a Graph or None, got int"):
        episode(radio="ideal", share=lambda graph: 3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="codec must decode to a Graph, got NoneType"):
        episode(radio="ideal", codec=Vague())
    with pytest.raises(ValueError, match="share must be None or a function"):
        CADEnv(share="all")
    with pytest.raises(ValueError, match="codec must be None or have encode and decode"):
        CADEnv(codec=object())
    with pytest.raises(ValueError, match="share and codec are for graphs"):
        CADEnv(share=everything, cloud={})


def test_side_by_side_and_for_all_agents_it_is_as_alone() -> None:
    envs, alone = CADVectorEnv(2, radio="dsrc", share=own_body), CADVectorEnv(2, radio="dsrc")
    for each in (envs, alone):
        each.reset(seed=SEED)
    for _ in range(10):
        seen, *_, infos = envs.step(np.zeros(2, np.int64))
        alone.step(np.zeros(2, np.int64))
    single = episode(radio="dsrc", share=own_body, steps=0)
    assert len(single) == 1
    env = CADEnv(radio="dsrc", share=own_body)
    env.reset(seed=SEED)
    for _ in range(10):
        observation, *_, info = env.step(0)
    assert all(np.array_equal(observation[name], seen[name][0]) for name in observation)
    assert info["bytes_sent"] == infos["bytes_sent"][0] > 0
    agents = {rules: CADParallelEnv(radio="ideal", share=rules) for rules in (None, everything, own_body)}
    last: dict[Any, Any] = {}
    for rules, fleet in agents.items():
        fleet.reset(seed=SEED)
        for _ in range(10):
            last[rules] = fleet.step(dict.fromkeys(fleet.agents, 0))
    for agent in last[None][0]:
        assert all(np.array_equal(last[None][0][agent][k], last[everything][0][agent][k]) for k in last[None][0][agent])
    assert sum(i["bytes_received"] for i in last[own_body][4].values()) < sum(
        i["bytes_received"] for i in last[everything][4].values()
    )


def test_a_copy_in_the_middle_goes_on_as_the_original() -> None:
    env = CADEnv(radio={"delay": 0.2}, share=own_body)
    env.reset(seed=SEED)
    for _ in range(5):
        env.step(0)
    twin = copy.deepcopy(env)
    for _ in range(5):
        one, other = env.step(0), twin.step(0)
        assert all(np.array_equal(one[0][name], other[0][name]) for name in one[0])
        assert one[4]["bytes_received"] == other[4]["bytes_received"]


def test_it_goes_to_other_processes() -> None:
    here = CADEnv(radio={"delay": 0.1}, share=own_body, codec=Wrapped()).simulation
    here.start(SEED)
    there = pickle.loads(pickle.dumps(here))
    for _ in range(5):
        for each in (here, there):
            each.step(np.zeros(len(each.agents), np.int64))
    one, other = here.observation(0), there.observation(0)
    assert all(np.array_equal(one[name], other[name]) for name in one)
    assert here.info()["bytes_received"] == there.info()["bytes_received"] > 0


def test_the_names_are_public() -> None:
    assert cad_env.Graph is Graph
    assert cad_env.DecodeError is DecodeError
