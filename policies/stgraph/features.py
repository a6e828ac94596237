"""From a batch of observations to the nodes and edges of its graphs, dense and masked.

Tracks and frames make a grid, so no edge is ever listed. A *relation* sees the grid as groups: spatial edges
join the tracks of one frame, temporal edges the frames of one track. The ego is a single node at the origin, now,
joined to every node in both relations and both directions. The batch is the last axis everywhere, because groups
are tiny and graphs are many: long inner loops made training about twice as fast as small matrix products.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from cad_env.types import ROUTE_SPACING, STEP, TRUCK
from policies.stgraph.config import WAY_AHEAD, StGraphConfig

NEVER = -1e30  # as good as minus infinity in a softmax, and finite: a row without any edge has finite gradients
VELOCITY_SCALE = 1 / 10  # s/m; city speeds come out near 1
WAY_SCALE = 1 / 10  # 1/m; a turn and a swing out come out near 1
WAY_POINTS = tuple(round(ahead / ROUTE_SPACING) - 1 for ahead in WAY_AHEAD)  # of the observed route


@dataclass(frozen=True)
class Relation:
    """The edges of one kind among B graphs of G groups with I nodes each; the last of J = I + 1 sources is the ego."""

    mask: Tensor  # (I, G, B) bool, True where there is a node
    bias: Tensor  # (I, J, G, B) 0 where an edge leads from source j to target i, NEVER where none does
    edge: Tensor  # (I, J, G, B), or 1 for G and B: the attribute of the edge from j to i
    ego_bias: Tensor  # (1, I * G, 1, B) the same for the edges from every node to the ego
    ego_edge: Tensor  # (1, I * G, 1, B or 1)


@dataclass(frozen=True)
class GraphTensors:
    """B graphs, ready for attention."""

    nodes: Tensor  # (F, K, T, B) node inputs, 0 where there is no node
    ego: Tensor  # (F, 1, 1, B) inputs of the ego node
    spatial: Relation  # its groups are frames: I = K, G = T
    temporal: Relation | None  # its groups are tracks: I = T, G = K


def graph_tensors(observation: Mapping[str, Tensor], config: StGraphConfig, dtype: torch.dtype) -> GraphTensors:
    """The graphs of a batch of observations; reads `tracks`, `mask` and, where an option asks, `ego` and `kind`."""
    tracks, mask = observation["tracks"], observation["mask"] != 0
    if tracks.ndim != 4 or tracks.shape[-1] != 3 or mask.shape != tracks.shape[:-1]:
        shapes = tuple(tracks.shape), tuple(mask.shape)
        raise ValueError(f"tracks must be (B, K, T, 3) and mask (B, K, T), got {shapes[0]} and {shapes[1]}")
    if not config.temporal:
        tracks, mask = tracks[:, :, -1:], mask[:, :, -1:]
    used = _tracks_in_use(mask)
    mask = mask[:, :used].permute(1, 2, 0).contiguous()
    position = torch.where(mask, tracks[:, :used].permute(3, 1, 2, 0), 0).to(dtype)
    time = STEP * torch.arange(1 - mask.shape[1], 1, device=tracks.device, dtype=dtype)
    nodes, ego = _inputs(position, mask, time, observation, config)
    kept = slice((len(time) - 1) % config.frame_stride, None, config.frame_stride)
    nodes, position, mask, time = nodes[:, :, kept], position[:, :, kept], mask[:, kept], time[kept]
    temporal = _temporal(mask, time, config.temporal_edges) if config.temporal else None
    return GraphTensors(nodes, ego, _spatial(config.position_scale * position, mask), temporal)


def _tracks_in_use(mask: Tensor) -> int:
    """The smallest leading number of tracks that holds every node of the batch, at least 1."""
    columns = mask.any(dim=2).any(dim=0).nonzero()
    return int(columns[-1]) + 1 if len(columns) else 1


def _inputs(
    position: Tensor, mask: Tensor, time: Tensor, observation: Mapping[str, Tensor], config: StGraphConfig
) -> tuple[Tensor, Tensor]:
    """Inputs of the nodes (F, K, T, B), zero where there is none, and of the ego node (F, 1, 1, B)."""
    origin = torch.zeros_like(position[:, :1, :1])
    nodes, ego, nothing = [config.position_scale * position], [origin], origin[:1]
    if config.node_time:
        nodes.append(time[:, None].expand(1, *mask.shape))
        ego.append(nothing)
    if config.velocity:
        velocity = VELOCITY_SCALE * window_velocity(position[:2], mask, time)
        nodes.append(velocity.expand(2, *mask.shape))
        ego += [ego_speed(observation, position.dtype)[:, None, None], nothing]
    if config.class_input:
        truck = (observation["kind"][:, : len(mask)] == TRUCK).to(position.dtype)
        nodes.append(truck.T[None, :, None].expand(1, *mask.shape))
        ego.append(nothing)
    if config.ego_way:
        told = ego_way(observation, position.dtype)
        nodes.append(told[:, None, None].expand(-1, *mask.shape))
        ego.append(told[:, None, None])
    return torch.cat(nodes) * mask, torch.cat(ego)


def ego_way(observation: Mapping[str, Tensor], dtype: torch.dtype) -> Tensor:
    """The ego's speed, and how far to its left its way is at WAY_AHEAD, (EGO_WAY, B), scaled."""
    aside = WAY_SCALE * observation["route"][:, WAY_POINTS, 1].to(dtype).T
    return torch.cat([ego_speed(observation, dtype), aside])


