"""Rows of tracks by frames: the arrays behind a Graph, and the few things every holder of them does."""

import numpy as np

from cad_env.numerics.jit import compiled, inlined
from cad_env.types import FRAMES, MAX_TRACKS, Floats, Graph, GraphArrays


def empty_graph_arrays(*lead: int, rows: int = MAX_TRACKS) -> GraphArrays:
    """A graph without nodes; leading dimensions stack graphs."""
    return GraphArrays(
        np.zeros((*lead, 1), np.int64), np.zeros((*lead, rows), np.int64), np.zeros((*lead, rows, FRAMES, 3)),
        np.zeros((*lead, rows, FRAMES), np.bool_), np.zeros((*lead, rows), np.int8),
    )  # fmt: skip


@inlined
def flat_positions(rows: GraphArrays) -> Floats:
    """The positions as (R, T * 3): one plain loop over them moves many numbers at a time."""
    return rows.position.reshape(rows.position.shape[0], FRAMES * 3)


@compiled
def slide(rows: GraphArrays) -> None:
    """One frame later: every node moves one column towards the past, and rows without nodes go."""
    flat = flat_positions(rows)
    kept = 0
    for i in range(rows.used[0]):
        alive = False
        for t in range(FRAMES - 1):
            alive |= rows.mask[i, t + 1]
            rows.mask[kept, t] = rows.mask[i, t + 1]
        rows.mask[kept, FRAMES - 1] = False
        if not alive:
            continue
        for k in range(3 * (FRAMES - 1)):
            flat[kept, k] = flat[i, k + 3]
        rows.track[kept], rows.kind[kept] = rows.track[i], rows.kind[i]
        kept += 1
    rows.used[0] = kept


@inlined
def row_of(rows: GraphArrays, track: int) -> int:
    """The row of a track id; a new empty row if it is unknown; -1 if the graph is full."""
    for i in range(rows.used[0]):
        if rows.track[i] == track:
            return i
    i = rows.used[0]
    if i == rows.track.shape[0]:
        return -1
    rows.used[0] += 1
    rows.track[i] = track
    rows.mask[i] = False
    return int(i)


def graph_arrays(graph: Graph) -> GraphArrays:
    """A graph as the compiled stages see it."""
    return GraphArrays(
        np.array([len(graph.track)], np.int64),
        np.ascontiguousarray(graph.track, np.int64),
        np.ascontiguousarray(graph.position, np.float64),
        np.ascontiguousarray(graph.mask, np.bool_),
        np.ascontiguousarray(graph.kind, np.int8),
    )


def as_graph(rows: GraphArrays, sender: int, time: float) -> Graph:
    """The rows in use as the noun that leaves this package."""
    n = int(rows.used[0])
    mask = rows.mask[:n].copy()
    position = np.where(mask[..., None], rows.position[:n], 0.0)
    return Graph(sender, time, rows.track[:n].copy(), position, mask, rows.kind[:n].copy())
