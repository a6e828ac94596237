"""Merged graph -> fixed masked arrays in the ego frame: the only place that knows the ego frame.

Frame t of a track is in the frame the ego had at t, so the ego is the origin of every frame and the motion of
objects is relative to its own.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from cad_env.numerics.jit import compiled, compiled_part, inlined_part
from cad_env.numerics.rigid import turned
from cad_env.types import (
    COMMANDS,
    FRAMES,
    OBSERVED_TRACKS,
    ROUTE_POINTS,
    ROUTE_SPACING,
    Floats,
    GraphArrays,
    Ints,
    Observation,
)
from cad_env.world.dynamics import place_on_route
from cad_env.world.state import Routes

HORIZON = 200.0  # m; coordinates are clipped to it, so every box of the space is finite
MAX_SPEED = 50.0  # m/s


class View(NamedTuple):
    """What one vehicle decides on; the fields of the observation space, K = OBSERVED_TRACKS, T = FRAMES."""

    tracks: Floats  # (K, T, 3) m, nearest track first; zero where the mask is
    mask: Ints  # (K, T) int8
    kind: Ints  # (K,) int8
    odometry: Floats  # (T, 3) m, m, rad: the ego's pose in each frame, in its newest frame
    ego: Floats  # (4,) speed m/s, wanted speed m/s, length m, width m
    command: Ints  # (C,) int8 one-hot: the six of Command, and those that the scenario adds
    route: Floats  # (ROUTE_POINTS, 2) m, the way ahead every ROUTE_SPACING
    oncoming: Ints  # (ROUTE_POINTS,) int8 1 where the way ahead is in a lane of oncoming traffic


def empty_view(*lead: int, commands: int = COMMANDS) -> View:
    """An observation of nothing; leading dimensions stack views. `commands`: C, how many the scenario has."""
    return View(
        np.zeros((*lead, OBSERVED_TRACKS, FRAMES, 3), np.float32), np.zeros((*lead, OBSERVED_TRACKS, FRAMES), np.int8),
        np.zeros((*lead, OBSERVED_TRACKS), np.int8), np.zeros((*lead, FRAMES, 3), np.float32),
        np.zeros((*lead, 4), np.float32), np.zeros((*lead, commands), np.int8),
        np.zeros((*lead, ROUTE_POINTS, 2), np.float32), np.zeros((*lead, ROUTE_POINTS), np.int8),
    )  # fmt: skip


def observation_space(commands: int = COMMANDS) -> spaces.Dict:
    """The space of every agent's observation: a flat Dict of finite boxes."""

    def metres(*shape: int) -> spaces.Box:
        return spaces.Box(-HORIZON, HORIZON, shape, np.float32)

    return spaces.Dict(
        {
            "tracks": metres(OBSERVED_TRACKS, FRAMES, 3),
            "mask": spaces.Box(0, 1, (OBSERVED_TRACKS, FRAMES), np.int8),
            "kind": spaces.Box(0, 1, (OBSERVED_TRACKS,), np.int8),
            "odometry": metres(FRAMES, 3),
            "ego": spaces.Box(0.0, MAX_SPEED, (4,), np.float32),
            "command": spaces.Box(0, 1, (commands,), np.int8),
            "route": metres(ROUTE_POINTS, 2),
            "oncoming": spaces.Box(0, 1, (ROUTE_POINTS,), np.int8),
        }
    )


def as_observation(view: Any) -> Observation:
    """A copy of a view, a record of arrays, as the dictionary that the environments return."""
    return {name: getattr(view, name).copy() for name in view._fields}


def view_of(observation: Observation) -> View:
    """The fields of an observation, or of many stacked along a first axis, as a record: the arrays themselves."""
    return View(*(observation[name] for name in View._fields))


@inlined_part
def view_at(stack: View, r: int) -> View:
    """View number `r` of a stack, for compiled loops."""
    return View(
        stack.tracks[r], stack.mask[r], stack.kind[r], stack.odometry[r], stack.ego[r], stack.command[r],
        stack.route[r], stack.oncoming[r],
    )  # fmt: skip


