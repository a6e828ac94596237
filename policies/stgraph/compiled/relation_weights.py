"""How much each relation matters to a scene, and what the ego has heard in the end: Eqs. (4) to (6)."""

from typing import NamedTuple

import numpy as np

from cad_env.numerics.jit import compiled, compiled_part
from cad_env.types import Floats, Ints
from policies.stgraph.compiled.attention import HEADS, exponentials, multiply


class Matter(NamedTuple):
    """What tells how much a relation matters; or, of the same shapes, the gradient of it."""

    weight: Floats  # (D, D) W_b
    bias: Floats  # (D,) b
    query: Floats  # (D,) q


class Judged(NamedTuple):
    """What a relation comes to, as its gradient needs it."""

    last: Floats  # (N, D) the last embeddings of the nodes
    squashed: Floats  # (N, D) tanh(W_b h + b)
    importance: Floats  # (B,)


@compiled
def judge(start: Ints, heard: Floats, matter: Matter) -> Judged:
    """The heads averaged and clipped at 0, and the mean of q^T tanh(W_b h + b) over each graph, ego included."""
    last = np.empty((heard.shape[0], heard.shape[1] // HEADS))
    for i in range(last.shape[0]):
        for d in range(last.shape[1]):
            total = 0.0
            for h in range(HEADS):
                total += heard[i, HEADS * d + h]
            last[i, d] = max(total / HEADS, 0.0)
    squashed = multiply(last, matter.weight.T.copy())
    _squash(squashed, matter.bias)
    importance = np.zeros(len(start) - 1)
    for b in range(len(importance)):
        for i in range(start[b], start[b + 1]):
            for d in range(last.shape[1]):
                importance[b] += matter.query[d] * squashed[i, d]
        importance[b] /= start[b + 1] - start[b]
    return Judged(last, squashed, importance)


@compiled_part
def _squash(x: Floats, bias: Floats) -> None:
    """Replace x (N, D) by tanh(x + bias)."""
    falling = np.empty((x.shape[0], x.shape[1]))
    for i in range(x.shape[0]):
        for d in range(x.shape[1]):
            x[i, d] += bias[d]
            falling[i, d] = -2 * abs(x[i, d])
    exponentials(falling.reshape(-1))
    for i in range(x.shape[0]):
        for d in range(x.shape[1]):
            x[i, d] = np.copysign((1 - falling[i, d]) / (1 + falling[i, d]), x[i, d])


@compiled
def unjudge(start: Ints, judged: Judged, matter: Matter, to_importance: Floats, to_ego: Floats, into: Matter) -> Floats:
    """The gradient by what was heard (N, L), given those by the importance (B,) and by the ego's embedding (B, D)."""
    last, squashed = judged.last, judged.squashed
    D = last.shape[1]
    to_heard, to_sum = np.empty((last.shape[0], HEADS * D)), np.empty(D)
    for b in range(len(to_importance)):
        each = to_importance[b] / (start[b + 1] - start[b])
        for i in range(start[b], start[b + 1]):
            for d in range(D):
                to_sum[d] = each * matter.query[d] * (1 - squashed[i, d] * squashed[i, d])
                into.query[d] += each * squashed[i, d]
                into.bias[d] += to_sum[d]
                for c in range(D):
                    into.weight[d, c] += to_sum[d] * last[i, c]
            for c in range(D):
                to_last = to_ego[b, c] if i == start[b + 1] - 1 else 0.0
                for d in range(D):
                    to_last += to_sum[d] * matter.weight[d, c]
                for h in range(HEADS):
                    to_heard[i, HEADS * c + h] = to_last / HEADS if last[i, c] > 0 else 0.0
    return to_heard
