"""The same network a second time, as PyTorch Geometric message passing over explicit edge lists.

It shares nothing with the dense network but the names of its weights. Nodes and edges are listed one by one, in
plain loops, from numpy observations; a batch is one large disconnected graph.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch_geometric.data import Batch, HeteroData
from torch_geometric.nn import MessagePassing
from torch_geometric.utils import scatter, softmax

from cad_env.pipeline.observe_lanes import LANE_FEATURES
from cad_env.world.drivers import COMMANDED_BRAKING
from policies.stgraph.network import StGraphConfig

STEP = 0.1
SPATIAL, TEMPORAL = ("object", "near", "object"), ("object", "later", "object")


@dataclass
class Node:
    track: int  # -1 for the ego
    frame: int
    position: np.ndarray  # (3,) m
    time: float


def to_hetero_data(tracks, mask, command, ego, kind, route, lanes, lane_mask, config: StGraphConfig) -> HeteroData:
    """One observation as a PyG graph; its first node is the ego."""
    frames = mask.shape[1]
    first = 0 if config.temporal else frames - 1
    nodes = [Node(-1, -1, np.zeros(3), 0.0)]
    for k, t in zip(*np.nonzero(mask), strict=True):
        if t >= first:
            nodes.append(Node(int(k), int(t), tracks[k, t].astype(float), STEP * (int(t) - frames + 1)))
    every, stride = nodes, config.frame_stride
    nodes = [node for node in every if node.track == -1 or (frames - 1 - node.frame) % stride == 0]
    data = HeteroData()
    data["object"].x = torch.tensor(np.array([_inputs(node, every, ego, kind, route, config) for node in nodes]))
    data["object"].is_ego = torch.tensor([node.track == -1 for node in nodes])
    data.command = torch.tensor(np.array([command], dtype=float))
    if config.coverage:
        _add_lanes(data, lanes[lane_mask == 1].astype(float), ego.astype(float))
    data.speed = torch.tensor([[float(ego[0]) / 10]], dtype=torch.float64)
    for relation, joined, attribute in ((SPATIAL, _joined_in_space, _distance), (TEMPORAL, _joined_in_time, _gap)):
        pairs = [
            (s, t)
            for s, source in enumerate(nodes)
            for t, target in enumerate(nodes)
            if s != t and (0 in (s, t) or joined(source, target, nodes, config))
        ]
        data[relation].edge_index = torch.tensor(pairs, dtype=torch.int64).reshape(-1, 2).T
        values = [attribute(nodes[s], nodes[t], config) for s, t in pairs]
        data[relation].edge_attr = torch.tensor(values, dtype=torch.float64).reshape(-1, 1)
    return data


def _add_lanes(data: HeteroData, lanes: np.ndarray, ego: np.ndarray) -> None:
    """A lane and a phantom for every lane that is there, and their edges to the ego."""
    rows = [_lane_inputs(dict(zip(LANE_FEATURES, lane, strict=True)), ego[0], ego[1]) for lane in lanes]
    for kind, name in enumerate(("lane", "phantom")):
        inputs = [row[kind] for row in rows]
        data[name].x = torch.tensor(np.array(inputs).reshape(len(rows), (11, 10)[kind]))
        data[name].edge = torch.tensor([row[2 + kind] for row in rows], dtype=torch.float64)


def _lane_inputs(of: dict[str, float], speed: float, target: float) -> tuple[list[float], list[float], float, float]:
    past, target, left, now = 0.0, max(target, speed, 1.0), max(of["through"], 0.0), speed
    to_target = (target**2 - now**2) / 4.0  # at 2 m/s2
    if left < to_target:
        past = (np.sqrt(now**2 + 4.0 * left) - now) / 2.0
    else:
        past = (target - now) / 2.0 + (left - to_target) / target
    spare = float(np.clip((of["time"] - past) / 2, -2, 2))
    brake = float(np.clip((of["reach"] - 0.2 * now - now**2 / (2 * COMMANDED_BRAKING)) / 5, -3, 3))
    lane = [of["x"] / 50, of["y"] / 50, of["cos"], of["sin"], of["reach"] / 20, of["through"] / 20, brake,
            min(past, 10) / 5, min(of["age"], 2.0), of["speed"] / 10, now / 10]  # fmt: skip
    phantom = [of["phantom_x"] / 50, of["phantom_y"] / 50, of["phantom_cos"], of["phantom_sin"],
               float(np.clip(of["hidden"], -20, 100)) / 50, float(of["hidden"] < 200), of["time"] / 5, spare,
               of["speed"] / 10, now / 10]  # fmt: skip
    return lane, phantom, of["reach"] / 20, spare


def _distance(source: Node, target: Node, config: StGraphConfig) -> float:
    return config.position_scale * float(np.linalg.norm(source.position - target.position))


def _gap(source: Node, target: Node, config: StGraphConfig) -> float:
    return source.time - target.time


def _inputs(node: Node, nodes: list[Node], ego, kind, route, config: StGraphConfig) -> list[float]:
    inputs = list(config.position_scale * node.position)
    if config.node_time:
        inputs.append(node.time)
    if config.velocity:
        inputs += [float(ego[0]) / 10, 0.0] if node.track == -1 else list(_slope(node, nodes) / 10)
    if config.class_input:
        inputs.append(0.0 if node.track == -1 else float(kind[node.track] == 1))
    if config.ego_way:
        inputs += [float(ego[0]) / 10, *(float(route[ahead // 2 - 1, 1]) / 10 for ahead in (10, 20, 30, 45))]
    return inputs


def _slope(node: Node, nodes: list[Node]) -> np.ndarray:
    same = [other for other in nodes if other.track == node.track]
    if len(same) < 2:
        return np.zeros(2)
    return np.polyfit([other.time for other in same], [other.position[:2] for other in same], 1)[0]


def _joined_in_space(source: Node, target: Node, nodes: list[Node], config: StGraphConfig) -> bool:
    return source.frame == target.frame


def _joined_in_time(source: Node, target: Node, nodes: list[Node], config: StGraphConfig) -> bool:
    if source.track != target.track:
        return False
    if config.temporal_edges == "causal":
        return source.frame < target.frame
    if config.temporal_edges == "consecutive":
        low, high = sorted((source.frame, target.frame))
        return not any(other.track == source.track and low < other.frame < high for other in nodes)
    return True


class TwinLayer(MessagePassing):
    def __init__(self, inputs: int, config: StGraphConfig, concatenate: bool) -> None:
        super().__init__(aggr="add", node_dim=0)
        heads, width = config.heads, config.head_width
        self.config, self.concatenate = config, concatenate
        self.weight = nn.Parameter(torch.empty(heads * width, inputs))
        self.attend_target = nn.Parameter(torch.empty(heads, width))
        self.attend_source = nn.Parameter(torch.empty(heads, width))
        if config.edge_attributes:
            self.edge_weight = nn.Parameter(torch.empty(heads, width))
            self.attend_edge = nn.Parameter(torch.empty(heads, width))

    def forward(self, x: Tensor, edge_index: Tensor, edge_attr: Tensor) -> Tensor:
        own = (x @ self.weight.T).view(len(x), self.config.heads, self.config.head_width)
        joined = own + self.propagate(edge_index, own=own, edge_attr=edge_attr)
        return torch.relu(joined.flatten(1) if self.concatenate else joined.mean(dim=1))

    def message(self, own_i: Tensor, own_j: Tensor, edge_attr: Tensor, index: Tensor, size_i: int) -> Tensor:
        if not self.config.edge_attributes:
            whole, parts, said = [own_i, own_j], [self.attend_target, self.attend_source], own_j
        else:
            edge = edge_attr.unsqueeze(-1) * self.edge_weight
            whole, said = [own_i, own_j, edge], own_j + edge
            parts = [self.attend_target, self.attend_source, self.attend_edge]
        score = (torch.cat(whole, dim=-1) * torch.cat(parts, dim=-1)).sum(-1)
        alpha = softmax(torch.where(score > 0, score, self.config.attn_slope * score), index, num_nodes=size_i)
        return alpha.unsqueeze(-1) * said


class TwinImportance(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(width, width))
        self.bias = nn.Parameter(torch.empty(width))
        self.query = nn.Parameter(torch.empty(width))

    def forward(self, x: Tensor, batch: Tensor) -> Tensor:
        return scatter(torch.tanh(x @ self.weight.T + self.bias) @ self.query, batch, reduce="mean")


class TwinLanes(MessagePassing):
    """The lanes and phantoms of a batch, each a row with the number of its scene."""

    def __init__(self, config: StGraphConfig) -> None:
        super().__init__(aggr="add", node_dim=0)
        heads, width, inner = config.heads, config.head_width, config.hidden
        self.config = config
        self.lane, self.phantom, self.meet = nn.Linear(11, inner), nn.Linear(10, inner), nn.Linear(2 * inner, inner)
        self.weight = nn.Parameter(torch.empty(heads * width, width))
        self.lane_weight = nn.Parameter(torch.empty(heads * width, inner))
        self.phantom_weight = nn.Parameter(torch.empty(heads * width, inner))
        self.edge_weight = nn.Parameter(torch.empty(2, heads, width))
        self.attend_target = nn.Parameter(torch.empty(heads, width))
        self.attend_source = nn.Parameter(torch.empty(2, heads, width))
        self.attend_edge = nn.Parameter(torch.empty(2, heads, width))

    def forward(self, ego: Tensor, data: Batch) -> Tensor:
        shape, scene = (-1, self.config.heads, self.config.head_width), data["lane"].batch
        phantom = torch.relu(self.phantom(data["phantom"].x.to(ego.dtype)))
        lane = torch.relu(self.lane(data["lane"].x.to(ego.dtype)))
        lane = torch.relu(self.meet(torch.cat([lane, phantom], dim=1)))
        said = torch.cat([(lane @ self.lane_weight.T).view(shape), (phantom @ self.phantom_weight.T).view(shape)])
        kind = torch.arange(2).repeat_interleave(len(scene))
        length = torch.cat([data["lane"].edge, data["phantom"].edge]).to(ego.dtype)
        own = (ego @ self.weight.T).view(shape)
        edges = torch.stack([torch.arange(len(said)), scene.repeat(2)])
        heard = self.propagate(edges, own=(said, own), kind=kind, length=length, size=(len(said), len(own)))
        return torch.relu(own + heard).flatten(1)

    def message(self, own_i, own_j, kind: Tensor, length: Tensor, index: Tensor, size_i: int) -> Tensor:
        edge = length[:, None, None] * self.edge_weight[kind]
        score = (own_i * self.attend_target + own_j * self.attend_source[kind] + edge * self.attend_edge[kind]).sum(-1)
        alpha = softmax(torch.where(score > 0, score, self.config.attn_slope * score), index, num_nodes=size_i)
        return alpha.unsqueeze(-1) * (own_j + edge)


class PygTwin(nn.Module):
    """Takes the state dict of a StGraphNet of the same configuration."""

    def __init__(self, config: StGraphConfig) -> None:
        super().__init__()
        self.config = config
        self.relations = {"spatial": SPATIAL} | ({"temporal": TEMPORAL} if config.temporal else {})
        joined, last = config.heads * config.head_width, config.layers - 1
        self.project = nn.Linear(config.node_inputs, config.hidden)
        self.layers, self.importance = nn.ModuleDict(), nn.ModuleDict()
        for depth in range(config.layers):
            for name in self.relations:
                layer = TwinLayer(joined if depth else config.hidden, config, concatenate=depth < last)
                self.layers[f"{name}_{depth}"] = layer
            if config.temporal and (depth == last or config.fusion == "per_layer"):
                self.importance[str(depth)] = TwinImportance(config.head_width if depth == last else joined)
        wide = config.mlp_width
        told = config.head_width + 6 + config.ego_speed
        if config.coverage:
            self.lanes = TwinLanes(config)
            told += joined
        self.decide = nn.Sequential(
            nn.Linear(told, wide), nn.ReLU(), nn.Linear(wide, wide), nn.ReLU(), nn.Linear(wide, 2)
        )

    def forward(self, graphs: list[HeteroData]) -> Tensor:
        data = Batch.from_data_list(graphs)
        batch = data["object"].batch
        states = dict.fromkeys(self.relations, self.project(data["object"].x.to(self.project.weight.dtype)))
        for depth in range(self.config.layers):
            for name, relation in self.relations.items():
                edges = data[relation]
                layer = self.layers[f"{name}_{depth}"]
                states[name] = layer(states[name], edges.edge_index, edges.edge_attr.to(states[name].dtype))
            if str(depth) in self.importance:
                weigh = self.importance[str(depth)]
                beta = torch.softmax(torch.stack([weigh(state, batch) for state in states.values()]), dim=0)
                fused = sum(b[batch].unsqueeze(-1) * state for b, state in zip(beta, states.values(), strict=True))
                states = dict.fromkeys(states, fused)
        told = [states["spatial"][data["object"].is_ego], data.command]
        if self.config.ego_speed:
            told.append(data.speed)
        if self.config.coverage:
            told.append(self.lanes(told[0], data))
        logits = self.decide(torch.cat([part.to(self.project.weight.dtype) for part in told], dim=-1))
        return torch.relu(logits) if self.config.relu_logits else logits
