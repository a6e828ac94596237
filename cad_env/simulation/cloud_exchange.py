"""The exchange of points: what every connected vehicle casts goes through a codec, over the radio, and to the ego.

It takes the place of sending graphs, after the compiled step has moved the world and filled in everybody's fixes:

    cast -> encode -> envelope -> radio -> envelope opened -> decode -> merge -> observe

A message that does not arrive is not made up for: its sender's points are absent in that step (single-frame sharing).
The radio keeps to the rules, and to the chance, of `pipeline.radio`: what would be lost of graphs is lost of points.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cad_env.lidar.cast import TOO_FAR, Rays, cast, cast_centimetres, rays_of
from cad_env.lidar.config import CloudConfig, CloudView, OwnCloud, Selective
from cad_env.lidar.envelope import ENVELOPE_SIZE, Envelope, opened, seal
from cad_env.lidar.points import KEPT, TOO_LARGE, Reads, relative, thinned
from cad_env.numerics.philox import stream_key
from cad_env.pipeline.observe import HORIZON
from cad_env.pipeline.radio import ACCEPTED, LOST, NOT_SENT, REACHES, SILENT, Link, fate_at, is_as_sent, refusal
from cad_env.pipeline.sense import Sensing
from cad_env.pipeline.step import RADIO
from cad_env.pipeline.varint import DecodeError
from cad_env.simulation.scene_step import SceneState, write_radio_info
from cad_env.types import FRAMES, STEP, Bytes, Floats, Ints
from cad_env.world.state import World, indices_on_map

BATCH = 64  # clouds in one call of a codec; a thousand at once would not fit into memory


class Sent(NamedTuple):
    """What V vehicles did in one step."""

    place: Floats  # (V, 2) m, where they were
    message: list[bytes | None]  # what they put on the air, None if it was refused


class Sharing:
    """The clouds of one episode: what is on the air, and what the ego is shown of them."""

    def __init__(self, config: CloudConfig, link: Link, view: CloudView) -> None:
        self.config, self.link, self.view = config, link, view
        self._rays = rays_of(config.azimuths, config.beams)
        self._reads = config.codec.reads if isinstance(config.codec, Selective) else Reads()
        self._thinned: dict[tuple[int, int], Floats] = {}  # by vehicle and most points, in this step

    def start(self, scene: SceneState, seed: int) -> None:
        """Begin an episode: nothing is on the air."""
        self._scene, self._key = scene, stream_key(seed, "cast")
        self._air: dict[int, Sent] = {}  # by step, the newest `delay` + 1
        self._injected: dict[int, bytes] = {}  # by sender, for the next step
        self._thinned.clear()

    def move_to(self, scene: SceneState | None, view: CloudView) -> None:
        """Go on with equal arrays that are elsewhere; None before the first start."""
        self.view = view
        if scene is not None:
            self._scene = scene

    def inject(self, sender: int, payload: bytes) -> None:
        """Let a vehicle broadcast these bytes in the next step, in place of its own message."""
        self._injected[sender] = payload

    @property
    def most_points(self) -> int:
        """Of one cloud."""
        return self.config.azimuths * self.config.beams

    @property
    def step(self) -> int:
        """Decisions since the start."""
        return int(self._scene.clock[0])

    def on_map(self) -> list[int]:
        """The connected vehicles that have not left the map: who has does not sense, send or receive."""
        return indices_on_map(self._scene.world, self._scene.fleet.rows)

    def speakers(self) -> list[int]:
        """Whose clouds are wanted: without a budget nothing goes on the air, and only the ego sees its own."""
        return [v for v in self.on_map() if v == 0 or self.link.budget > 0.0]

    def cloud(self, v: int, room: Floats | None = None, ground: bool = True) -> Floats:
        """(n, 3) m what connected vehicle v's lidar reports now, in its own frame; a part of `room`.

        Nothing is reported where v has left the map.
        """
        if v not in self.on_map():
            return np.empty((0, 3))
        cloud = np.empty((self.most_points, 3)) if room is None else room
        return cloud[: cast(*self._seen_by(v), ground, cloud)]

    def _seen_by(self, v: int) -> tuple[World, Floats, int, Sensing, Ints, int, Rays]:
        """What a cast depends on."""
        scene, row = self._scene, int(self._scene.fleet.rows[v])
        return scene.world, scene.fleet.outlines, row, scene.sensor, self._key, self.step, self._rays

    def forget(self) -> None:
        """Cast anew what is asked for from now on: the world has moved."""
        self._thinned.clear()

    def to_encode(self, v: int, rooms: list[Bytes], k: int) -> Floats | Ints:
        """What the codec reads of vehicle v's cloud now; it may be a part of rooms[k]."""
        if self._reads.thinned:
            return self._few(v, self._reads.thinned, _room(rooms, 0, self.most_points, np.dtype(np.float64)))
        if not self._reads.centimetres:
            return self.cloud(v, _room(rooms, k, self.most_points, np.dtype(np.float64)))
        cloud = _room(rooms, k, self.most_points, np.dtype(np.int16))
        count = cast_centimetres(*self._seen_by(v), cloud)
        if count == TOO_FAR:
            raise ValueError(f"{TOO_LARGE}, which the noise of the sensor exceeds")
        return cloud[:count]

    def _few(self, v: int, most: int, room: Floats | None = None) -> Floats:
        """(n <= most, 3) m vehicle v's cloud, thinned once a step: it is both sent and learned from."""
        if (v, most) not in self._thinned:
            self._thinned[v, most] = thinned(self.cloud(v, room, ground=False), most)
        return self._thinned[v, most]

    def own_clouds(self) -> list[OwnCloud]:
        """What each connected vehicle has for itself, thinned to what a message decodes to, at least to KEPT."""
        trail, most = self._scene.fleet.trail, max(KEPT, self.config.codec.most)
        return [OwnCloud(self._few(v, most).copy(), trail[v, FRAMES - 1].copy()) for v in range(len(trail))]

    def take(self, contents: Mapping[int, bytes]) -> None:
        """One step, given what the codec wrote of every speaker's cloud: send, receive, merge, show and tell."""
        self.send(contents)
        own = self.config.codec.decode(contents[0]) if 0 in contents else np.empty((0, self.view.cloud.shape[1]))
        self.show(own, self.receive())
        write_radio_info(self._scene.step_info, self._scene.fleet.report)

    def send(self, contents: Mapping[int, bytes]) -> None:
        """Put on the air what the codec wrote of every speaker's cloud, as far as the budget goes."""
        fleet, step, there = self._scene.fleet, self.step, self.on_map()
        message: list[bytes | None] = []
        for v in range(len(fleet.rows)):
            foreign, content = self._injected.get(v), contents.get(v, b"")
            size = ENVELOPE_SIZE + len(content) if foreign is None else len(foreign)
            reason = int(refusal(self.link.budget, 0, size)) if v in there else SILENT
            fleet.report.refusal[v], fleet.report.sent_bytes[v] = reason, size if reason == ACCEPTED else 0
            if reason != ACCEPTED:
                message.append(None)
            else:
                message.append(self._sealed(v, content) if foreign is None else foreign)
        self._injected.clear()
        self._air = {sent: what for sent, what in self._air.items() if step - self.link.delay <= sent < step}
        self._air[step] = Sent(self._scene.world.position[fleet.rows], message)

    def _sealed(self, v: int, content: bytes) -> bytes:
        """The message of vehicle v with what the codec wrote of its cloud."""
        x, y, heading = self._scene.fleet.trail[v, FRAMES - 1].tolist()
        return seal(Envelope(v, STEP * self.step, (x, y, heading), content))

    def arrival(self, sender: int, receiver: int) -> tuple[int, int]:
        """What becomes, in this step, of a sender's message at a receiver (see radio.fate), and its bytes."""
        step = self.step - self.link.delay
        sent = self._air.get(step)
        message = None if sent is None or sender == receiver else sent.message[sender]
        if sent is None or message is None or receiver not in self.on_map():
            return NOT_SENT, 0
        dx, dy = (sent.place[receiver] - sent.place[sender]).tolist()
        end = fate_at(self.link, self._scene.keys[RADIO], math.hypot(dx, dy), step, sender, receiver, 0)
        return int(end), len(message)

    def receive(self) -> list[tuple[Floats, tuple[float, float, float]]]:
        """What reaches the ego in this step: points (k, 3 + W) with the fix of their sender, by sender."""
        report, heard = self._scene.fleet.report, []
        report.received_bytes[0] = report.lost[0] = report.messages_refused[0] = 0
        sent = self._air.get(self.step - self.link.delay)
        for sender in range(1, len(self._scene.fleet.rows)):
            end, _ = self.arrival(sender, 0)
            report.lost[0] += end == LOST
            message = sent.message[sender] if sent is not None and end == REACHES else None
            if message is None:
                continue
            understood = self._understood(message, sender)
            if understood is None:
                report.messages_refused[0] += 1
                continue
            report.received_bytes[0] += len(message)
            heard.append(understood)
        return heard

    def _understood(self, message: bytes, sender: int) -> tuple[Floats, tuple[float, float, float]] | None:
        """The points of a message and the fix of its sender, or None if any of it is not acceptable."""
        try:
            said = opened(message)
            points = self.config.codec.decode(said.content)
        except DecodeError:
            return None
        genuine = is_as_sent(said.sender, round(1000.0 * said.time), sender, self.step - self.link.delay)
        return (points, said.pose) if genuine else None

    def show(self, own: Floats, heard: Sequence[tuple[Floats, tuple[float, float, float]]]) -> None:
        """Fill the view: own points first, then the others', placed by the fixes; of too many, every so many."""
        x, y, heading = self._scene.fleet.trail[0, FRAMES - 1].tolist()
        points = np.concatenate([own, *(_placed(cloud, pose, (x, y, heading)) for cloud, pose in heard)])
        points = points[(np.abs(points[:, :3]) <= HORIZON).all(axis=1)]
        shown = min(len(points), self.config.merged)
        chosen = np.arange(shown) * len(points) // max(shown, 1)
        self.view.cloud[:], self.view.cloud_mask[:] = 0.0, 0
        self.view.cloud[:shown] = np.clip(points[chosen], -HORIZON, HORIZON)
        self.view.cloud_mask[:shown] = 1


