"""`policies.stgraph.lanes.LaneAttention` for decisions, in double precision and every scene by itself."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from cad_env.types import Bools, Floats
from policies.stgraph.compiled.attention import multiply
from policies.stgraph.features import NEVER
from policies.stgraph.lanes import LaneAttention, lane_nodes


class _Heard(NamedTuple):
    """What the nodes of one type say to the ego."""

    value: Floats  # (B, L, H, D)
    score: Floats  # (B, L, H)


class FusedLanes:
    """A LaneAttention as it is now; its numbers are the same, bit for bit, in any batch."""

    def __init__(self, network: LaneAttention) -> None:
        self._slope = network.slope
        with torch.no_grad():
            self._weights = {name: part.double().numpy().copy() for name, part in network.named_parameters()}
        self._transposed = {name: part.T.copy() for name, part in self._weights.items() if part.ndim == 2}

    def __call__(self, embedding: Floats, observation: Mapping[str, NDArray[Any]]) -> Floats:
        """(B, H * D) for the embedding (B, D)."""
        read = {key: torch.from_numpy(np.ascontiguousarray(observation[key])) for key in ("lanes", "lane_mask", "ego")}
        lane, phantom, distance, spare, mask = (part.numpy() for part in lane_nodes(read, torch.float64))
        phantoms = self._lifted("phantom", phantom)
        lanes = self._lifted("meet", np.concatenate([self._lifted("lane", lane), phantoms], axis=-1))
        heads, width = self._weights["attend_target"].shape
        own = multiply(embedding, self._transposed["weight"]).reshape(-1, heads, width)
        target = _sum_last(own * self._weights["attend_target"])[:, None]
        parts = self._said(0, lanes, distance), self._said(1, phantoms, spare)
        score = target + np.concatenate([part.score for part in parts], axis=1)
        alpha = _softmax(np.where(score > 0, score, self._slope * score), np.concatenate([mask, mask], axis=1))
        value, heard = np.concatenate([part.value for part in parts], axis=1), own.copy()
        for k in range(value.shape[1]):
            heard += alpha[:, k, :, None] * value[:, k]
        found: Floats = np.maximum(heard, 0).reshape(len(heard), -1)
        return found

    def _lifted(self, name: str, nodes: Floats) -> Floats:
        rows = multiply(nodes.reshape(-1, nodes.shape[-1]), self._transposed[f"{name}.weight"])
        lifted: Floats = np.maximum(rows + self._weights[f"{name}.bias"], 0).reshape(*nodes.shape[:-1], -1)
        return lifted

    def _said(self, kind: int, hidden: Floats, edge: Floats) -> _Heard:
        weight = self._transposed[("lane_weight", "phantom_weight")[kind]]
        heads, width = self._weights["attend_target"].shape
        projected = multiply(hidden.reshape(-1, hidden.shape[-1]), weight).reshape(*edge.shape, heads, width)
        length = edge[..., None, None] * self._weights["edge_weight"][kind]
        attend = self._weights["attend_source"][kind], self._weights["attend_edge"][kind]
        return _Heard(projected + length, _sum_last(projected * attend[0]) + _sum_last(length * attend[1]))


def _sum_last(x: Floats) -> Floats:
    """The sum over the last axis, one after another: numpy's own order depends on the shape."""
    total: Floats = x[..., 0].copy()
    for d in range(1, x.shape[-1]):
        total += x[..., d]
    return total


def _softmax(score: Floats, exists: Bools) -> Floats:
    """(B, N, H) over N; all zero in a scene without nodes."""
    score = np.where(exists[..., None], score, NEVER)
    weight = np.exp(score - score.max(axis=1, keepdims=True)) * exists[..., None]
    total = np.zeros_like(weight[:, 0])
    for k in range(weight.shape[1]):
        total += weight[:, k]
    share: Floats = weight / np.where(total > 0, total, 1.0)[:, None]
    return share
