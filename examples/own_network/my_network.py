"""A network from outside: DeepSets over the tracks of an observation (Zaheer et al., NeurIPS 2017).

cad-train --method my_network:SPEC --out runs/my_network
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

try:  # from the wheel, or from the repository
    from cad_learning.policies.observation_spec import ObservationSpec
except ImportError:
    from policies.observation_spec import ObservationSpec


@dataclass(frozen=True)
class DeepSetsConfig:
    """Its settings, kept in config.json beside the weights."""

    width: int = 32
    frames: int = 15


class DeepSets(nn.Module):
    """rho(max over tracks i of phi(x_i), command, speed); x_i holds a track's positions and which of them are known."""

    def __init__(self, config: DeepSetsConfig) -> None:
        super().__init__()
        wide = config.width
        self.phi = nn.Sequential(nn.Linear(4 * config.frames, wide), nn.ReLU(), nn.Linear(wide, wide), nn.ReLU())
        self.rho = nn.Sequential(nn.Linear(wide + 10, wide), nn.ReLU(), nn.Linear(wide, 2))

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) for `tracks` (B, K, T, 3) m, `mask` (B, K, T), `command` (B, 6) and `ego` (B, 4)."""
        mask = observation["mask"]
        nodes = torch.cat([observation["tracks"] / 50.0, mask[..., None]], dim=3) * mask[..., None]
        known = mask.any(dim=2)[..., None].to(nodes.dtype)
        scene = (self.phi(nodes.flatten(2)) * known).amax(dim=1)
        logits: Tensor = self.rho(torch.cat([scene, observation["command"], observation["ego"] / 10.0], dim=1))
        return logits


SPEC = ObservationSpec("deep_sets", DeepSetsConfig, DeepSets)


def wide(width: int = 64) -> ObservationSpec:
    """The same with another default: `--method "my_network:wide(width=128)"`."""
    return ObservationSpec(f"deep_sets_{width}", DeepSetsConfig, lambda config: DeepSets(DeepSetsConfig(width)))
