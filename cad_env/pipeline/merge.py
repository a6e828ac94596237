"""Own graph + what other vehicles sent -> one graph: associate tracks across vehicles, fuse, forget oneself.

Tracks, not detections, are associated: the cost of a pair is the root mean square distance over the frames that
both were seen in. The receiver's tracks come first, then each sender's in the order of sender numbers, one to one,
so two tracks of one vehicle never merge and the order of arrival does not matter.
"""

import math

import numpy as np

from cad_env.numerics.assignment import assign
from cad_env.numerics.jit import compiled, inlined, inlined_part
from cad_env.pipeline.graph_arrays import flat_positions, row_of
from cad_env.types import FRAMES, MAX_TRACKS, Floats, GraphArrays
from cad_env.world.geometry import within

MERGE_GATE = 2.5  # m; closer than two vehicles can be, wider than two trackers disagree
EGO_RADIUS = 2.0  # m around itself in which the ego takes no node for another vehicle (the paper's rule)
WIDEST_EGO = 3.4  # m, as above where it is not sure where a node is: nearer than the next lane
CLOSE = 1.2  # m, gate of two tracks whose places are known well; it grows with what is not known of them
_NOISE = 0.2  # m, standard deviation of a track in the frame of its vehicle
_EXACTLY = np.zeros(MAX_TRACKS)


@inlined
def receive(kept: GraphArrays, message: GraphArrays, depth: int, age: int) -> None:
    """Take the newest `depth` frames of a message, `age` frames old, into the window kept of its sender."""
    into, said = flat_positions(kept), flat_positions(message)
    newest = FRAMES - 1 - age
    oldest = max(newest - depth + 1, 0)
    for i in range(kept.used[0]):  # the message is the sender's whole word on the frames it covers
        for t in range(oldest, newest + 1):
            kept.mask[i, t] = False
    for m in range(message.used[0]):
        i = row_of(kept, message.track[m])
        if i < 0:
            continue
        kept.kind[i] = message.kind[m]
        for t in range(oldest, newest + 1):
            kept.mask[i, t] = message.mask[m, t + age]
        for k in range(3 * oldest, 3 * (newest + 1)):  # one plain loop is copied many numbers at a time
            into[i, k] = said[m, k + 3 * age]


@compiled
def start_merge(merged: GraphArrays) -> None:
    """Empty the merged graph."""
    merged.used[0] = 0


@compiled
def take_in(merged: GraphArrays, weight: Floats, rows: GraphArrays, first: int, trail: Floats) -> None:
    """Associate one vehicle's rows from `first` on with the merged graph, and fuse them by their mean.

    weight (M, T): how many vehicles saw a node, of the rows in use.
    trail (T, 3): the ego's own pose in each frame; nodes within EGO_RADIUS of it are the ego, and are left out.
    """
    take_in_placed(merged, weight, rows, first, trail, _EXACTLY, MERGE_GATE)


@compiled
def take_in_placed(
    merged: GraphArrays, weight: Floats, rows: GraphArrays, first: int, trail: Floats, spread: Floats, gate: float
) -> None:
    """As `take_in`, where rows are placed with standard deviations spread (rows,) m, and so count for less.

    gate: m, of a row without any; it grows by three standard deviations, up to MERGE_GATE.
    """
    known, count = merged.used[0], rows.used[0]
    cost = np.empty((known, count))
    match = np.full(count, -1, np.int64)
    found = np.empty(known, np.int64)
    for g in range(known):
        for i in range(first, count):
            apart = _disagreement(merged, weight, g, rows, i)
            cost[g, i - first] = apart if apart < min(gate + 3.0 * spread[i], MERGE_GATE) else math.inf
    assign(cost, known, max(count - first, 0), MERGE_GATE, found)
    for g in range(known):
        if found[g] >= 0:
            match[first + found[g]] = g
    for i in range(first, count):
        g = match[i]
        if g < 0:
            if merged.used[0] == merged.track.shape[0]:
                continue
            g = merged.used[0]
            merged.used[0] += 1
            merged.track[g], merged.kind[g] = g, rows.kind[i]
            merged.mask[g] = False
            weight[g] = 0.0
        _fuse(merged, weight, g, rows, i, trail, spread[i])


@inlined_part
def _disagreement(merged: GraphArrays, weight: Floats, g: int, rows: GraphArrays, i: int) -> float:
    """Root mean square distance in the plane over the frames both hold, m; inf if there is none."""
    total, common = 0.0, 0
    for back in range(FRAMES):
        t = FRAMES - 1 - back
        if weight[g, t] > 0.0 and rows.mask[i, t]:
            dx = merged.position[g, t, 0] - rows.position[i, t, 0]
            dy = merged.position[g, t, 1] - rows.position[i, t, 1]
            total += dx * dx + dy * dy
            if total > MERGE_GATE * MERGE_GATE * FRAMES:  # no number of further frames brings the mean below the gate
                return math.inf
            common += 1
    return math.sqrt(total / common) if common > 0 else math.inf


@inlined_part
def _fuse(merged: GraphArrays, weight: Floats, g: int, rows: GraphArrays, i: int, trail: Floats, spread: float) -> None:
    own = 1.0 if spread == 0.0 else _NOISE * _NOISE / (_NOISE * _NOISE + spread * spread)
    radius = min(EGO_RADIUS + 2.0 * spread, WIDEST_EGO)
    for t in range(FRAMES):
        if not rows.mask[i, t] or _is_ego(rows, i, t, trail, radius):
            continue
        if weight[g, t] == 0.0:
            for axis in range(3):
                merged.position[g, t, axis] = 0.0 + rows.position[i, t, axis]  # -0.0 becomes 0.0, as in any other mean
        else:
            share = own / (weight[g, t] + own)
            for axis in range(3):
                before = merged.position[g, t, axis]
                merged.position[g, t, axis] = before + share * (rows.position[i, t, axis] - before)
        weight[g, t] += own
        merged.mask[g, t] = True


@inlined_part
def _is_ego(rows: GraphArrays, i: int, t: int, trail: Floats, radius: float) -> bool:
    return within(rows.position[i, t, 0] - trail[t, 0], rows.position[i, t, 1] - trail[t, 1], radius)


@compiled
def finish_merge(merged: GraphArrays, trail: Floats) -> None:
    """Apply the ego rule to the fused positions too, and drop rows that hold no node."""
    kept = 0
    for g in range(merged.used[0]):
        alive = False
        for t in range(FRAMES):
            if merged.mask[g, t] and _is_ego(merged, g, t, trail, EGO_RADIUS):
                merged.mask[g, t] = False
            alive = alive or merged.mask[g, t]
        if not alive:
            continue
        if kept != g:
            merged.kind[kept] = merged.kind[g]
            for t in range(FRAMES):
                merged.mask[kept, t] = merged.mask[g, t]
                for axis in range(3):
                    merged.position[kept, t, axis] = merged.position[g, t, axis]
        merged.track[kept] = kept
        kept += 1
    merged.used[0] = kept
