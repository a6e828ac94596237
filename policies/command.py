"""A network that reads nothing but the command: the control that every comparison of learned policies needs.

Whatever it does better than a constant decision, the command gives away.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cad_env.checks import check_numbers
from cad_env.types import COMMANDS, MOST_COMMANDS, Floats
from policies.observation_spec import ObservationSpec
from policies.threshold_policy import ThresholdPolicy


@dataclass(frozen=True)
class CommandConfig:
    """How wide it is."""

    width: int = 16
    commands: int = COMMANDS  # of the scenarios it drives in

    def __post_init__(self) -> None:
        check_numbers(self, "network", {"width": (1, 1024), "commands": (COMMANDS, MOST_COMMANDS)})


class CommandNet(nn.Module):
    """From commands (B, C) to the logits (B, 2) of GO and BRAKE; `seed` is the only source of the first weights."""

    def __init__(self, config: CommandConfig, seed: int) -> None:
        super().__init__()
        self.config = config
        rng = torch.Generator().manual_seed(seed)
        self.decide = nn.Sequential(nn.Linear(config.commands, config.width), nn.ReLU(), nn.Linear(config.width, 2))
        with torch.no_grad():
            for weights in self.parameters():
                bound = 1 / weights.shape[-1] ** 0.5
                weights.uniform_(-bound, bound, generator=rng)

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2)."""
        logits: Tensor = self.decide(observation["command"].float())
        return logits


class CommandPolicy(ThresholdPolicy):
    """Brakes for the commands of which the network is sure enough; the same alone and in any batch."""

    def __init__(self, network: nn.Module, threshold: float) -> None:
        config: Any = network.config
        super().__init__(("command",), threshold, config.commands)
        with torch.no_grad():
            logits = network({"command": torch.eye(config.commands)})
        self._brake: Floats = torch.softmax(logits.double(), dim=1)[:, 1].numpy()  # (C,) by command

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,)."""
        self.check_commands(observations)
        brake: Floats = self._brake[observations["command"].argmax(axis=1)]
        return brake


@dataclass(frozen=True)
class CommandSpec(ObservationSpec):
    """`CommandNet` as a spec."""

    def build(self, config: CommandConfig, seed: int) -> nn.Module:
        """A new network."""
        return CommandNet(config, seed)

    def policy(self, network: nn.Module, threshold: float) -> CommandPolicy:
        """The network as it is now."""
        return CommandPolicy(network, threshold)


SPEC = CommandSpec("command", CommandConfig, lambda config: CommandNet(config, 0), ("command",))
