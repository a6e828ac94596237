"""A network of points as a policy."""

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cad_env.config import check_range
from cad_env.types import Ints, Observation

_AT_ONCE = 64  # scenes in one pass, which bounds the memory of a large batch
_KEYS = ("cloud", "cloud_mask", "command")

Decide = Callable[[Mapping[str, Tensor]], Tensor]


class CloudDriver:
    """Brakes when P(brake) reaches the threshold; decides each scene by itself, alone or in a batch.

    `network(observation)` gives the logits (B, 2) of what an environment shows. It computes in double precision: the
    order of a sum may depend on the size of the batch, and in single precision that could turn a decision.
    """

    privileged = False

    def __init__(self, network: nn.Module, threshold: float = 0.5) -> None:
        check_range("threshold", threshold, 0.0, 1.0)
        self.threshold = threshold
        self._network = copy.deepcopy(network).double().eval().requires_grad_(False)

    def reset(self, seed: int) -> None:
        """Nothing to forget and nothing to draw."""

    def act(self, observation: Observation) -> int:
        """GO or BRAKE for one observation."""
        return int(self.act_batch({key: observation[key][None] for key in _KEYS})[0])

    def act_batch(self, observations: Mapping[str, NDArray[Any]]) -> Ints:
        """GO or BRAKE, (n,), for observations stacked along a new first axis."""
        return (self.brake_probability(observations) >= self.threshold).astype(np.int64)

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,), for observations stacked along a new first axis."""
        whole = {key: torch.tensor(observations[key]) for key in _KEYS}
        starts = range(0, len(whole["command"]), _AT_ONCE)
        with torch.inference_mode():
            parts = [self._network({k: v[at : at + _AT_ONCE] for k, v in whole.items()}) for at in starts]
            logits = torch.cat(parts) if parts else torch.empty(0, 2, dtype=torch.float64)
            probability: NDArray[np.float64] = torch.softmax(logits, dim=1)[:, 1].numpy()
        return probability
