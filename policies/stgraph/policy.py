"""The paper's network as a policy."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from policies.stgraph.compiled.module import FusedNet, supports
from policies.stgraph.network import StGraphNet
from policies.threshold_policy import DenseNet, ThresholdPolicy

_AT_ONCE = 256  # graphs in one dense pass, which bounds the memory of a large batch


class StGraphPolicy(ThresholdPolicy):
    """The paper's network as a policy.

    It computes in double precision, and fused where it can, which gives the same bits in any batch. Dense, the order
    of a sum depends on the size of the batch, and in single precision that could turn a decision near the threshold,
    and with it an episode.
    """

    def __init__(self, network: StGraphNet, threshold: float = 0.5) -> None:
        config = network.config
        super().__init__(config.reads, threshold, config.commands)
        self._logits = FusedNet(network) if supports(config) else DenseNet(network, _AT_ONCE)

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,), for observations stacked along a new first axis."""
        self.check_commands(observations)
        go, brake = self._logits({key: observations[key] for key in self.keys}).T
        with np.errstate(over="ignore"):
            probability: NDArray[np.float64] = 1 / (1 + np.exp(go - brake))
        return probability
