"""A network spec that reads observations as they are: what a network of one's own needs to be trained and driven.

    SPEC = ObservationSpec("my_network", MyConfig, MyNetwork)

`MyConfig` is a frozen dataclass of the network's settings, `MyNetwork(config)` a torch module whose `forward` turns a
dict of observation arrays, each a float tensor (B, ...), into logits (B, 2) of GO and BRAKE.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cad_env.simulation.simulation import Simulation
from cad_env.types import Ints, Observation
from policies.spec import LearnedPolicy, SpecDefaults
from policies.threshold_policy import DenseNet, ThresholdPolicy

_AT_ONCE = 256  # scenes in one pass


@dataclass(frozen=True)
class ObservationFrames:
    """F labelled frames: arrays of observations, stacked."""

    label: Ints  # (F,) int8 what the expert would do
    parts: dict[str, NDArray[Any]]  # name -> (F, ...)

    def __len__(self) -> int:
        """F."""
        return len(self.label)

    def batch(self, frames: Ints) -> dict[str, NDArray[Any]]:
        """The observations of some frames, stacked."""
        return {name: part[frames] for name, part in self.parts.items()}

    def joined(self, others: "Sequence[ObservationFrames]") -> "ObservationFrames":
        """These frames and then the others'."""
        every = [self, *others]
        return ObservationFrames(
            np.concatenate([frames.label for frames in every]),
            {name: np.concatenate([frames.parts[name] for frames in every]) for name in self.parts},
        )


class ObservationPolicy(ThresholdPolicy):
    """Such a network as a policy; it computes in double precision."""

    def __init__(self, network: nn.Module, keys: Sequence[str], threshold: float = 0.5) -> None:
        super().__init__(keys, threshold)
        self._logits = DenseNet(network, _AT_ONCE)

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,), for observations stacked along a new first axis."""
        logits = self._logits({key: np.asarray(observations[key], np.float64) for key in self.keys})
        probability: NDArray[np.float64] = torch.softmax(torch.from_numpy(logits), dim=1)[:, 1].numpy()
        return probability


@dataclass(frozen=True)
class ObservationSpec(SpecDefaults):
    """A kind of network that reads some arrays of an observation."""

    name: str  # in config.json of its models
    config_type: type  # the frozen dataclass of its settings
    network: Callable[[Any], nn.Module]  # from the settings; first weights are drawn from torch's seeded generator
    keys: tuple[str, ...] = ("tracks", "mask", "command", "ego")
    shares: str = "graph"  # or nothing: what is sent to it
    training: Mapping[str, Any] = field(default_factory=dict)  # of TrainingConfig, where it differs from the run's

    def build(self, config: Any, seed: int) -> nn.Module:
        """A new network; `seed` is the only source of its first weights."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            network = self.network(config)
        network.config = config
        return network

    def look(self, simulation: Simulation, observation: Observation) -> Observation:
        """What is kept of the frame that is being decided on."""
        return {key: observation[key].copy() for key in self.keys}

    def frames(self, looks: Sequence[Observation], labels: Sequence[int]) -> ObservationFrames:
        """What was looked at, with the expert's labels, as one record."""
        parts = {key: np.stack([look[key] for look in looks]) for key in self.keys}
        return ObservationFrames(np.array(labels, np.int8), parts)

    def logits(self, network: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) of GO and BRAKE with their gradients."""
        logits: Tensor = network({key: batch[key].float() for key in self.keys})
        return logits

    def policy(self, network: nn.Module, threshold: float) -> LearnedPolicy:
        """The network as it is now, as a policy that brakes when P(brake) reaches the threshold."""
        return ObservationPolicy(network, self.keys, threshold)
