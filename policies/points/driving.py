"""A network of points as a policy."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from policies.threshold_policy import DenseNet, ThresholdDriver

_AT_ONCE = 64  # scenes in one pass


class CloudDriver(ThresholdDriver):
    """A network that reads the clouds an environment shows.

    It computes in double precision: the order of a sum may depend on the size of the batch, and in single precision
    that could turn a decision.
    """

    def __init__(self, network: nn.Module, threshold: float = 0.5) -> None:
        super().__init__(("cloud", "cloud_mask", "command"), threshold)
        self._logits = DenseNet(network, _AT_ONCE)

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,), for observations stacked along a new first axis."""
        logits = torch.from_numpy(self._logits({key: observations[key] for key in self.keys}))
        probability: NDArray[np.float64] = torch.softmax(logits, dim=1)[:, 1].numpy()
        return probability
