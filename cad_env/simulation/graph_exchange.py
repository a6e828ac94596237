"""The exchange of graphs by rules from outside: who sends what (`share`), and how it becomes bytes (`codec`).

It takes the place of the compiled sending and receiving, under the same budget, losses, delay and range:

    own graph -> share -> encode -> radio -> decode -> kept of its sender -> merge -> observe

Messages are lost exactly as those of the compiled path: the random draws are functions of the step, the sender and the
receiver.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from cad_env.pipeline import codec as shipped
from cad_env.pipeline.codec import check_graph
from cad_env.pipeline.graph_arrays import as_graph, empty_graph_arrays, graph_arrays
from cad_env.pipeline.merge import receive
from cad_env.pipeline.radio import ACCEPTED, LOST, NOT_SENT, REACHES, SILENT, Link, fate_at, is_as_sent, refusal
from cad_env.pipeline.step import RADIO
from cad_env.pipeline.varint import DecodeError
from cad_env.simulation.scene_step import SceneState
from cad_env.types import FRAMES, MAX_TRACKS, STEP, Graph, GraphArrays, Ints
from cad_env.world.state import indices_on_map

ShareRule = Callable[[Graph], Graph | None]
Header = tuple[int, int, int]  # sender, time in ms, frames
NO_HEADER: Header = (0, 0, 0)


@runtime_checkable
class GraphCodec(Protocol):
    """How a graph becomes the bytes that are sent, and bytes a graph again."""

    def encode(self, graph: Graph) -> bytes:
        """The message; its length is what the budget counts."""

    def decode(self, payload: bytes) -> Graph:
        """The graph of a message, FRAMES frames wide; raises DecodeError only."""


class GraphExchange:
    """The graphs of one episode that are under way. Without a codec the project's own message format is used."""

    def __init__(self, share: ShareRule | None, codec: GraphCodec | None, link: Link, depth: int) -> None:
        self.link, self.depth = link, depth
        self._share, self._codec = share, codec

    def start(self, scene: SceneState) -> None:
        """Begin an episode: nothing is under way."""
        self._scene = scene
        self._sent: dict[int, tuple[np.ndarray, list[bytes | None]]] = {}  # step -> places (V, 2) m, messages
        self._injected: dict[int, bytes] = {}  # by sender, for the next step

    def inject(self, sender: int, payload: bytes) -> None:
        """Let a vehicle broadcast these bytes in the next step, in place of what it would send."""
        self._injected[sender] = payload

    def move_to(self, scene: SceneState) -> None:
        """Go on with equal arrays that are elsewhere."""
        self._scene = scene

    @property
    def step(self) -> int:
        """Decisions since the start."""
        return int(self._scene.clock[0])

    def exchange(self) -> None:
        """Send what every vehicle wants to send, and give the receivers what arrives in this step."""
        self._send()
        self._receive()

    def arrival(self, sender: int, receiver: int) -> tuple[int, int]:
        """What becomes, in this step, of a sender's message at a receiver (see `radio.fate`), and its bytes."""
        sent_at = self.step - self.link.delay
        places, messages = self._sent.get(sent_at, (None, []))
        message = messages[sender] if messages and sender != receiver else None
        if places is None or message is None:
            return NOT_SENT, 0
        if receiver not in self._receivers():
            return NOT_SENT, 0
        dx, dy = (places[receiver] - places[sender]).tolist()
        key: Ints = self._scene.keys[RADIO]
        return int(fate_at(self.link, key, math.hypot(dx, dy), sent_at, sender, receiver, 0)), len(message)

    def _send(self) -> None:
        fleet, step = self._scene.fleet, self.step
        messages: list[bytes | None] = []
        there = set(indices_on_map(self._scene.world, fleet.rows))  # who is gone is silent
        for v in range(len(fleet.rows)):
            message = self._message(v) if v in there else None
            size = 0 if message is None else len(message)
            reason = SILENT if message is None else int(refusal(self.link.budget, 0, size))
            fleet.report.refusal[v], fleet.report.sent_bytes[v] = reason, size if reason == ACCEPTED else 0
            messages.append(message if reason == ACCEPTED else None)
        self._injected.clear()
        self._sent = {at: what for at, what in self._sent.items() if step - self.link.delay <= at < step}
        self._sent[step] = (self._scene.world.position[fleet.rows].copy(), messages)

    def _message(self, v: int) -> bytes | None:
        """What vehicle v, which is on the map, wants to send now; None for nothing."""
        if v in self._injected or self.link.budget <= 0.0:  # without a budget all is refused: spare the writing
            return self._injected.get(v, b"")
        graph = newest(as_graph(_of(self._scene.fleet.window, v), v, STEP * self.step), self.depth)
        if self._share is not None:
            chosen = self._share(graph)
            if chosen is None:
                return None
            graph = self._checked(chosen, v)
        if self._codec is None:
            return shipped.encode(graph, self.depth)
        message = self._codec.encode(graph)
        if not isinstance(message, bytes):
            raise TypeError(f"codec must encode to bytes, got {type(message).__name__}")
        return message

    def _checked(self, graph: Graph, v: int) -> Graph:
        """What `share` has chosen, from vehicle v now; ValueError for what is not a graph that can be sent."""
        if not isinstance(graph, Graph):
            raise TypeError(f"share must return a Graph or None, got {type(graph).__name__}")
        check_arrays(graph)
        if len(graph.track) > MAX_TRACKS:
            raise ValueError(f"share must return at most {MAX_TRACKS} tracks, got {len(graph.track)}")
        graph = replace(graph, sender=v, time=STEP * self.step)
        check_graph(graph)
        return newest(graph, self.depth)

    def _receive(self) -> None:
        report, step = self._scene.fleet.report, self.step
        report.received_bytes[:], report.lost[:], report.messages_refused[:] = 0, 0, 0
        _, messages = self._sent.get(step - self.link.delay, (None, []))
        for sender, message in enumerate(messages):
            if message is None:
                continue
            reached = []
            for receiver in self._receivers():
                end, _ = self.arrival(sender, receiver)
                report.lost[receiver] += end == LOST
                if end == REACHES:
                    reached.append(receiver)
            self._hand_out(message, sender, reached)

    def _hand_out(self, message: bytes, sender: int, reached: Sequence[int]) -> None:
        """Give a message to those it reaches; each of them refuses it whole if it cannot be used."""
        report, kept = self._scene.fleet.report, self._scene.fleet.kept
        found = self._decoded(message, sender) if reached else None
        for receiver in reached:
            if found is None:
                report.messages_refused[receiver] += 1
            else:
                report.received_bytes[receiver] += len(message)
                receive(_of(_of(kept, receiver), sender), *found, self.link.delay)

    def _receivers(self) -> list[int]:
        """Who merges what arrives: of the first connected vehicles, those that have not left the map."""
        fleet = self._scene.fleet
        return indices_on_map(self._scene.world, fleet.rows[: len(fleet.report.lost)])

    def _decoded(self, message: bytes, sender: int) -> tuple[GraphArrays, int] | None:
        """The graph of a message and how many frames it holds, or None if it cannot be used."""
        header, arrays = self._read(message) if self._codec is None else self._decoded_outside(self._codec, message)
        if arrays is None or not is_as_sent(header[0], header[1], sender, self.step - self.link.delay):
            return None
        return arrays, header[2]

    def _read(self, message: bytes) -> tuple[Header, GraphArrays | None]:
        """As the compiled path reads it."""
        header, arrays = np.zeros(3, np.int64), empty_graph_arrays()
        if shipped.read(np.array(bytearray(message), np.uint8), len(message), header, arrays) != shipped.DECODED:
            return NO_HEADER, None
        sender, time_ms, depth = header.tolist()
        return (sender, time_ms, depth), arrays

    def _decoded_outside(self, codec: GraphCodec, message: bytes) -> tuple[Header, GraphArrays | None]:
        """What a codec from outside makes of it, and nothing that cannot be a graph."""
        try:
            graph = codec.decode(message)
            if not isinstance(graph, Graph):
                raise TypeError(f"codec must decode to a Graph, got {type(graph).__name__}")
            check_arrays(graph)
            check_graph(graph)
        except (DecodeError, ValueError):
            return NO_HEADER, None
        if len(graph.track) > MAX_TRACKS:
            return NO_HEADER, None
        return (graph.sender, round(1000.0 * graph.time), self.depth), graph_arrays(graph)


def check_arrays(graph: Graph) -> None:
    """Refuse what is not an array of the right kind of numbers with a one-line ValueError that names it."""
    for name, kinds, what in (
        ("track", "iu", "whole numbers (K,)"), ("position", "f", "m (K, T, 3)"), ("mask", "b", "bools (K, T)"),
        ("kind", "iu", "whole numbers (K,)"),
    ):  # fmt: skip
        part = getattr(graph, name)
        if not isinstance(part, np.ndarray) or part.ndim == 0 or part.dtype.kind not in kinds:
            found = f"{part.dtype} {part.shape}" if isinstance(part, np.ndarray) else type(part).__name__
            raise ValueError(f"{name} of a graph must be an array of {what}, got {found}")


def newest(graph: Graph, depth: int) -> Graph:
    """A copy with only the newest `depth` frames; tracks without a node in them are left out."""
    mask = graph.mask.copy()
    mask[:, : FRAMES - depth] = False
    kept = mask.any(axis=1)
    return replace(
        graph, track=graph.track[kept], position=graph.position[kept], mask=mask[kept], kind=graph.kind[kept]
    )


def _of(stack: GraphArrays, index: int) -> GraphArrays:
    return GraphArrays(*(part[index] for part in stack))
