"""From the masked grids of a batch to the nodes and edges of its graphs, without the cells that are empty.

Each relation lists the nodes in an order of its own, graph after graph and group after group: spatial edges join the
nodes of one frame, temporal edges those of one track. The ego is the last node of its graph: now, at the origin,
joined to all of them in both directions.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.types import STEP, Floats, Ints
from policies.stgraph.compiled.attention import Edges
from policies.stgraph.features import VELOCITY_SCALE

SPATIAL, TEMPORAL = 0, 1

Singles = NDArray[np.float32]


class NodeList(NamedTuple):
    """The nodes of a batch; those of graph b, and then its ego, are rows start[b] to start[b + 1]."""

    start: Ints  # (B + 1,)
    group: Ints  # (N,) the frame or track of a node; of an ego -1
    time: Floats  # (N,) s; now is 0
    inputs: Floats  # (N, F + 1) scaled place, velocity if wanted, what all are told, and 1 for the bias


@compiled
def list_graph(
    tracks: Singles, mask: Ints, ego: Singles, told: Floats, relation: int, scale: float, velocity: bool,
    stride: int,
) -> tuple[NodeList, Edges]:  # fmt: skip
    """The graphs of tracks (B, K, T, 3) m, mask (B, K, T) and ego (B, 4), as one of its relations sees them.

    told (B, W): what every node of a graph carries beside its own inputs; stride: every how many frames have nodes.
    """
    nodes = _list(tracks, mask, ego, told, relation, scale, velocity, stride)
    edges = _link(nodes)
    _measure(nodes, edges, relation)
    return nodes, edges


@compiled_part
def _list(
    tracks: Singles, mask: Ints, ego: Singles, told: Floats, relation: int, scale: float, velocity: bool,
    stride: int,
) -> NodeList:  # fmt: skip
    """Frame by frame or, for temporal edges, track by track."""
    B, K, T = mask.shape
    own = 5 if velocity else 3
    most, width = B * (K * T + 1), own + told.shape[1] + 1
    start, group = np.zeros(B + 1, np.int64), np.empty(most, np.int64)
    time, inputs = np.zeros(most), np.zeros((most, width))
    n, groups = 0, T if relation == SPATIAL else K
    for b in range(B):
        for g in range(groups):
            for m in range(K + T - groups):
                k, t = (m, g) if relation == SPATIAL else (g, m)
                if mask[b, k, t] != 0 and (T - 1 - t) % stride == 0:
                    group[n], time[n] = g, STEP * (t - (T - 1))
                    for axis in range(3):
                        inputs[n, axis] = scale * np.float64(tracks[b, k, t, axis])
                    for axis in range(2 * velocity):
                        inputs[n, 3 + axis] = VELOCITY_SCALE * _slope(tracks, mask, b, k, axis)
                    n += 1
        group[n] = -1
        if velocity:
            inputs[n, 3] = VELOCITY_SCALE * np.float64(ego[b, 0])
        n += 1
        start[b + 1] = n
    for b in range(B):
        for i in range(start[b], start[b + 1]):
            for w in range(told.shape[1]):
                inputs[i, own + w] = told[b, w]
            inputs[i, width - 1] = 1.0
    return NodeList(start, group[:n], time[:n], inputs[:n])


@compiled_part
def _slope(tracks: Singles, mask: Ints, b: int, k: int, axis: int) -> float:
    """Least-squares velocity (m/s) of a track over the frames seen; 0 for fewer than two."""
    seen = when = 0
    for t in range(mask.shape[2]):
        if mask[b, k, t] != 0:
            seen, when = seen + 1, when + t
    moment = spread = 0.0
    for t in range(mask.shape[2]):
        if mask[b, k, t] != 0:
            lever = STEP * (t - when / seen)
            moment += lever * np.float64(tracks[b, k, t, axis])
            spread += lever * lever
    return moment / spread if seen > 1 else 0.0


@compiled_part
def _link(nodes: NodeList) -> Edges:
    """All pairs of each group, and the ego with everyone; their lengths are still to be filled in."""
    start, group, first = nodes.start, nodes.group, _count(nodes)
    source = np.empty(first[-1], np.int64)
    for b in range(len(start) - 1):
        begin, ego = start[b], start[b + 1] - 1
        for i in range(start[b], ego):
            begin = i if group[i] != group[begin] else begin
            for e in range(first[i], first[i + 1]):
                j = begin + e - first[i]
                source[e] = ego if j == i else j  # the edge from the ego takes the place of one from itself
        for e in range(first[ego], first[ego + 1]):
            source[e] = start[b] + e - first[ego]
    return Edges(first, source, np.empty(len(source)))


@compiled_part
def _count(nodes: NodeList) -> Ints:
    """The `first` of the edges: a node has as many as its group has nodes, an ego as many as its graph has others."""
    first, i, graph = np.zeros(len(nodes.group) + 1, np.int64), 0, 0
    while i < len(nodes.group):
        end = i + 1
        if nodes.group[i] < 0:
            first[end], graph = first[i] + i - graph, end
        else:
            while nodes.group[end] == nodes.group[i]:
                end += 1
            for k in range(i, end):
                first[k + 1] = first[k] + end - i
        i = end
    return first


@compiled_part
def _measure(nodes: NodeList, edges: Edges, relation: int) -> None:
    """Fill in the distance, in units of the position scale, or the time of the source minus that of the target."""
    place, time = nodes.inputs, nodes.time
    for i in range(len(time)):
        for e in range(edges.first[i], edges.first[i + 1]):
            j = edges.source[e]
            if relation == SPATIAL:
                x, y, z = place[i, 0] - place[j, 0], place[i, 1] - place[j, 1], place[i, 2] - place[j, 2]
                edges.length[e] = np.sqrt(x * x + y * y + z * z)
            else:
                edges.length[e] = time[j] - time[i]
