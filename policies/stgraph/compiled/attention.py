"""One attention layer over the edges of many graphs, in compiled loops: Eqs. (2) and (3) of the paper.

The N nodes of all graphs, egos included, are rows. The four heads lie side by side, in one quad: number d of head h is
lane 4 d + h of L = 4 D lanes. A projected node holds D quads of its value W h, one of its scores as a target and one
of its scores as a source, all linear in its inputs.

Every row is computed by itself and in the same order, so no scene feels, in any bit, which others share its batch.
"""

from typing import NamedTuple

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.types import Floats, Ints
from policies.stgraph.compiled.simd import LANES, fourfold, load, positive, store

HEADS = LANES

_LOG2_E, _LN2_HIGH, _LN2_LOW = 1.4426950408889634, 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ROUNDER = 1.5 * 2.0**52  # added to a small number, it leaves the nearest whole number in the low bits
_LOWEST = -700.0  # exp() of it is 1e-304, as good as 0
_BLOCK = 256  # numbers that stay in the innermost cache


class Edges(NamedTuple):
    """The edges of one relation, sorted by target; those that lead to node i are first[i] to first[i + 1]."""

    first: Ints  # (N + 1,)
    source: Ints  # (E,)
    length: Floats  # (E,) the attribute: distance or time gap


class LayerWeights(NamedTuple):
    """What a layer has learned; or, of the same shapes, the gradient of it."""

    project: Floats  # (C, L + 8)
    edge_score: Floats  # (4,)
    edge_value: Floats  # (L,) W_e


class LayerPass(NamedTuple):
    """What happened in a layer, as its gradient needs it."""

    inputs: Floats  # (N, C)
    projected: Floats  # (N, L + 8)
    alpha: Floats  # (E, 4) the weight of an edge among all that lead to its target
    mean_length: Floats  # (N, 4) of the edges that lead to a node, weighed
    heard: Floats  # (N, L) a node's own value plus what it hears


@compiled
def attention_layer(edges: Edges, inputs: Floats, weights: LayerWeights, slope: float) -> LayerPass:
    """One attention layer along the edges."""
    projected = multiply(inputs, weights.project)
    alpha = _attend(edges, projected, weights.edge_score, slope)
    heard, mean_length = np.empty((len(inputs), len(weights.edge_value))), np.empty((len(inputs), HEADS))
    _hear(edges, projected, weights.edge_value, alpha, mean_length, heard)
    return LayerPass(inputs, projected, alpha, mean_length, heard)


@compiled
def multiply(a: Floats, b: Floats) -> Floats:
    """The matrix product of a tall and a small matrix: as fast as BLAS, each row by itself, and without threads."""
    product = np.zeros((a.shape[0], b.shape[1]))
    odd = a.shape[1] % 2
    for i in range(a.shape[0]):
        for s in range(b.shape[1] * odd):
            product[i, s] = a[i, 0] * b[0, s]
        for c in range(odd, a.shape[1], 2):
            x, y = a[i, c], a[i, c + 1]
            for s in range(b.shape[1]):
                product[i, s] += x * b[c, s] + y * b[c + 1, s]
    return product


@compiled_part
def _attend(edges: Edges, projected: Floats, edge_score: Floats, slope: float) -> Floats:
    """The softmax of the scores of the edges over those that lead to the same target: (E, 4)."""
    alpha, row = np.empty((len(edges.source), HEADS)), projected.shape[1] // HEADS
    leak, by_length = fourfold(slope), load(edge_score, 0)
    for i in range(len(projected)):
        target, most = load(projected, i * row + row - 2), fourfold(-np.inf)
        for e in range(edges.first[i], edges.first[i + 1]):
            x = target + load(projected, edges.source[e] * row + row - 1) + fourfold(edges.length[e]) * by_length
            x = positive(x, x, leak * x)
            most = positive(x - most, x, most)
            store(alpha, e, x)
        for e in range(edges.first[i], edges.first[i + 1]):
            store(alpha, e, load(alpha, e) - most)
    exponentials(alpha.reshape(-1))
    for i in range(len(projected)):
        total = fourfold(0.0)
        for e in range(edges.first[i], edges.first[i + 1]):
            total += load(alpha, e)
        share = fourfold(1.0) / total
        for e in range(edges.first[i], edges.first[i + 1]):
            store(alpha, e, share * load(alpha, e))
    return alpha


@compiled
def exponentials(x: Floats) -> None:
    """Replace x (m,), nowhere above 0, by exp(x), right to two units in the last place.

    Without branches and calls, so that the processor takes several at once: four times as fast as np.exp.

    >>> import numpy as np
    >>> x = np.array([0.0, -1.0, -1000.0])
    >>> exponentials(x)
    >>> x.round(6).tolist()
    [1.0, 0.367879, 0.0]
    """
    power = np.empty(_BLOCK)
    bits = power.view(np.int64)
    for at in range(0, len(x), _BLOCK):
        part = x[at : at + _BLOCK]
        for i in range(len(part)):
            # exp(x) = 2**k exp(r) with |r| <= ln(2) / 2, and exp(r) by its series.
            clipped = max(part[i], _LOWEST)
            power[i] = clipped * _LOG2_E + _ROUNDER
            k = power[i] - _ROUNDER
            r = (clipped - k * _LN2_HIGH) - k * _LN2_LOW
            s = 1 / 39916800 + r * (1 / 479001600)
            s = 1 / 362880 + r * (1 / 3628800 + r * s)
            s = 1 / 5040 + r * (1 / 40320 + r * s)
            s = 1 / 120 + r * (1 / 720 + r * s)
            s = 1 / 6 + r * (1 / 24 + r * s)
            part[i] = 1 + r * (1 + r * (0.5 + r * s))
        for i in range(len(part)):
            bits[i] = (bits[i] + 1023) << 52
        for i in range(len(part)):
            part[i] *= power[i]


@compiled_part
def _hear(
    edges: Edges, projected: Floats, edge_value: Floats, alpha: Floats, mean_length: Floats, heard: Floats
) -> None:
    """Fill `mean_length` and `heard`; D is even."""
    row, width = projected.shape[1] // HEADS, heard.shape[1] // HEADS
    for i in range(len(heard)):
        length = fourfold(0.0)
        for e in range(edges.first[i], edges.first[i + 1]):
            length += load(alpha, e) * fourfold(edges.length[e])
        store(mean_length, i, length)
        for d in range(0, width, 2):  # two at once, as each addition waits for the one before
            one = load(projected, i * row + d) + length * load(edge_value, d)
            two = load(projected, i * row + d + 1) + length * load(edge_value, d + 1)
            for e in range(edges.first[i], edges.first[i + 1]):
                weight, at = load(alpha, e), edges.source[e] * row + d
                one += weight * load(projected, at)
                two += weight * load(projected, at + 1)
            store(heard, i * width + d, one)
            store(heard, i * width + d + 1, two)


@compiled
def attention_layer_backward(
    edges: Edges, layer: LayerPass, weights: LayerWeights, slope: float, to_heard: Floats, into: LayerWeights
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
    layer: LayerPass,
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
    layer: LayerPass,
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
