"""Tracks -> a window of the last 15 frames: the nodes of one vehicle's spatiotemporal graph.

Row 0 is the vehicle's own body as its GNSS places it; the other rows are its confirmed tracks, kept until their
last node has left the window.
"""

from cad_env.numerics.jit import inlined
from cad_env.pipeline.graph_arrays import row_of
from cad_env.types import FRAMES, Bools, Floats, GraphArrays


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
