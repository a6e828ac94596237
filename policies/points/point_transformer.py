"""Raw data sharing: all points of all vehicles in the ego's frame, read by a Point Transformer.

After Zhao et al., ICCV 2021 (`points`), as the paper uses it: the merged cloud, thinned, then global pooling and a
decision with the command. The paper thins to 4,096 points; what fits a CPU, and is the default here, is 512 points,
8 neighbours and 16 channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cad_env.lidar.config import CloudConfig
from cad_env.lidar.points import RawPoints
from cad_env.simulation.simulation import Simulation
from cad_env.types import COMMANDS, MOST_COMMANDS, Ints, Observation
from policies.points.frames import CloudFrames, Seen, packed_frames, seen
from policies.points.layers import Backbone, check_sizes, cloud_of, decision, mean, most, sorted_points
from policies.spec import SpecDefaults
from policies.threshold_policy import PointsPolicy

_SIZES = {"merged": 65_536, "neighbours": 64, "width": 256, "levels": 5, "mlp_width": 1024,
          "commands": MOST_COMMANDS}  # fmt: skip


@dataclass(frozen=True)
class PointTransformerConfig:
    """The knobs of the network; `PAPER_SIZE` are those of the paper.

    >>> PointTransformerConfig(neighbours=0)
    Traceback (most recent call last):
    cad_env.checks.ConfigError: network neighbours must be a whole number from 1 to 64, got 0
    """

    merged: int = 512  # points of the merged cloud at most
    neighbours: int = 8  # of a point, itself included
    width: int = 16  # channels at the first level; twice as many at every next one
    levels: int = 2  # transitions down, each to a quarter of the points
    mlp_width: int = 32
    commands: int = COMMANDS  # of the scenarios it drives in

    def __post_init__(self) -> None:
        check_sizes(self, _SIZES, {"levels": 0, "commands": COMMANDS})


PAPER_SIZE = PointTransformerConfig(merged=4096, neighbours=16, width=32, levels=4)


class PointTransformerNet(nn.Module):
    """From clouds in the ego's frame to the logits (B, 2) of GO and BRAKE; `seed` gives the first weights.

    >>> sum(parameter.numel() for parameter in PointTransformerNet().parameters()) < 100_000
    True
    """

    def __init__(self, config: PointTransformerConfig | None = None, seed: int = 0) -> None:
        super().__init__()
        self.config = config = config or PointTransformerConfig()
        rng = torch.Generator().manual_seed(seed)
        self.backbone = Backbone(config.width, config.neighbours, config.levels, 2, rng)
        self.decide = decision(2 * self.backbone.width, config.commands, config.mlp_width, rng)

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) for `cloud` (B, M, 3) m, `cloud_mask` (B, M) and `command` (B, 6)."""
        cloud, mask = observation["cloud"].numpy(), observation["cloud_mask"].numpy()
        here, x = self.backbone(*sorted_points(cloud, mask)[:2])
        of, clouds = cloud_of(here.first), len(mask)
        told = [most(x, of, clouds), mean(x, of, clouds), observation["command"].to(x.dtype)]
        logits: Tensor = self.decide(torch.cat(told, dim=1))
        return logits


class MergedFrames(CloudFrames):
    """Frames of one cloud each, the merged one in the ego's frame."""

    def batch(self, frames: Ints) -> dict[str, NDArray[Any]]:
        """As an observation has them: `cloud` (B, M, 3) m, `cloud_mask` (B, M), `command` (B, 6), `ego` (B, 4)."""
        parts = super().batch(frames)
        cloud, mask = parts["clouds"][:, 0], parts["clouds_mask"][:, 0]
        return {"cloud": cloud, "cloud_mask": mask, "command": parts["command"], "ego": parts["ego"]}


@dataclass(frozen=True)
class PointTransformerSpec(SpecDefaults):
    """The Point Transformer on what the environment merges from raw points.

    A frame keeps that merged cloud as it was observed, so training sees what driving does, whatever the radio: where
    every message is refused, the ego's own points.
    """

    name: str = "point_transformer"
    config_type: type = PointTransformerConfig
    kept_as: type | None = MergedFrames

    def build(self, config: PointTransformerConfig, seed: int) -> nn.Module:
        """A new network."""
        return PointTransformerNet(config, seed)

    def environment(self, network: nn.Module) -> dict[str, Any]:
        """Raw points, merged to as many as the network reads."""
        assert isinstance(network, PointTransformerNet)
        return {"cloud": CloudConfig(codec=RawPoints(), merged=network.config.merged)}

    def looked_with(self, config: PointTransformerConfig) -> dict[str, Any]:
        """How many points are merged."""
        return {"merged": config.merged}

    def look(self, simulation: Simulation, observation: Observation) -> Seen:
        """The merged cloud."""
        cloud = observation["cloud"]
        return seen([cloud[observation["cloud_mask"] > 0]], np.zeros((1, 3)), len(cloud), observation)

    def frames(self, looks: Sequence[Seen], labels: Sequence[int]) -> MergedFrames:
        """All merged clouds in one record."""
        return MergedFrames(**packed_frames(looks, labels, vehicles=1))

    def logits(self, network: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Of the network itself."""
        logits: Tensor = network(batch)
        return logits

    def policy(self, network: nn.Module, threshold: float) -> PointsPolicy:
        """The network as it is now."""
        return PointsPolicy(network, threshold)


SPEC = POINT_TRANSFORMER = PointTransformerSpec()