@compiled_part
def _clip(value: float) -> float:
    return min(max(value, -HORIZON), HORIZON)


@compiled
def observe_tracks(view: View, merged: GraphArrays, trail: Floats) -> None:
    """Show the nearest tracks of a merged graph. trail (T, 3): the ego's pose x, y (m), heading (rad) per frame."""
    count = merged.used[0]
    distance = np.empty(count)
    for g in range(count):
        newest = 0
        for t in range(FRAMES):
            if merged.mask[g, t]:
                newest = t
        distance[g] = math.hypot(
            merged.position[g, newest, 0] - trail[FRAMES - 1, 0], merged.position[g, newest, 1] - trail[FRAMES - 1, 1]
        )
    view.tracks[:] = 0.0
    view.mask[:] = 0
    view.kind[:] = 0
    shown = min(count, OBSERVED_TRACKS)
    row = np.empty(shown, np.int64)
    for k in range(shown):
        g = 0
        for other in range(1, count):  # ties go to the lower row, so the order is well defined
            if distance[other] < distance[g]:
                g = other
        distance[g] = math.inf
        view.kind[k] = merged.kind[g]
        row[k] = g
    for t in range(FRAMES):
        cos, sin = math.cos(trail[t, 2]), math.sin(trail[t, 2])
        for k in range(shown):
            g = row[k]
            if not merged.mask[g, t]:
                continue
            dx, dy = merged.position[g, t, 0] - trail[t, 0], merged.position[g, t, 1] - trail[t, 1]
            view.mask[k, t] = 1
            view.tracks[k, t, 0] = _clip(dx * cos + dy * sin)
            view.tracks[k, t, 1] = _clip(dy * cos - dx * sin)
            view.tracks[k, t, 2] = merged.position[g, t, 2]


@compiled
def observe_ego(view: View, trail: Floats, place: Floats, routes: Routes, route: int, progress: float, speed: float,
                target_speed: float, length: float, width: float) -> None:  # fmt: skip
    """Show the ego's own motion, by its trail (T, 3), and command and way ahead, by its place (3,) on the map."""
    x, y, heading = trail[FRAMES - 1, 0], trail[FRAMES - 1, 1], trail[FRAMES - 1, 2]
    cos, sin = math.cos(heading), math.sin(heading)
    for t in range(FRAMES):
        dx, dy = trail[t, 0] - x, trail[t, 1] - y
        view.odometry[t, 0] = _clip(dx * cos + dy * sin)
        view.odometry[t, 1] = _clip(dy * cos - dx * sin)
        view.odometry[t, 2] = turned(trail[t, 2] - heading)
    x, y, heading = place[0], place[1], place[2]
    cos, sin = math.cos(heading), math.sin(heading)
    view.ego[0], view.ego[1] = min(speed, MAX_SPEED), min(target_speed, MAX_SPEED)
    view.ego[2], view.ego[3] = length, width
    last = routes.point.shape[1] - 1
    along, _ = place_on_route(routes, route, x, y, progress)
    view.command[:] = 0
    view.command[routes.command[route, min(max(int(along / routes.spacing), 0), last)]] = 1
    for k in range(ROUTE_POINTS):
        arc = along + (k + 1) * ROUTE_SPACING
        index = min(max(int(arc / routes.spacing), 0), last - 1)
        share = arc / routes.spacing - index  # beyond the last sample the way goes straight on
        px = routes.point[route, index, 0] * (1.0 - share) + routes.point[route, index + 1, 0] * share
        py = routes.point[route, index, 1] * (1.0 - share) + routes.point[route, index + 1, 1] * share
        view.route[k, 0] = _clip((px - x) * cos + (py - y) * sin)
        view.route[k, 1] = _clip((py - y) * cos - (px - x) * sin)
        view.oncoming[k] = routes.oncoming[route, index]
