"""A scene under way as one record, and the compiled loops that move one such scene or a thousand.

Every environment steps its scenes by `play`. It gets a typed list of records: each
scene has its own numbers of vehicles, and a call from Python costs 2 us however many arrays the records hold.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import typeof
from numba.typed import List

from cad_env.borrowing import borrowed, lend
from cad_env.cloud import CloudConfig, CloudView, empty_cloud_view
from cad_env.compiled import compiled, inlined
from cad_env.pipeline.observe import View, empty_view
from cad_env.pipeline.radio import ACCEPTED, Link
from cad_env.pipeline.sense import Sensing
from cad_env.pipeline.step import Fleet, Report, run
from cad_env.types import Floats, Ints
from cad_env.world.clearance import time_to_contact
from cad_env.world.state import Routes, World
from cad_env.world.step import advance

MAX_STEPS = 300  # decisions: 30 s
# How it stands for a vehicle, as compiled code knows it, and the reward that comes with it.
UNDER_WAY, SUCCEEDED, COLLIDED, TIMED_OUT = 0, 1, 2, 3
FINAL_REWARDS = (0.0, 1.0, -1.0, 0.0)


class Told(NamedTuple):
    """What the newest step came to, for the ego: the numbers of info dicts. Of many scenes (S,), of one (1,)."""

    outcome: Ints  # int8
    reward: Floats  # the share of its way that it covered, and the final one
    progress: Floats  # m along its route
    speed: Floats  # m/s
    min_ttc: Floats  # s, least time to contact so far
    bytes_sent: Ints  # by all connected vehicles, as what follows
    bytes_received: Ints  # by the ego
    largest_message: Ints  # bytes
    messages_sent: Ints
    messages_lost: Ints  # on their way to the ego
    refused: Ints  # why the first message that was refused was, 0 if none was


class LiveScene(NamedTuple):
    """V connected vehicles among N, of which the first R merge, observe and decide."""

    world: World
    routes: Routes
    fleet: Fleet
    sensor: Sensing
    link: Link
    depth: int  # newest frames in a message
    keys: Ints  # (2, 2) uint64 of the streams of chance
    clock: Ints  # (1,) decisions so far
    actions: Ints  # (V,) GO or BRAKE
    goal: float  # m along its route, where the ego has arrived
    way: float  # m from its start to there
    told: Told
    scratch: Floats  # (N,)


class Board:
    """Room for so many scenes, and the arrays over all of them that the compiled loops fill."""

    def __init__(self, places: int, cloud: CloudConfig | None = None) -> None:
        self.told = Told(
            np.zeros(places, np.int8), *(np.zeros(places) for _ in range(4)),
            *(np.zeros(places, np.int64) for _ in range(6)),
        )  # fmt: skip
        self.views: View = empty_view(places, 1)  # what each ego decides on
        self.clouds: CloudView | None = None if cloud is None else empty_cloud_view(cloud, places)
        self.rooms: list[Floats] = []  # scratch: for clouds before they are encoded
        self._owners: dict[int, LiveScene] = {}  # of the arrays that the list below borrows
        self.scenes: Any = None  # the typed list, once there is a record to tell its type

    def told_at(self, place: int) -> Told:
        """The part of the scene at `place`."""
        return Told(*(part[place : place + 1] for part in self.told))

    def views_at(self, place: int) -> View:
        """The part of the scene at `place`, (1, ...)."""
        return View(*(part[place] for part in self.views))

    def clouds_at(self, place: int) -> CloudView | None:
        """The part of the scene at `place`, without a leading dimension; None where graphs are shared."""
        return self.clouds and CloudView(*(part[place] for part in self.clouds))

    def put(self, place: int, scene: LiveScene) -> None:
        """Let a new scene take a place."""
        if self.scenes is None:
            self.scenes = lend(_no_scenes(typeof(scene)), self._owners)
        _put(self.scenes, place, scene)
        self._owners[place] = scene


@compiled
def _no_scenes(kind: Any) -> Any:
    return List.empty_list(kind)


@compiled
def _put(scenes: Any, place: int, scene: LiveScene) -> None:
    while len(scenes) <= place:
        scenes.append(borrowed(scene))
    scenes[place] = borrowed(scene)


@compiled
def play(scenes: Any, which: Ints, actions: Ints, moves: bool) -> None:
    """One decision in the scenes `which` (n,), whose egos decide `actions` (n,): 0.1 s passes, and everybody perceives.

    Without `moves` no time passes: everybody perceives what there is.
    """
    for k in range(which.shape[0]):
        scene = scenes[which[k]]
        if moves:
            scene.actions[0] = actions[k]
            advance(scene.world, scene.routes, scene.fleet.rows, scene.actions, scene.scratch)
            scene.clock[0] += 1
        run(
            scene.world, scene.routes, scene.fleet, scene.sensor, scene.link, scene.depth, scene.keys, scene.clock[0]
        )  # fmt: skip
        tell(scene)


@compiled
def verdict(struck: bool, arrived: bool, over: bool) -> int:
    """How it ended for a vehicle: struck or not, at its goal or not, its time up or not."""
    if struck:
        return COLLIDED
    if arrived:
        return SUCCEEDED
    return TIMED_OUT if over else UNDER_WAY


@inlined
def tell(scene: LiveScene) -> None:
    """Write down what the newest step came to."""
    world, told, air = scene.world, scene.told, scene.fleet.report
    outcome = verdict(world.struck[0] >= 0, world.progress[0] >= scene.goal, scene.clock[0] >= MAX_STEPS)
    told.outcome[0], told.speed[0] = outcome, world.speed[0]
    told.reward[0] = (world.progress[0] - told.progress[0]) / scene.way + FINAL_REWARDS[outcome]
    told.progress[0] = world.progress[0]
    told.min_ttc[0] = min(told.min_ttc[0], time_to_contact(world, 0))
    tell_air(told, air)


@inlined
def tell_air(told: Told, air: Report) -> None:
    """Write down what the newest step put on the air."""
    told.bytes_sent[0] = told.largest_message[0] = told.messages_sent[0] = told.refused[0] = 0
    for v in range(air.sent_bytes.shape[0]):
        told.bytes_sent[0] += air.sent_bytes[v]
        told.largest_message[0] = max(told.largest_message[0], air.sent_bytes[v])
        told.messages_sent[0] += air.refusal[v] == ACCEPTED
        if told.refused[0] == ACCEPTED:
            told.refused[0] = air.refusal[v]
    told.bytes_received[0], told.messages_lost[0] = air.received_bytes[0], air.lost[0]
