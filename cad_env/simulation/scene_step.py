"""A scene under way as one record, and the compiled loops that move one such scene or a thousand.

Every environment steps its scenes by `play`. It takes them from a record array (`BatchState.records`), where each has
its own number of vehicles, and a call from Python costs next to nothing however many arrays a scene has.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numba import typeof

from cad_env.config import RadioConfig, SensorConfig
from cad_env.lidar.config import CloudConfig, CloudView, empty_cloud_view
from cad_env.numerics.jit import compiled, inlined, inlined_part
from cad_env.numerics.record_array import CopiedWhole, new_record_array, put, take
from cad_env.pipeline.fleet import Fleet, Report, new_fleet
from cad_env.pipeline.observe import View, empty_view
from cad_env.pipeline.observe_lanes import LaneView, empty_lane_view
from cad_env.pipeline.radio import ACCEPTED, SILENT, Link, link_of
from cad_env.pipeline.sense import Sensing, sensing
from cad_env.pipeline.step import merge_all, run
from cad_env.types import COLLISION, COMMANDS, FRAMES, MAX_STEPS, SUCCESS, TIMEOUT, Bytes, Floats, Ints
from cad_env.world.lanes import Lanes, empty_lanes
from cad_env.world.state import Routes, Truth, World, empty_routes, empty_world
from cad_env.world.step import advance, struck_from_behind
from cad_env.world.time_to_contact import time_to_contact

# How it stands for a vehicle, as compiled code knows it, and the reward that comes with it.
UNDER_WAY, SUCCEEDED, COLLIDED, TIMED_OUT = 0, 1, 2, 3
OUTCOME_BY_CODE = (None, SUCCESS, COLLISION, TIMEOUT)
FINAL_REWARDS = (0.0, 1.0, -1.0, 0.0)


class StepInfo(NamedTuple):
    """What the newest step came to, for the ego: the numbers of info dicts. Of many scenes (S,), of one (1,)."""

    outcome: Ints  # int8
    reward: Floats  # the share of its way that it covered, and the final one
    progress: Floats  # m along its route
    speed: Floats  # m/s
    min_ttc: Floats  # s, least time to contact so far
    struck_from_behind: Ints  # 1 once somebody who follows the ego has hit it
    bytes_sent: Ints  # by all connected vehicles, as what follows
    bytes_received: Ints  # by the ego
    largest_message: Ints  # bytes
    messages_sent: Ints
    messages_lost: Ints  # on their way to the ego
    messages_refused: Ints  # by the ego, whole, of those that reached it
    refused: Ints  # why the first message that was refused was, 0 if none was


class SceneState(NamedTuple):
    """V connected vehicles among N, of which the first R merge, observe and decide."""

    world: World
    routes: Routes
    lanes: Lanes  # none where coverage is not shared
    fleet: Fleet
    sensor: Sensing
    link: Link
    depth: int  # newest frames in a message
    keys: Ints  # (3, 2) uint64 of the streams of chance
    clock: Ints  # (1,) decisions so far
    actions: Ints  # (V,) GO or BRAKE
    goal: float  # m along its route, where the ego has arrived
    way: float  # m from its start to there
    step_info: StepInfo
    scratch: Floats  # (N,)


class BatchState(CopiedWhole):
    """Room for so many scenes, and the arrays over all of them that the compiled loops fill.

    A copy, or what comes out of a pickle, has scenes of its own.
    """

    def __init__(
        self, places: int, cloud: CloudConfig | None = None, commands: int = COMMANDS, coverage: bool = False
    ) -> None:
        self.step_info = _no_step_info(places)
        self.views: View = empty_view(places, 1, commands=commands)  # what each ego decides on
        self.coverage = coverage  # whether the views below are shown
        self.lane_views: LaneView = empty_lane_view(places, 1)
        self.clouds: CloudView | None = None if cloud is None else empty_cloud_view(cloud, places)
        self.rooms: list[Bytes] = []  # scratch: for clouds before they are encoded
        self._scenes: dict[int, SceneState] = {}  # whose arrays the records borrow
        self.records: Any = new_record_array(KIND, places, self._scenes)

    def step_info_at(self, place: int) -> StepInfo:
        """The part of the scene at `place`."""
        return StepInfo(*(part[place : place + 1] for part in self.step_info))

    def views_at(self, place: int) -> View:
        """The part of the scene at `place`, (1, ...)."""
        return View(*(part[place] for part in self.views))

    def lane_views_at(self, place: int) -> LaneView:
        """The part of the scene at `place`, (1, ...)."""
        return LaneView(*(part[place] for part in self.lane_views))

    def clouds_at(self, place: int) -> CloudView | None:
        """The part of the scene at `place`, without a leading dimension; None where graphs are shared."""
        return self.clouds and CloudView(*(part[place] for part in self.clouds))

    def truth_at(self, place: int) -> Truth:
        """What the ego of the scene at `place` would know if it saw everything."""
        self.check_begun(place)
        scene = self._scenes[place]
        return Truth(scene.world, scene.routes, int(scene.fleet.rows[0]))

    def put(self, place: int, scene: SceneState) -> None:
        """Let a new scene take a place."""
        _put(self.records, place, scene)
        self._scenes[place] = scene

    def scene(self, place: int) -> SceneState | None:
        """The scene that has taken a place, if one has."""
        return self._scenes.get(place)

    def check_begun(self, place: int) -> None:
        """Refuse to go on where nothing has begun: there, compiled code would take zeros for addresses."""
        if place not in self._scenes:
            raise gym.error.ResetNeeded(f"no episode has begun in scene {place}: start or reset it first")

    def __getstate__(self) -> dict[str, Any]:
        """All but the addresses of the arrays, and scratch."""
        kept = {name: value for name, value in self.__dict__.items() if name not in ("records", "rooms")}
        shown = [k for k, scene in self._scenes.items() if np.shares_memory(scene.fleet.views.ego, self.views.ego)]
        return {**kept, "shown": shown}

    def __setstate__(self, state: dict[str, Any]) -> None:
        shown, scenes = state.pop("shown"), state.pop("_scenes")
        self.__dict__.update(state)
        self.rooms, self._scenes = [], {}
        self.records = new_record_array(KIND, len(self.step_info.outcome), self._scenes)
        for place, scene in scenes.items():
            # A part of an array over all scenes is copied as an array by itself: it becomes a part again.
            fleet = scene.fleet
            if place in shown:
                fleet = fleet._replace(views=self.views_at(place), lane_views=self.lane_views_at(place))
            self.put(place, scene._replace(fleet=fleet, step_info=self.step_info_at(place)))


def _no_step_info(scenes: int) -> StepInfo:
    numbers = (np.zeros(scenes) for _ in range(4))
    return StepInfo(np.zeros(scenes, np.int8), *numbers, *(np.zeros(scenes, np.int64) for _ in range(8)))


def _kind() -> Any:
    """The type of every scene record, taken from an empty one."""
    link = link_of(RadioConfig())
    return typeof(
        SceneState(
            world=empty_world(0),
            routes=empty_routes(),
            lanes=empty_lanes(),
            fleet=new_fleet(np.zeros(1, np.int64), 0, 1, link),
            sensor=sensing(SensorConfig()),
            link=link,
            depth=FRAMES,
            keys=np.zeros((3, 2), np.uint64),
            clock=np.zeros(1, np.int64),
            actions=np.zeros(1, np.int64),
            goal=0.0,
            way=0.0,
            step_info=_no_step_info(1),
            scratch=np.zeros(0),
        )
    )


KIND = _kind()


@compiled
def _put(records: Any, place: int, scene: SceneState) -> None:
    put(records, place, KIND, scene)


@inlined_part
def scene_at(records: Any, place: int) -> SceneState:
    """The scene at a place of a record array, borrowed, for compiled loops."""
    scene: SceneState = take(records, place, KIND)
    return scene


@compiled
def play(records: Any, which: Ints, actions: Ints, moves: bool) -> None:
    """One decision in the scenes `which` (n,), whose egos decide `actions` (n,): 0.1 s passes, and everybody perceives.

    Without `moves` no time passes: everybody perceives what there is.
    """
    for k in range(which.shape[0]):
        scene = scene_at(records, which[k])
        if moves:
            scene.actions[0] = actions[k]
            advance(scene.world, scene.routes, scene.fleet.rows, scene.actions, scene.scratch)
            scene.clock[0] += 1
        run(
            scene.world, scene.routes, scene.lanes, scene.fleet, scene.sensor, scene.link, scene.depth, scene.keys,
            scene.clock[0],
        )  # fmt: skip
        write_step_info(scene)


@compiled
def play_exchanged(records: Any, place: int) -> None:
    """Merge, observe and write down anew in one scene: messages were exchanged since `play`."""
    scene = scene_at(records, place)
    merge_all(scene.world, scene.routes, scene.lanes, scene.fleet, scene.clock[0])
    write_radio_info(scene.step_info, scene.fleet.report)


@compiled
def verdict(struck: bool, arrived: bool, over: bool) -> int:
    """How it ended for a vehicle: struck or not, at its goal or not, its time up or not."""
    if struck:
        return COLLIDED
    if arrived:
        return SUCCEEDED
    return TIMED_OUT if over else UNDER_WAY


@inlined_part
def write_step_info(scene: SceneState) -> None:
    """Write down what the newest step came to."""
    world, step_info, air = scene.world, scene.step_info, scene.fleet.report
    outcome = verdict(world.struck[0] >= 0, world.progress[0] >= scene.goal, scene.clock[0] >= MAX_STEPS)
    step_info.outcome[0], step_info.speed[0] = outcome, world.speed[0]
    step_info.reward[0] = (world.progress[0] - step_info.progress[0]) / scene.way + FINAL_REWARDS[outcome]
    step_info.progress[0] = world.progress[0]
    step_info.min_ttc[0] = min(step_info.min_ttc[0], time_to_contact(world, 0))
    step_info.struck_from_behind[0] = struck_from_behind(world, 0)
    write_radio_info(step_info, air)


@inlined
def write_radio_info(step_info: StepInfo, air: Report) -> None:
    """Write down what the newest step put on the air."""
    step_info.bytes_sent[0] = step_info.largest_message[0] = step_info.messages_sent[0] = step_info.refused[0] = 0
    for v in range(air.sent_bytes.shape[0]):
        step_info.bytes_sent[0] += air.sent_bytes[v]
        step_info.largest_message[0] = max(step_info.largest_message[0], air.sent_bytes[v])
        step_info.messages_sent[0] += air.refusal[v] == ACCEPTED
        if step_info.refused[0] == ACCEPTED and air.refusal[v] != SILENT:
            step_info.refused[0] = air.refusal[v]
    step_info.bytes_received[0], step_info.messages_lost[0] = air.received_bytes[0], air.lost[0]
    step_info.messages_refused[0] = air.messages_refused[0]


@dataclass(frozen=True)
class Truths:
    """What a privileged policy that decides in batches is given: the worlds of some scenes of a batch."""

    batch_state: BatchState
    which: Ints  # (n,)

    def each(self) -> Iterator[Truth]:
        """The truth of one scene after another, for rules that are not compiled."""
        for place in self.which.tolist():
            yield self.batch_state.truth_at(place)
