"""Hidden places -> the lanes that an agent's way meets, as fixed masked arrays in its own frame."""

import math
from typing import NamedTuple

import numpy as np
from gymnasium import spaces

from cad_env.numerics.jit import compiled_part, inlined_part
from cad_env.pipeline.hidden import Hidden, foremost, place_beside
from cad_env.pipeline.observe import HORIZON
from cad_env.types import MAX_STEPS, STEP, Floats, Ints
from cad_env.world.dynamics import place_on_route
from cad_env.world.lanes import CONFLICTS, PLACE, PLACES, Lanes
from cad_env.world.state import Routes

_BESIDE = 4.0  # m from the middle of a lane that comes towards it, within which the agent is beside it
# The columns of `lanes`, in the agent's frame. The conflict is where the lane first takes up ground of the agent's way.
LANE_FEATURES = (
    "x", "y",  # m, the conflict
    "cos", "sin",  # of the lane's direction there
    "reach",  # m along the agent's way until the front of its body is in the way of the lane; negative: it is
    "through",  # m along the agent's way until the rear of its body is out of it
    "hidden",  # m along the lane from the foremost hidden place to the conflict; negative: beyond it; HORIZON: none
    "age",  # s since the newest of what is known of the lane
    "time",  # s until the front of a car from there could be at the conflict, at `speed`
    "speed",  # m/s that what is hidden may drive at
    "phantom_x", "phantom_y", "phantom_cos", "phantom_sin",  # m, the foremost hidden place, its lane there; or zeros
)  # fmt: skip


class LaneView(NamedTuple):
    """What an observation with coverage has besides; L = CONFLICTS, F = len(LANE_FEATURES)."""

    lanes: Floats  # (L, F) float32 as LANE_FEATURES, in the order in which the way meets them; zero where the mask is
    lane_mask: Ints  # (L,) int8 1 for each lane that the agent has not passed


def empty_lane_view(*lead: int) -> LaneView:
    """No lanes; leading dimensions stack views."""
    return LaneView(np.zeros((*lead, CONFLICTS, len(LANE_FEATURES)), np.float32), np.zeros((*lead, CONFLICTS), np.int8))


def lane_spaces() -> dict[str, spaces.Box]:
    """The boxes of a LaneView."""
    return {
        "lanes": spaces.Box(-HORIZON, HORIZON, (CONFLICTS, len(LANE_FEATURES)), np.float32),
        "lane_mask": spaces.Box(0, 1, (CONFLICTS,), np.int8),
    }


@inlined_part
def lane_view_at(stack: LaneView, r: int) -> LaneView:
    """View number `r` of a stack, for compiled loops."""
    return LaneView(stack.lanes[r], stack.lane_mask[r])


@compiled_part
def observe_lanes(view: LaneView, hidden: Hidden, lanes: Lanes, routes: Routes, route: int, progress: float,
                  length: float, pose: Floats, step: int) -> None:  # fmt: skip
    """Show the lanes that the way meets, from the agent's own place `pose` (3,) on the map; it is `length` m long."""
    view.lanes[:] = 0.0
    view.lane_mask[:] = 0
    shown = 0
    frame = (pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2]))
    along, _ = place_on_route(routes, route, pose[0], pose[1], progress)
    for k in range(hidden.places.shape[0]):
        b = lanes.other[route, k]
        if b < 0 or lanes.through[route, k] - along + 0.5 * length <= 0.0:
            continue
        row = view.lanes[shown]
        view.lane_mask[shown] = 1
        shown += 1
        conflict = lanes.conflict[route, k]
        _put(row, 0, frame, conflict[0], conflict[1], conflict[2], conflict[3])
        row[4] = _clip(lanes.reach[route, k] - along - 0.5 * length)
        row[5] = _clip(lanes.through[route, k] - along + 0.5 * length)
        row[7] = min(STEP * (step - hidden.heard[k]), STEP * MAX_STEPS)
        row[9] = lanes.limit[b]
        place = foremost(hidden.places[k], hidden.known[k], lanes.first[b], _last_place(lanes, route, k, b, pose))
        away = math.inf if place < 0 else lanes.entry[route, k] - (lanes.start[b] + (place + 1) * PLACE)
        row[6] = _clip(away)
        row[8] = lanes.soonest[route, k, place + 1] if place >= 0 else HORIZON / lanes.limit[b]
        if away < HORIZON:
            x, y, cos, sin = _at_place(lanes, b, place + 1)
            _put(row, 10, frame, x, y, cos, sin)


@inlined_part
def _last_place(lanes: Lanes, route: int, k: int, b: int, pose: Floats) -> int:
    """The last place of lane b from where anybody comes to the conflict: it ends where what comes has met the agent."""
    last = (lanes.exit[route, k] - lanes.start[b]) / PLACE
    if lanes.opposed[route, k]:
        arc, beside, _ = place_beside(lanes, b, pose[0], pose[1], pose[0], pose[1])
        if beside < _BESIDE:
            last = min(last, arc)
    return int(min(max(math.floor(last), 0), PLACES - 1))


@inlined_part
def _at_place(lanes: Lanes, b: int, place: int) -> tuple[float, float, float, float]:
    """x, y (m), cos and sin of lane b where a place begins."""
    s = lanes.pieces[b]
    while place > lanes.piece_places[s, 1]:
        s += 1
    piece = lanes.piece[s]
    first, last = lanes.piece_places[s, 0], lanes.piece_places[s, 1]
    along = (place - first) * piece[4] / (last - first)
    return piece[0] + along * piece[2], piece[1] + along * piece[3], piece[2], piece[3]


@inlined_part
def _put(row: Floats, column: int, frame: tuple[float, float, float, float], x: float, y: float, cos: float,
         sin: float) -> None:  # fmt: skip
    """Write a point and a direction of the world, in the frame of a pose (x, y, cos, sin), to four columns."""
    dx, dy = x - frame[0], y - frame[1]
    row[column], row[column + 1] = _clip(dx * frame[2] + dy * frame[3]), _clip(dy * frame[2] - dx * frame[3])
    row[column + 2], row[column + 3] = cos * frame[2] + sin * frame[3], sin * frame[2] - cos * frame[3]


@compiled_part
def _clip(value: float) -> float:
    return min(max(value, -HORIZON), HORIZON)
