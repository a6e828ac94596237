"""What each stage of a step costs: the stage's own compiled function in a compiled loop, on live scenes."""

import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from cad_env.pipeline.codec import write
from cad_env.pipeline.graph import add_body, add_track
from cad_env.pipeline.radio import send
from cad_env.pipeline.sense import CENTRE_HEIGHT, fix_pose, sense
from cad_env.pipeline.step import SENSE, _rows_at, _tracks_at, deliver, fuse, show
from cad_env.pipeline.track import confirmed, seen_now, update
from cad_env.rows import slide
from cad_env.simulation import Simulation, setup_from
from cad_env.types import FRAMES
from cad_env.world.clearance import time_to_contact

SCENES, AGE, CALLS = 8, 30, 200  # live scenes, 3 s into each, and calls of a stage on each


@numba.njit
def _sense(world, routes, fleet, sensor, link, depth, keys, step):
    for v in range(fleet.rows.shape[0]):
        pose = fleet.trail[v, FRAMES - 1]
        fix_pose(world, fleet.rows[v], sensor, keys[SENSE], step, pose)
        sense(
            world,
            fleet.rows[v],
            sensor,
            keys[SENSE],
            step,
            pose,
            fleet.detection,
            fleet.detected_kind,
            fleet.visible[v],
        )


@numba.njit
def _sense_and_track(world, routes, fleet, sensor, link, depth, keys, step):
    for v in range(fleet.rows.shape[0]):
        pose = fleet.trail[v, FRAMES - 1]
        found = sense(
            world,
            fleet.rows[v],
            sensor,
            keys[SENSE],
            step,
            pose,
            fleet.detection,
            fleet.detected_kind,
            fleet.visible[v],
        )
        update(_tracks_at(fleet.tracks, v), fleet.detection, fleet.detected_kind, found, sensor.noise)


@numba.njit
def _graph(world, routes, fleet, sensor, link, depth, keys, step):
    for v in range(fleet.rows.shape[0]):
        window, tracks = _rows_at(fleet.window, v), _tracks_at(fleet.tracks, v)
        kind = world.kind[fleet.rows[v]]
        slide(window)
        add_body(window, fleet.trail[v, FRAMES - 1], CENTRE_HEIGHT[kind], kind)
        for i in range(tracks.used[0]):
            if confirmed(tracks, i) and seen_now(tracks, i):
                add_track(window, tracks.id[i], tracks.kind[i], tracks.recent[i], tracks.recent_mask[i])


@numba.njit
def _encode(world, routes, fleet, sensor, link, depth, keys, step):
    for v in range(fleet.rows.shape[0]):
        write(fleet.buffer, v, 100 * step, depth, _rows_at(fleet.window, v))


@numba.njit
def _radio(world, routes, fleet, sensor, link, depth, keys, step):
    for v in range(fleet.rows.shape[0]):
        slot = step % fleet.air.step.shape[0]
        size = fleet.air.length[slot, v]
        fleet.air.on_air[slot, v] = False  # as if it had not sent in this step
        for k in range(size):
            fleet.buffer[k] = fleet.air.payload[slot, v, k]
        place = world.position[fleet.rows[v]]
        send(fleet.air, link, step, v, fleet.buffer, size, place[0], place[1])
    deliver(fleet, link, keys[1], step)


@numba.njit
def _merge(world, routes, fleet, sensor, link, depth, keys, step):
    for r in range(fleet.merged.used.shape[0]):
        fuse(fleet, r)


@numba.njit
def _observe(world, routes, fleet, sensor, link, depth, keys, step):
    for r in range(fleet.merged.used.shape[0]):
        show(world, routes, fleet, r)


@numba.njit
def _contact_time(world, routes, fleet, sensor, link, depth, keys, step):
    time_to_contact(world, 0)


def _looped(stage: Callable[..., None]) -> Callable[..., None]:
    """The stage `calls` times in one compiled call, so that the way from Python is paid once."""

    @numba.njit
    def loop(calls, world, routes, fleet, sensor, link, depth, keys, step):
        for _ in range(calls):
            stage(world, routes, fleet, sensor, link, depth, keys, step)

    return loop


class Stages:
    """Every stage of a step of the ego and three collaborators, of which the ego merges and observes."""

    def __init__(self) -> None:
        stages = {
            "sense": _sense, "sense and track": _sense_and_track, "graph": _graph, "encode": _encode,
            "radio and decode": _radio, "merge": _merge, "observe": _observe, "time to contact": _contact_time,
        }  # fmt: skip
        self._loops = {name: _looped(stage) for name, stage in stages.items()}
        for loop in self._loops.values():
            loop(1, *_live_scene(0))

    def measured(self) -> dict[str, float]:
        """Microseconds of each stage in one step of four vehicles, the mean of several scenes."""
        cost = dict.fromkeys(self._loops, 0.0)
        for seed in range(SCENES):
            for name, loop in self._loops.items():
                live = _live_scene(seed)
                start = time.process_time()
                loop(CALLS, *live)
                cost[name] += (time.process_time() - start) / CALLS / SCENES * 1e6
        # Tracking changes what it is given, so it is timed on fresh detections and their cost is taken off.
        both = cost.pop("sense and track")
        order = {"sense": cost.pop("sense")}
        return {**order, "track": max(both - order["sense"], 0.0), **cost}


def _live_scene(seed: int) -> tuple[Any, ...]:
    """What the stages work on, some seconds into an episode."""
    simulation = Simulation(setup_from({"ranges": {"collaborators": (3, 3)}}))
    simulation.start(seed, receivers=1)
    for _ in range(AGE):
        simulation.step(np.zeros(4, np.int64))
    return (
        simulation.world, simulation.map.routes, simulation.fleet, simulation._sensor, simulation._link,
        simulation.setup.depth, simulation._keys, simulation.steps,
    )  # fmt: skip
