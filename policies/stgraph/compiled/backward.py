"""The gradient of an attention layer: what `fused_attention.exchange` did, walked backward."""

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.types import Floats
from policies.stgraph.compiled.attention import HEADS, Edges, Layer, LayerWeights
from policies.stgraph.compiled.simd import fourfold, load, positive, store


@compiled
def unexchange(
    edges: Edges, layer: Layer, weights: LayerWeights, slope: float, to_heard: Floats, into: LayerWeights
) -> Floats:
    """Given the gradient by what was heard (N, L), add to that of the weights; return that by the projection."""
    to_projected, to_alpha = np.zeros((len(to_heard), layer.projected.shape[1])), np.empty((len(layer.alpha), HEADS))
    _unhear(edges, layer, weights.edge_value, to_heard, to_alpha, to_projected, into.edge_value)
    _unattend(edges, layer, weights.edge_score, slope, to_alpha, to_projected, into.edge_score)
    _add_product(layer.inputs, to_projected, into.project)
    return to_projected


@compiled_part
def _unhear(
    edges: Edges,
    layer: Layer,
    edge_value: Floats,
    to_heard: Floats,
    to_alpha: Floats,
    to_projected: Floats,
    to_edge_value: Floats,
) -> None:
    """Fill the gradient by the weights of the edges; add to those by the values of the nodes and of the edges."""
    row, width = layer.projected.shape[1] // HEADS, to_heard.shape[1] // HEADS
    for i in range(len(to_heard)):
        by_length, length = fourfold(0.0), load(layer.mean_length, i)
        for d in range(width):
            step = load(to_heard, i * width + d)
            by_length += step * load(edge_value, d)
            store(to_edge_value, d, load(to_edge_value, d) + step * length)
            store(to_projected, i * row + d, load(to_projected, i * row + d) + step)
        for e in range(edges.first[i], edges.first[i + 1]):
            at, weight, by_alpha = edges.source[e] * row, load(layer.alpha, e), by_length * fourfold(edges.length[e])
            for d in range(width):
                step = load(to_heard, i * width + d)
                by_alpha += step * load(layer.projected, at + d)
                store(to_projected, at + d, load(to_projected, at + d) + weight * step)
            store(to_alpha, e, by_alpha)


@compiled_part
def _unattend(
    edges: Edges,
    layer: Layer,
    edge_score: Floats,
    slope: float,
    to_alpha: Floats,
    to_projected: Floats,
    to_edge_score: Floats,
) -> None:
    """Through the softmax and the leaky ReLU: add to the gradients by the scores of target, source and edge."""
    projected, row = layer.projected, layer.projected.shape[1] // HEADS
    one, leak, by_length, by_edge = fourfold(1.0), fourfold(slope), load(edge_score, 0), fourfold(0.0)
    for i in range(len(projected)):
        mean, by_target, target = fourfold(0.0), fourfold(0.0), load(projected, i * row + row - 2)
        for e in range(edges.first[i], edges.first[i + 1]):
            mean += load(layer.alpha, e) * load(to_alpha, e)
        for e in range(edges.first[i], edges.first[i + 1]):
            at, length = edges.source[e] * row + row - 1, fourfold(edges.length[e])
            x = target + load(projected, at) + length * by_length
            step = load(layer.alpha, e) * (load(to_alpha, e) - mean) * positive(x, one, leak)
            by_target += step
            by_edge += step * length
            store(to_projected, at, load(to_projected, at) + step)
        at = i * row + row - 2
        store(to_projected, at, load(to_projected, at) + by_target)
    store(to_edge_score, 0, load(to_edge_score, 0) + by_edge)


@compiled_part
def _add_product(a: Floats, b: Floats, total: Floats) -> None:
    """Add a^T b, of two tall matrices, to a small one."""
    odd = len(a) % 2
    for c in range(a.shape[1] * odd):
        for s in range(b.shape[1]):
            total[c, s] += a[0, c] * b[0, s]
    for i in range(odd, len(a), 2):
        for c in range(a.shape[1]):
            x, y = a[i, c], a[i + 1, c]
            for s in range(b.shape[1]):
                total[c, s] += x * b[i, s] + y * b[i + 1, s]
