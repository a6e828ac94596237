"""A network that is told nothing but the command: whatever it does better than a constant would have leaked.

Ours; the control that every comparison of learned drivers needs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cad_env.config import check_range
from cad_env.simulation.simulation import Simulation
from cad_env.types import COMMANDS, MOST_COMMANDS, Floats, Ints, Observation
from policies.threshold_policy import ThresholdPolicy


@dataclass(frozen=True)
class CommandConfig:
    """How wide it is."""

    width: int = 16
    commands: int = COMMANDS  # of the scenarios it drives in

    def __post_init__(self) -> None:
        check_range("network width", self.width, 1, 1024)
        check_range("network commands", self.commands, COMMANDS, MOST_COMMANDS)


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

    def forward(self, command: Tensor) -> Tensor:
        """Logits (B, 2)."""
        logits: Tensor = self.decide(command.float())
        return logits


@dataclass(frozen=True)
class CommandFrames:
    """F labelled commands."""

    label: Ints  # (F,) int8 what the expert would do
    command: Ints  # (F, C) int8

    def __len__(self) -> int:
        """F."""
        return len(self.label)

    def batch(self, frames: Ints) -> dict[str, NDArray[Any]]:
        """The commands of some frames."""
        return {"command": self.command[frames]}

    def joined(self, others: "Sequence[CommandFrames]") -> "CommandFrames":
        """These frames and then the others'."""
        parts = [self, *others]
        return CommandFrames(
            *(np.concatenate([getattr(part, name) for part in parts]) for name in ("label", "command"))
        )


class CommandDriver(ThresholdPolicy):
    """Brakes for the commands of which the network is sure enough; the same alone and in any batch."""

    def __init__(self, network: nn.Module, threshold: float) -> None:
        config: Any = network.config
        super().__init__(("command",), threshold, config.commands)
        with torch.no_grad():
            logits = network(torch.eye(config.commands))
        self._brake: Floats = torch.softmax(logits.double(), dim=1)[:, 1].numpy()  # (C,) by command

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,)."""
        self.check_commands(observations)
        brake: Floats = self._brake[observations["command"].argmax(axis=1)]
        return brake


@dataclass(frozen=True)
class CommandSpec:
    """`CommandNet` as a spec."""

    name: str = "command"
    config_type: type = CommandConfig
    kept_as: type | None = None

    def build(self, config: CommandConfig, seed: int) -> nn.Module:
        """A new network."""
        return CommandNet(config, seed)

    def environment(self, network: nn.Module) -> dict[str, Any]:
        """Nothing beside what every environment has."""
        return {}

    def replayed(self, network: nn.Module) -> dict[str, Any]:
        """The same."""
        return self.environment(network)

    def looked_with(self, config: CommandConfig) -> dict[str, Any]:
        """None."""
        return {}

    def look(self, simulation: Simulation, observation: Observation) -> Ints:
        """The command, (C,)."""
        return observation["command"]

    def frames(self, looks: Sequence[Ints], labels: Sequence[int]) -> CommandFrames:
        """All commands in one record."""
        return CommandFrames(np.array(labels, np.int8), np.array(looks, np.int8))

    def logits(self, network: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) with their gradients."""
        logits: Tensor = network(batch["command"])
        return logits

    def policy(self, network: nn.Module, threshold: float) -> CommandDriver:
        """The network as it is now."""
        return CommandDriver(network, threshold)


SPEC = CommandSpec()