def exchange(sharings: Sequence[Sharing], rooms: list[Bytes]) -> None:
    """One step's exchange in every one of these episodes; clouds of one codec are encoded together.

    rooms: scratch for the clouds of a batch. It is kept between steps, since the pages of new memory cost as much as
    what is written to them.
    """
    for sharing in sharings:
        sharing.forget()
    speakers = [(sharing, v) for sharing in sharings for v in sharing.speakers()]
    contents = _encoded(speakers, rooms)
    for sharing in sharings:
        sharing.take({v: contents[id(sharing), v] for v in sharing.speakers()})


def _encoded(speakers: Sequence[tuple[Sharing, int]], rooms: list[Bytes]) -> dict[tuple[int, int], bytes]:
    """What the codecs write of the clouds of (episode, vehicle), by them."""
    contents: dict[tuple[int, int], bytes] = {}
    for codec in {id(sharing.config.codec): sharing.config.codec for sharing, _ in speakers}.values():
        ours = [(sharing, v) for sharing, v in speakers if sharing.config.codec is codec]
        for start in range(0, len(ours), BATCH):
            some = ours[start : start + BATCH]
            written = codec.encode([sharing.to_encode(v, rooms, k) for k, (sharing, v) in enumerate(some)])
            contents.update({(id(sharing), v): one for (sharing, v), one in zip(some, written, strict=True)})
    return contents


def _room(rooms: list[Bytes], k: int, points: int, kind: np.dtype[Any]) -> NDArray[Any]:
    """(points, 3) numbers of a kind in rooms[k], which is made larger where it must be."""
    size = 3 * points * kind.itemsize
    rooms.extend(np.empty(0, np.uint8) for _ in range(len(rooms), k + 1))
    if len(rooms[k]) < size:
        rooms[k] = np.empty(size, np.uint8)
    return rooms[k][:size].view(kind).reshape(points, 3)


def _placed(points: Floats, pose: tuple[float, float, float], ego: tuple[float, float, float]) -> Floats:
    """Points (k, 3 + W) in the frame of the vehicle at `pose`, in that of the ego; poses x, y (m), heading (rad)."""
    x, y, turn = relative(pose, ego)
    placed = np.array(points, np.float64)
    placed[:, 0] = points[:, 0] * math.cos(turn) - points[:, 1] * math.sin(turn) + x
    placed[:, 1] = points[:, 0] * math.sin(turn) + points[:, 1] * math.cos(turn) + y
    return placed
