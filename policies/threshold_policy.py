"""The learned policy: a trained network and a threshold as a Policy."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from cad_env.checks import check_range
from cad_env.types import Floats, Ints, Observation

_CLOUDS_AT_ONCE = 64  # scenes in one pass


class ThresholdPolicy:
    """Brakes when P(brake) reaches the threshold; decides each scene by itself, alone or in a batch.

    A kind of policy says what it reads of an observation, `keys`, how sure it is, `brake_probability`, and how many
    `commands` its network reads, None if it reads none.
    """

    privileged = False

    def __init__(self, keys: Sequence[str], threshold: float, commands: int | None = None) -> None:
        self.threshold = check_range("threshold", threshold, 0.0, 1.0)
        self.keys, self.commands = tuple(keys), commands

    def reset(self, seed: int) -> None:
        """Nothing to forget and nothing to draw: all memory is in the observation."""

    def act(self, observation: Observation) -> int:
        """GO or BRAKE for one observation."""
        return int(self.act_batch({key: observation[key][None] for key in self.keys})[0])

    def act_batch(self, observations: Mapping[str, NDArray[Any]]) -> Ints:
        """GO or BRAKE, (n,), for observations stacked along a new first axis."""
        return (self.brake_probability(observations) >= self.threshold).astype(np.int64)

    def check_commands(self, observations: Mapping[str, NDArray[Any]]) -> None:
        """Refuse scenes of another number of commands than the network was made for: ValueError, one line."""
        if self.commands is not None and observations["command"].shape[-1] != self.commands:
            raise ValueError(
                f"the network was made for {self.commands} commands, "
                f"and this scenario has {observations['command'].shape[-1]}"
            )

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,), for observations stacked along a new first axis."""
        raise NotImplementedError


class DenseNet:
    """A network as it is now, for decisions only, in double precision; its last bits may depend on the batch.

    `at_once`: scenes in one pass, which bounds the memory of a large batch.
    """

    def __init__(self, network: nn.Module, at_once: int) -> None:
        self._network = copy.deepcopy(network).double().eval().requires_grad_(False)
        self._at_once = at_once

    def __call__(self, observation: Mapping[str, NDArray[Any]]) -> Floats:
        """Logits (B, 2)."""
        whole = {key: torch.tensor(value) for key, value in observation.items()}
        starts = range(0, len(whole["command"]), self._at_once)
        with torch.inference_mode():
            parts = [self._network({k: v[at : at + self._at_once] for k, v in whole.items()}) for at in starts]
        return torch.cat(parts).numpy() if parts else np.empty((0, 2))


class PointsPolicy(ThresholdPolicy):
    """A network that reads the clouds an environment shows.

    It computes in double precision: the order of a sum may depend on the size of the batch, and in single precision
    that could turn a decision.
    """

    def __init__(self, network: nn.Module, threshold: float = 0.5) -> None:
        config: Any = network.config
        super().__init__(("cloud", "cloud_mask", "command"), threshold, config.commands)
        self._logits = DenseNet(network, _CLOUDS_AT_ONCE)

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,), for observations stacked along a new first axis."""
        self.check_commands(observations)
        logits = torch.from_numpy(self._logits({key: observations[key] for key in self.keys}))
        probability: NDArray[np.float64] = torch.softmax(logits, dim=1)[:, 1].numpy()
        return probability
