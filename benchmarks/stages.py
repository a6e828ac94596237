"""What each stage of a step costs: the stage's own compiled function in a compiled loop, on live scenes."""

import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from cad_env.pipeline.codec import write
from cad_env.pipeline.graph import add_body, add_track
from cad_env.pipeline.graph_arrays import slide
from cad_env.pipeline.radio import send
from cad_env.pipeline.sense import CENTRE_HEIGHT, fix_pose, outline, sense
from cad_env.pipeline.step import SENSE, _rows_at, _tracks_at, deliver, fuse, show
from cad_env.pipeline.track import confirmed, seen_now, update
from cad_env.simulation.batch import SceneBatch
from cad_env.simulation.scene_step import scene_at, write_step_info
from cad_env.simulation.setup import setup_from
from cad_env.types import FRAMES, STEP
from cad_env.world.step import advance

FOUR = {"collaborators": (3, 3)}  # the ego and exactly three more
SCENES, CALLS = 16, 200  # live scenes, and calls of a stage on each
AGES = (10, 30, 50, 70)  # decisions into their episodes


@numba.njit
def _world(scene):
    advance(scene.world, scene.routes, scene.fleet.rows, scene.actions, scene.scratch)


@numba.njit
def _sense(scene):
    fleet = scene.fleet
    outline(scene.world, fleet.outlines)
    for v in range(fleet.rows.shape[0]):
        pose = fleet.trail[v, FRAMES - 1]
        fix_pose(scene.world, fleet.rows[v], scene.sensor, scene.keys[SENSE], scene.clock[0], pose)
        sense(
            scene.world, fleet.outlines, fleet.rows[v], scene.sensor, scene.keys[SENSE], scene.clock[0], pose,
            fleet.detection, fleet.detected_kind, fleet.visible[v], fleet.near,
        )  # fmt: skip


@numba.njit
def _sense_and_track(scene):
    fleet = scene.fleet
    outline(scene.world, fleet.outlines)
    for v in range(fleet.rows.shape[0]):
        pose = fleet.trail[v, FRAMES - 1]
        found = sense(
            scene.world, fleet.outlines, fleet.rows[v], scene.sensor, scene.keys[SENSE], scene.clock[0], pose,
            fleet.detection, fleet.detected_kind, fleet.visible[v], fleet.near,
        )  # fmt: skip
        update(_tracks_at(fleet.tracks, v), fleet.detection, fleet.detected_kind, found, scene.sensor.noise)


@numba.njit
def _graph(scene):
    fleet = scene.fleet
    for v in range(fleet.rows.shape[0]):
        window, tracks = _rows_at(fleet.window, v), _tracks_at(fleet.tracks, v)
        kind = scene.world.kind[fleet.rows[v]]
        slide(window)
        add_body(window, fleet.trail[v, FRAMES - 1], CENTRE_HEIGHT[kind], kind)
        for i in range(tracks.used[0]):
            if confirmed(tracks, i) and seen_now(tracks, i):
                add_track(window, tracks.id[i], tracks.kind[i], tracks.recent[i], tracks.recent_mask[i])


@numba.njit
def _encode(scene):
    for v in range(scene.fleet.rows.shape[0]):
        write(scene.fleet.buffer, v, 100 * scene.clock[0], scene.depth, _rows_at(scene.fleet.window, v))


@numba.njit
def _radio(scene):
    fleet, step = scene.fleet, scene.clock[0]
    for v in range(fleet.rows.shape[0]):
        slot = step % fleet.air.step.shape[0]
        size = fleet.air.length[slot, v]
        fleet.air.on_air[slot, v] = False  # as if it had not sent in this step
        for k in range(size):
            fleet.buffer[k] = fleet.air.payload[slot, v, k]
        place = scene.world.position[fleet.rows[v]]
        send(fleet.air, scene.link, step, v, fleet.buffer, size, place[0], place[1])
    deliver(scene.world, scene.lanes, fleet, scene.link, scene.keys[1], step)


@numba.njit
def _merge(scene):
    for r in range(scene.fleet.merged.used.shape[0]):
        fuse(scene.fleet, r)


@numba.njit
def _observe(scene):
    for r in range(scene.fleet.merged.used.shape[0]):
        show(scene.world, scene.routes, scene.fleet, r)


@numba.njit
def _outcome(scene):
    write_step_info(scene)


def _looped(stage: Callable[..., None]) -> Callable[..., None]:
    """The stage `calls` times in one compiled call, so that the way from Python is paid once."""

    @numba.njit
    def loop(calls, records, place):
        for _ in range(calls):
            stage(scene_at(records, place))

    return loop


class Stages:
    """Every stage of a step of the ego and three collaborators, of which the ego merges and observes."""

    def __init__(self) -> None:
        stages = {
            "world": _world, "sense": _sense, "sense and track": _sense_and_track, "graph": _graph, "encode": _encode,
            "radio and decode": _radio, "merge": _merge, "observe": _observe, "outcome and reward": _outcome,
        }  # fmt: skip
        self._loops = {name: _looped(stage) for name, stage in stages.items()}
        for loop in self._loops.values():
            loop(1, live_scenes(1).batch_state.records, 0)

    def measured(self) -> dict[str, float]:
        """Microseconds of each stage in one step of four vehicles, the mean of several scenes and times in them."""
        cost = dict.fromkeys(self._loops, 0.0)
        for age in AGES:
            for name, loop in self._loops.items():
                live = live_scenes(age)
                for place in range(SCENES):
                    start = time.process_time()
                    loop(CALLS, live.batch_state.records, place)
                    cost[name] += (time.process_time() - start) / CALLS / SCENES / len(AGES) * 1e6
        # Tracking changes what it is given, so it is timed on fresh detections and their cost is taken off.
        both, sensing = cost.pop("sense and track"), cost["sense"]
        order = {"world": cost.pop("world"), "sense": cost.pop("sense")}
        return {**order, "track": max(both - sensing, 0.0), **cost}


def live_scenes(age: int) -> Any:
    """What the stages work on, so many decisions into their episodes."""
    live = SceneBatch([setup_from({"ranges": FOUR})] * SCENES)
    for place in range(SCENES):
        live.start(place, place)
    everywhere = np.arange(SCENES)
    for step in range(age):
        live.step(everywhere, np.full(SCENES, step * STEP > 2.0, np.int64))
    return live
