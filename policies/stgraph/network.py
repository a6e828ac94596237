"""The paper's heterogeneous spatiotemporal graph attention network, dense.

Attention runs over the tracks of a frame (spatial) and over the frames of a track (temporal). Both scores split
into target + source + edge terms, a^T [W h_i || W h_j || W_e e_ij] = a_t^T W h_i + a_s^T W h_j + (a_e^T W_e) e_ij,
so an edge costs one number a head and never a vector.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from policies.layers import Linear, glorot_parameter
from policies.stgraph.config import StGraphConfig
from policies.stgraph.features import Relation, ego_speed, graph_tensors
from policies.stgraph.lanes import LaneAttention, lane_nodes

__all__ = ["StGraphConfig", "StGraphNet"]


class _WeightedSum(torch.autograd.Function):
    """out[h, d, i] = sum over j of alpha[h, i, j] value[h, d, j], for alpha (H, I, J, ...) and value (H, D, J, ...).

    One scratch array serves all D: as plain products each would map, fault in and return megabytes of memory.
    """

    @staticmethod
    def forward(ctx: Any, alpha: Tensor, value: Tensor) -> Tensor:
        ctx.save_for_backward(alpha, value)
        heads, targets, _, *rest = alpha.shape
        scratch, out = torch.empty_like(alpha), value.new_empty(heads, value.shape[1], targets, *rest)
        for d in range(value.shape[1]):
            torch.mul(alpha, value[:, d].unsqueeze(1), out=scratch)
            torch.sum(scratch, 2, out=out[:, d])
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor]:
        alpha, value = ctx.saved_tensors
        to_alpha, to_value, scratch = torch.zeros_like(alpha), torch.empty_like(value), torch.empty_like(alpha)
        for d in range(value.shape[1]):
            arrived = grad[:, d].unsqueeze(2)
            to_alpha.addcmul_(arrived, value[:, d].unsqueeze(1))
            torch.mul(alpha, arrived, out=scratch)
            torch.sum(scratch, 1, out=to_value[:, d])
        return to_alpha, to_value


class RelationLayer(nn.Module):
    r"""One graph attention layer over the edges of one relation, H heads of D numbers: Eqs. (2) and (3) of the paper.

    The heads are those of graph attention networks (Velickovic et al., ICLR 2018, https://arxiv.org/abs/1710.10903)
    with edge attributes, as in `torch_geometric.nn.GATConv(edge_dim=1)`. For a target :math:`i` with sources
    :math:`N(i)`,

    .. math::
        \alpha_{ij} = \mathrm{softmax}_{j \in N(i)} \left( \mathrm{LeakyReLU} \left(
            \mathbf{a}^{\top} [\mathbf{W} \mathbf{h}_i \, \Vert \, \mathbf{W} \mathbf{h}_j \, \Vert \,
            \mathbf{W}_e e_{ij}] \right) \right)

        \mathbf{h}'_i = \mathrm{ReLU} \left( \mathbf{W} \mathbf{h}_i + \sum_{j \in N(i)} \alpha_{ij}
            (\mathbf{W} \mathbf{h}_j + \mathbf{W}_e e_{ij}) \right)

    Unlike in GATConv, the target's own term is added outside of the attention, in place of a self-loop, and a source's
    message holds the edge's attribute. Without `edge_attributes` the terms with :math:`e_{ij}` are left out.

    Shapes: nodes (F, I, G, B) and ego (F, 1, 1, B) to (H * D, I, G, B) and (H * D, 1, 1, B) where heads are
    concatenated, and to (D, ...) where they are averaged.
    """

    def __init__(self, inputs: int, config: StGraphConfig, concatenate: bool, rng: torch.Generator) -> None:
        super().__init__()
        heads, width = config.heads, config.head_width
        self.concatenate, self.slope, self.attributes = concatenate, config.attn_slope, config.edge_attributes
        self.weight = glorot_parameter(rng, inputs, heads * width, heads * width, inputs)  # W
        self.attend_target = glorot_parameter(rng, width, 1, heads, width)  # a, in its three parts
        self.attend_source = glorot_parameter(rng, width, 1, heads, width)
        if self.attributes:
            self.edge_weight = glorot_parameter(rng, 1, heads * width, heads, width)  # W_e
            self.attend_edge = glorot_parameter(rng, width, 1, heads, width)

    def forward(self, grid: Tensor, ego: Tensor, relation: Relation) -> tuple[Tensor, Tensor]:
        """Embeddings of the nodes (F, I, G, B) and of the ego (F, 1, 1, B) after one exchange along the edges."""
        own, target, source = self._project(grid)
        ego_own, ego_target, ego_source = self._project(ego)
        values = torch.cat([own, ego_own.expand(-1, -1, -1, grid.shape[2], -1)], dim=2)
        sources = torch.cat([source, ego_source.expand(-1, -1, grid.shape[2], -1)], dim=1)
        heard = self._attend(target, sources, values, relation.edge, relation.bias)
        # The ego hears all groups at once: to it they are one group of I * G nodes.
        everyone, their_values = source.flatten(1, 2).unsqueeze(2), own.flatten(2, 3).unsqueeze(3)
        ego_heard = self._attend(ego_target, everyone, their_values, relation.ego_edge, relation.ego_bias)
        ego_heard = ego_heard * relation.mask.any(dim=0).any(dim=0)  # an empty scene says nothing
        return self._join(own + heard), self._join(ego_own + ego_heard)

    def _project(self, nodes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """W h as (H, D, I, G, B), and its target and source scores (H, I, G, B)."""
        own = (self.weight @ nodes.flatten(1)).view(*self.attend_target.shape, *nodes.shape[1:])
        by_head = own.flatten(2)
        target, source = (
            (attend.unsqueeze(1) @ by_head).view(len(attend), *nodes.shape[1:])
            for attend in (self.attend_target, self.attend_source)
        )
        return own, target, source

    def _attend(self, target: Tensor, source: Tensor, value: Tensor, edge: Tensor, bias: Tensor) -> Tensor:
        """What each of I targets hears from J sources, (H, D, I, G, B)."""
        score = target.unsqueeze(2) + source.unsqueeze(1)
        if self.attributes:
            score = score + edge * (self.attend_edge * self.edge_weight).sum(1)[:, None, None, None, None]
        alpha = torch.softmax(functional.leaky_relu(score, self.slope) + bias, dim=2)
        heard: Tensor = _WeightedSum.apply(alpha, value)  # type: ignore[no-untyped-call]
        if self.attributes:
            heard = heard + (alpha * edge).sum(2).unsqueeze(1) * self.edge_weight[:, :, None, None, None]
        return heard

    def _join(self, heads: Tensor) -> Tensor:
        """The heads (H, D, I, G, B) side by side, (H * D, I, G, B), or their mean (D, I, G, B) in the last layer."""
        return functional.relu(heads.flatten(0, 1) if self.concatenate else heads.mean(dim=0))


class Importance(nn.Module):
    r"""How much a relation :math:`r` matters to a graph of N nodes: Eq. (4), with the same weights for both relations.

    .. math::
        w_r = \frac{1}{N} \sum_{i=1}^{N} \mathbf{q}^{\top} \tanh(\mathbf{W}_b \mathbf{h}^r_i + \mathbf{b}),
        \qquad \beta_r = \mathrm{softmax}_r(w_r)

    The nodes' new embeddings are :math:`\sum_r \beta_r \mathbf{h}^r_i`, Eq. (5): the semantic attention of HAN (Wang et
    al., WWW 2019, https://arxiv.org/abs/1903.07293), but for each graph by itself.
    """

    def __init__(self, width: int, rng: torch.Generator) -> None:
        super().__init__()
        self.weight = glorot_parameter(rng, width, width, width, width)  # W_b
        self.bias = nn.Parameter(torch.zeros(width))  # b
        self.query = glorot_parameter(rng, width, 1, width)  # q

    def forward(self, grid: Tensor, ego: Tensor, mask: Tensor) -> Tensor:
        """The mean over the nodes of each graph, ego included, and over no other graph of the batch: (B,)."""
        total = (self._of(grid) * mask).sum(dim=(0, 1)) + self._of(ego)[0, 0]
        return total / (mask.sum(dim=(0, 1)) + 1)

    def _of(self, nodes: Tensor) -> Tensor:
        score = self.query @ torch.tanh(self.weight @ nodes.flatten(1) + self.bias[:, None])
        return score.view(nodes.shape[1:])


class StGraphNet(nn.Module):
    """From a batch of observations to the logits (B, 2) of GO and BRAKE.

    Index 0 is GO and 1 is BRAKE, as everywhere in this project; the paper lists p1 = brake first.
    `seed` is the only source of the first weights.

    >>> sum(parameter.numel() for parameter in StGraphNet().parameters())
    2722
    """

    def __init__(self, config: StGraphConfig | None = None, seed: int = 0) -> None:
        super().__init__()
        self.config = config = config or StGraphConfig()
        rng = torch.Generator().manual_seed(seed)
        joined, wide = config.heads * config.head_width, config.mlp_width
        self.project = Linear(config.node_inputs, config.hidden, rng)  # W_v; with [x, y, z, 1] it is 4 x 12
        self.relations = ("spatial", "temporal") if config.temporal else ("spatial",)
        self.layers = nn.ModuleDict()
        for depth in range(config.layers):
            inputs, inner = joined if depth else config.hidden, depth < config.layers - 1
            for name in self.relations:
                self.layers[f"{name}_{depth}"] = RelationLayer(inputs, config, inner, rng)
        self.importance = nn.ModuleDict()
        if config.temporal:
            if config.fusion == "per_layer":
                for depth in range(config.layers - 1):
                    self.importance[str(depth)] = Importance(joined, rng)
            self.importance[str(config.layers - 1)] = Importance(config.head_width, rng)
        inputs = config.head_width + config.commands + config.ego_speed
        if config.coverage:
            self.lanes = LaneAttention(config, rng)
            inputs += joined
        self.decide = nn.Sequential(
            Linear(inputs, wide, rng), nn.ReLU(), Linear(wide, wide, rng), nn.ReLU(), Linear(wide, 2, rng)
        )

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) for `tracks` (B, K, T, 3) m, `mask` (B, K, T), `command` (B, C); options read more."""
        return self.decided(self.embed(observation), observation)

    def decided(self, embedded: Tensor, observation: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) by what `embed` gives, (B, D), and what is told beside the graph."""
        told = [embedded, observation["command"].to(embedded.dtype)]
        if self.config.ego_speed:
            told.append(ego_speed(observation, embedded.dtype).T)
        if self.config.coverage:
            told.append(self.lanes(embedded, lane_nodes(observation, embedded.dtype)))
        logits: Tensor = self.decide(torch.cat(told, dim=1))
        return functional.relu(logits) if self.config.relu_logits else logits

    def embed(self, observation: Mapping[str, Tensor]) -> Tensor:
        """The embedding h'_ego (B, head_width) of the scene around the ego: Eq. (6)."""
        seen = graph_tensors(observation, self.config, self.project.weight.dtype)
        edges = {"spatial": seen.spatial} | ({"temporal": seen.temporal} if seen.temporal else {})
        grids, egos = self._part(self._lift(seen.nodes), self._lift(seen.ego))
        for depth in range(self.config.layers):
            for name in self.relations:
                grids[name], egos[name] = self.layers[f"{name}_{depth}"](grids[name], egos[name], edges[name])
            if str(depth) in self.importance:
                weigh = self.importance[str(depth)]
                scores = torch.stack([weigh(grids[name], egos[name], edges[name].mask) for name in self.relations])
                grids, egos = self._part(*_fuse(torch.softmax(scores, dim=0), grids, egos))
        return egos["spatial"][:, 0, 0].T  # after the last fusion it is the same in both relations

    def _lift(self, nodes: Tensor) -> Tensor:
        """h = W_v v: Eq. (1)."""
        lifted = torch.addmm(self.project.bias[:, None], self.project.weight, nodes.flatten(1))
        return lifted.view(-1, *nodes.shape[1:])

    def _part(self, grid: Tensor, ego: Tensor) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """The same nodes (F, K, T, B) and ego for each relation, the nodes grouped as it sees them."""
        groups = {"spatial": grid, "temporal": grid.transpose(1, 2)}
        return {name: groups[name] for name in self.relations}, dict.fromkeys(self.relations, ego)


def _fuse(beta: Tensor, grids: dict[str, Tensor], egos: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Nodes (F, K, T, B) and ego (F, 1, 1, B) of both relations, weighed by their importances (2, B)."""
    nodes = beta[0] * grids["spatial"] + beta[1] * grids["temporal"].transpose(1, 2)
    return nodes, beta[0] * egos["spatial"] + beta[1] * egos["temporal"]
