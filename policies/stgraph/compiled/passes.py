"""The fused network forward and backward through the batch: the order in which the compiled loops follow each other."""

from typing import NamedTuple

import numpy as np

from cad_env.types import Floats, Ints
from policies.stgraph.compiled.attention import (
    Edges,
    LayerPass,
    LayerWeights,
    attention_layer,
    attention_layer_backward,
    multiply,
)
from policies.stgraph.compiled.edges import SPATIAL, TEMPORAL, NodeList, Singles, list_graph
from policies.stgraph.compiled.relation_weights import Judged, Matter, judge, unjudge
from policies.stgraph.config import StGraphConfig


class GraphBatch(NamedTuple):
    """What the network sees of B observations."""

    tracks: Singles  # (B, K, T, 3) m
    mask: Ints  # (B, K, T) int8
    ego: Singles  # (B, 4) the first is the speed, m/s
    told: Floats  # (B, W) what every node is told: W is 0 without `ego_way`


class Weights(NamedTuple):
    """All that leads to the embedding of a scene; or, of the same shapes, the gradient of it."""

    layers: tuple[tuple[LayerWeights, LayerWeights], ...]  # two of each relation
    matter: Matter


class RelationPass(NamedTuple):
    """What happened along the edges of one kind."""

    nodes: NodeList
    edges: Edges
    first: LayerPass
    second: LayerPass
    judged: Judged

    @property
    def ego(self) -> Floats:
        """The last embeddings (B, D) of the egos."""
        rows: Floats = self.judged.last[self.nodes.start[1:] - 1]
        return rows


class Pass(NamedTuple):
    """What happened on the way forward."""

    spatial: RelationPass
    temporal: RelationPass
    share: Floats  # (B, 1) of the spatial relation in the embedding
    embedding: Floats  # (B, D) h'_ego: Eq. (6)


def forward(batch: GraphBatch, config: StGraphConfig, weights: Weights) -> Pass:
    """Two exchanges along each kind of edges, and the fusion of what the ego has heard: Eqs. (1) to (6)."""
    kinds = zip((SPATIAL, TEMPORAL), weights.layers, strict=True)
    spatial, temporal = (_relate(batch, kind, config, layers, weights.matter) for kind, layers in kinds)
    with np.errstate(over="ignore"):
        share = 1 / (1 + np.exp(temporal.judged.importance - spatial.judged.importance))[:, None]
    return Pass(spatial, temporal, share, share * spatial.ego + (1 - share) * temporal.ego)


def _relate(
    batch: GraphBatch, kind: int, config: StGraphConfig, layers: tuple[LayerWeights, LayerWeights], matter: Matter
) -> RelationPass:
    nodes, edges = list_graph(*batch, kind, config.position_scale, config.velocity, config.frame_stride)
    first = attention_layer(edges, nodes.inputs, layers[0], config.attn_slope)
    second = attention_layer(edges, np.maximum(first.heard, 0), layers[1], config.attn_slope)
    return RelationPass(nodes, edges, first, second, judge(nodes.start, second.heard, matter))


def backward(done: Pass, slopes: Floats, config: StGraphConfig, weights: Weights, into: Weights) -> None:
    """Add to `into` the gradient of sum(slopes * embedding), slopes (B, D)."""
    share = done.share
    to_spatial = (slopes * (done.spatial.ego - done.temporal.ego) * share * (1 - share)).sum(axis=1)
    for relation, sign, part, layers, into_layers in zip(
        done[:2], (1, -1), (share, 1 - share), weights.layers, into.layers, strict=True
    ):
        start, judged = relation.nodes.start, relation.judged
        to_heard = unjudge(start, judged, weights.matter, sign * to_spatial, part * slopes, into.matter)
        _unrelate(relation, to_heard, config.attn_slope, layers, into_layers)


def _unrelate(
    done: RelationPass,
    to_heard: Floats,
    slope: float,
    layers: tuple[LayerWeights, LayerWeights],
    into: tuple[LayerWeights, LayerWeights],
) -> None:
    to_projected = attention_layer_backward(done.edges, done.second, layers[1], slope, to_heard, into[1])
    to_inner = multiply(to_projected, np.ascontiguousarray(layers[1].project.T))
    to_inner *= done.second.inputs > 0
    attention_layer_backward(done.edges, done.first, layers[0], slope, to_inner, into[0])
