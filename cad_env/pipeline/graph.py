"""Tracks -> a window of the last 15 frames: the nodes of one vehicle's spatiotemporal graph.

Row 0 is the vehicle's own body as its GNSS places it; the other rows are its confirmed tracks, kept until their
last node has left the window.
"""

import numpy as np

from cad_env.numerics.jit import inlined
from cad_env.pipeline.graph_arrays import row_of
from cad_env.types import FRAMES, STEP, Bools, Floats, Graph, GraphArrays, Ints


@inlined
def add_body(rows: GraphArrays, pose: Floats, height: float, kind: int) -> None:
    """Note where the vehicle itself is in the newest frame. Call it first, so that the body is row 0."""
    i = row_of(rows, 0)
    rows.kind[i] = kind
    rows.mask[i, FRAMES - 1] = True
    rows.position[i, FRAMES - 1, 0] = pose[0]
    rows.position[i, FRAMES - 1, 1] = pose[1]
    rows.position[i, FRAMES - 1, 2] = height


@inlined
def add_track(rows: GraphArrays, track: int, kind: int, recent: Floats, recent_mask: Bools) -> None:
    """Note a track's newest frames, (H, 3) and (H,): on its first entry all of them, later the newest alone."""
    known = rows.used[0]
    i = row_of(rows, track)
    if i < 0:
        return
    rows.kind[i] = kind
    depth = recent.shape[0]
    for back in range(depth if i == known else 1):
        column, k = FRAMES - 1 - back, depth - 1 - back
        rows.mask[i, column] = recent_mask[k]
        for axis in range(3):
            rows.position[i, column, axis] = recent[k, axis]


def nodes_and_edges(graph: Graph) -> tuple[Ints, Floats, Ints, Floats]:
    """The edges that the nodes imply: (E, 2) spatial pairs and (E,) distances m, (F, 2) temporal pairs and (F,) gaps s.

    Pairs index the nodes in the order of np.argwhere(graph.mask), source first; a gap is source minus target time.
    """
    node = np.argwhere(graph.mask)
    place = graph.position[graph.mask]
    different = ~np.eye(len(node), dtype=bool)
    spatial = np.argwhere((node[:, None, 1] == node[None, :, 1]) & different)
    temporal = np.argwhere((node[:, None, 0] == node[None, :, 0]) & different)
    distance = np.linalg.norm(place[spatial[:, 0]] - place[spatial[:, 1]], axis=-1)
    gap = STEP * (node[temporal[:, 0], 1] - node[temporal[:, 1], 1])
    return spatial, distance, temporal, gap