def ego_speed(observation: Mapping[str, Tensor], dtype: torch.dtype) -> Tensor:
    """The ego's own speed (1, B), scaled."""
    return VELOCITY_SCALE * observation["ego"][:, 0].to(dtype)[None]


def window_velocity(position: Tensor, mask: Tensor, time: Tensor) -> Tensor:
    """Least-squares slope (D, K, 1, B) m/s of position (D, K, T, B) over the frames seen; 0 for fewer than two."""
    seen, when = mask.to(position.dtype), time[:, None]
    mean = (seen * when).sum(1, keepdim=True) / seen.sum(1, keepdim=True).clamp(min=1)
    lever = seen * (when - mean)
    spread = (lever * lever).sum(1, keepdim=True)
    # Two neighbouring frames spread STEP**2 / 2, so anything well below that is rounding.
    enough = spread > STEP**2 / 4
    return torch.where(enough, (lever * position).sum(2, keepdim=True) / spread.where(enough, 1.0), 0.0)


def _biases(mask: Tensor, wanted: Tensor, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """The biases of a relation, given its nodes (I, G, B) and the pairs (target, source, ...) that it joins."""
    node = torch.zeros(mask.shape, dtype=dtype, device=mask.device).masked_fill_(~mask, NEVER)
    among = node.masked_fill(~wanted, NEVER).expand(len(mask), *mask.shape)
    return pad(among, (0, 0, 0, 0, 0, 1)), node.flatten(0, 1)[None, :, None]


def _spatial(position: Tensor, mask: Tensor) -> Relation:
    """All pairs of one frame; the attribute is their distance, in units of the position scale."""
    with_ego = pad(position, (0, 0, 0, 0, 0, 1))
    apart = position.unsqueeze(2) - with_ego.unsqueeze(1)
    distance = (apart * apart).sum(0).sqrt()
    bias, ego_bias = _biases(mask, _all_pairs(mask), position.dtype)
    return Relation(mask, bias, distance, ego_bias, distance[:, -1].flatten(0, 1)[None, :, None])


def _temporal(mask: Tensor, time: Tensor, choice: str) -> Relation:
    """Pairs of one track; the attribute is the signed gap in s, the source's time minus the target's."""
    gap = pad(time, (0, 1)) - time[:, None]  # the ego is now
    frames = mask.transpose(0, 1).contiguous()
    bias, ego_bias = _biases(frames, _TEMPORAL[choice](frames), time.dtype)
    ego_gap = time.repeat_interleave(len(mask))
    return Relation(frames, bias, gap[:, :, None, None], ego_bias, ego_gap[None, :, None, None])


def _all_pairs(nodes: Tensor) -> Tensor:
    return ~torch.eye(len(nodes), dtype=torch.bool, device=nodes.device)[:, :, None, None]


def _neighbouring_sightings(nodes: Tensor) -> Tensor:
    order = nodes.cumsum(dim=0)  # by sightings and not by frames: a missed frame does not cut a track in two
    return (order.unsqueeze(0) - order.unsqueeze(1)).abs() == 1


def _from_the_past(nodes: Tensor) -> Tensor:
    sooner = torch.arange(len(nodes), device=nodes.device)
    return (sooner < sooner[:, None])[:, :, None, None]


_TEMPORAL = {"all": _all_pairs, "consecutive": _neighbouring_sightings, "causal": _from_the_past}
