"""Point Transformer layers on clouds of any size: vector attention over nearest neighbours, and transition down.

After Zhao, Jiang, Jia, Torr, Koltun: Point Transformer, ICCV 2021. The clouds of a batch lie one behind the other
(`Level`), so that no work is spent on padding and a cloud's features do not know what else is in its batch. Their
batch normalisation would break that: features are normalised by layer.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from cad_env.checks import check_numbers
from cad_env.types import Floats, Ints
from policies.layers import Linear
from policies.points.feature_codec import CENTIMETRES
from policies.points.neighbours import farthest, largest, nearest

POSITION_SCALE = 1 / 50  # 1/m, of positions as features
OFFSET_SCALE = 1 / 4  # 1/m, of the way from a point to its neighbour
SHARE = 4  # a transition down keeps one point in so many


def check_sizes(config: object, largest_allowed: Mapping[str, int], smallest: Mapping[str, int]) -> None:
    """Refuse a knob that is not a whole number from its smallest (1 where none is named) to its largest."""
    check_numbers(config, "network", {name: (smallest.get(name, 1), high) for name, high in largest_allowed.items()})


@dataclass(frozen=True)
class Level:
    """P points of B clouds, one cloud behind the other, each with its k nearest."""

    grid: Floats  # (P, 3) whole cm, in every cloud by rising x, then y, then z
    first: Ints  # (B + 1,) where each cloud begins
    near: Ints  # (P, k) rows

    def position(self, like: Tensor) -> Tensor:
        """(P, 3) m, of the type of another tensor."""
        return torch.from_numpy(self.grid).to(like.dtype) / CENTIMETRES

    def thinner(self, k: int) -> tuple["Level", Ints]:
        """One point in SHARE, spread evenly, and their rows here."""
        kept, first = farthest(self.grid, self.first, SHARE)
        return level(self.grid[kept], first, k), kept


def level(grid: Floats, first: Ints, k: int) -> Level:
    """The level of points that are in order."""
    return Level(grid, first, nearest(grid, first, k))


def sorted_points(points: NDArray[Any], mask: NDArray[Any]) -> tuple[Floats, Ints, Ints]:
    """Padded clouds, (B, M, 3) m and (B, M), as the grid and the beginnings of a `Level`, with the rows they had.

    The order is a function of each cloud as a set: x, then y, then z.
    """
    rows = np.flatnonzero(mask.reshape(-1))
    grid = np.rint(points.reshape(-1, 3)[rows].astype(np.float64) * CENTIMETRES)
    cloud = rows // max(mask.shape[1], 1)
    order = np.lexsort((grid[:, 2], grid[:, 1], grid[:, 0], cloud))
    first = np.searchsorted(cloud, np.arange(len(mask) + 1))
    return grid[order], first, rows[order]


class VectorAttention(nn.Module):
    """y_i = sum over neighbours j of softmax_j(gamma(q_i - k_j + delta_ij)) * (v_j + delta_ij), channel by channel.

    delta is a network of two layers on the way from i to j. So is gamma in the paper; the first of its linear maps is
    taken to be part of those that give q and k, which spares a product for every pair of points.
    """

    def __init__(self, width: int, rng: torch.Generator) -> None:
        super().__init__()
        self.query = Linear(width, width, rng)
        self.key_value = Linear(width, 2 * width, rng)
        self.place = nn.Sequential(Linear(3, width, rng), nn.ReLU(), Linear(width, width, rng))  # delta
        self.weigh = nn.Sequential(nn.ReLU(), Linear(width, width, rng))  # gamma

    def forward(self, x: Tensor, offset: Tensor, near: Tensor) -> Tensor:
        """Features (P, D) after one exchange; offset (P, k, 3) to the neighbours `near` (P, k)."""
        placed = self.place(offset)
        key, value = functional.embedding(near, self.key_value(x)).chunk(2, dim=-1)
        alpha = torch.softmax(self.weigh(self.query(x).unsqueeze(1) - key + placed), dim=1)
        heard: Tensor = (alpha * (value + placed)).sum(1)
        return heard


class Block(nn.Module):
    """Vector attention between two linear maps, around which the input goes past."""

    def __init__(self, width: int, rng: torch.Generator) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.enter, self.leave = Linear(width, width, rng), Linear(width, width, rng)
        self.attention = VectorAttention(width, rng)

    def forward(self, x: Tensor, offset: Tensor, near: Tensor) -> Tensor:
        """Features (P, D) after the block."""
        heard = self.attention(functional.relu(self.enter(self.norm(x))), offset, near)
        after: Tensor = x + self.leave(functional.relu(heard))
        return after


class TransitionDown(nn.Module):
    """To fewer points with wider features: each takes the largest of what its neighbourhood says."""

    def __init__(self, inputs: int, outputs: int, rng: torch.Generator) -> None:
        super().__init__()
        self.norm, self.widen = nn.LayerNorm(inputs), Linear(inputs, outputs, rng)

    def forward(self, x: Tensor, near: Tensor) -> Tensor:
        """(P, D) -> (Q, E), for the neighbours `near` (Q, k) of the points that are kept."""
        return functional.embedding(near, functional.relu(self.widen(self.norm(x)))).amax(1)


class Backbone(nn.Module):
    """From the points of clouds to features of a selection of them: a block, then `levels` times down and a block."""

    def __init__(self, width: int, k: int, levels: int, widening: int, rng: torch.Generator) -> None:
        super().__init__()
        self.k = k
        widths = [width * widening**depth for depth in range(levels + 1)]
        self.width = widths[-1]
        self.lift = nn.Sequential(Linear(3, width, rng), nn.ReLU(), Linear(width, width, rng))
        self.blocks = nn.ModuleList(Block(of, rng) for of in widths)
        self.downs = nn.ModuleList(TransitionDown(of, to, rng) for of, to in pairwise(widths))

    def forward(self, grid: Floats, first: Ints) -> tuple[Level, Tensor]:
        """The last level and its features (P, D), for points in order: grid (P, 3) cm, first (B + 1,)."""
        here = level(grid, first, self.k)
        x = self.lift(here.position(next(self.parameters())) * POSITION_SCALE)
        x = self.blocks[0](x, *self._edges(here, x))
        for down, block in zip(self.downs, self.blocks[1:], strict=True):
            below, kept = here.thinner(self.k)
            x = down(x, torch.from_numpy(here.near[kept]))
            here = below
            x = block(x, *self._edges(here, x))
        return here, x

    def _edges(self, here: Level, x: Tensor) -> tuple[Tensor, Tensor]:
        """The way to every neighbour, (P, k, 3) scaled, and the neighbours (P, k)."""
        position, near = here.position(x), torch.from_numpy(here.near)
        return (position[near] - position.unsqueeze(1)) * OFFSET_SCALE, near


def cloud_of(first: Ints) -> Tensor:
    """The number of the cloud that each point belongs to, (P,), for the beginnings (B + 1,) of the clouds."""
    return torch.from_numpy(np.repeat(np.arange(len(first) - 1), np.diff(first)))


def most(x: Tensor, group: Tensor, groups: int) -> Tensor:
    """The largest of every feature (N, D) in each of G groups (N,), (G, D); zero for a group without members."""
    row = torch.from_numpy(largest(x.detach().numpy(), group.numpy(), groups))
    if not len(x):
        return x.new_zeros(row.shape)
    empty = row[:, :1] < 0
    return x.gather(0, row.clamp_(min=0)).masked_fill(empty, 0.0) if bool(empty.any()) else x.gather(0, row)


def mean(x: Tensor, group: Tensor, groups: int) -> Tensor:
    """The mean of every feature (N, D) in each of G groups (N,), (G, D); zero for a group without members."""
    count = torch.bincount(group, minlength=groups).clamp(min=1)
    return x.new_zeros(groups, x.shape[1]).index_add(0, group, x) / count.unsqueeze(1)


def decision(inputs: int, commands: int, width: int, rng: torch.Generator) -> nn.Sequential:
    """From features (B, inputs) of the scene and the command (B, commands), side by side, to logits (B, 2)."""
    first = Linear(inputs + commands, width, rng)
    return nn.Sequential(first, nn.ReLU(), Linear(width, width, rng), nn.ReLU(), Linear(width, 2, rng))
