"""The learned driver: a trained network and a threshold as a Policy."""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from cad_env.config import check_range
from cad_env.types import Floats, Ints, Observation
from policies.fused import FusedNet, supports
from policies.stgraph import StGraphNet

_AT_ONCE = 256  # graphs in one dense pass, which bounds the memory of a large batch


class LearnedPolicy:
    """Brakes when the network's P(brake) reaches the threshold; decides each scene by itself, alone or in a batch.

    It computes in double precision, and fused where it can, which gives the same bits in any batch. Dense, the order
    of a sum depends on the size of the batch, and in single precision that could turn a decision near the threshold,
    and with it an episode.
    """

    privileged = False

    def __init__(self, network: StGraphNet, threshold: float = 0.5) -> None:
        check_range("threshold", threshold, 0.0, 1.0)
        self.threshold = threshold
        self._logits = FusedNet(network) if supports(network.config) else _DenseNet(network)
        config = network.config
        self._keys = ["tracks", "mask", "command"]
        self._keys += ["ego"] * (config.velocity or config.ego_speed) + ["kind"] * config.class_input

    def reset(self, seed: int) -> None:
        """Nothing to forget and nothing to draw: all memory is in the observation's window."""

    def act(self, observation: Observation) -> int:
        """GO or BRAKE for one observation."""
        return int(self.act_batch({key: observation[key][None] for key in self._keys})[0])

    def act_batch(self, observations: Mapping[str, NDArray[Any]]) -> Ints:
        """GO or BRAKE, (n,), for observations stacked along a new first axis."""
        return (self.brake_probability(observations) >= self.threshold).astype(np.int64)

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """P(brake), (n,), for observations stacked along a new first axis."""
        go, brake = self._logits({key: observations[key] for key in self._keys}).T
        with np.errstate(over="ignore"):
            probability: NDArray[np.float64] = 1 / (1 + np.exp(go - brake))
        return probability


class _DenseNet:
    """What `FusedNet` is, for the networks that it does not know; its last bits depend on the batch."""

    def __init__(self, network: StGraphNet) -> None:
        self._network = copy.deepcopy(network).double().eval().requires_grad_(False)

    def __call__(self, observation: Mapping[str, NDArray[Any]]) -> Floats:
        """Logits (B, 2)."""
        whole = {key: torch.tensor(value) for key, value in observation.items()}
        starts = range(0, len(whole["mask"]), _AT_ONCE)
        with torch.inference_mode():
            parts = [self._network({k: v[at : at + _AT_ONCE] for k, v in whole.items()}) for at in starts]
        return torch.cat(parts).numpy() if parts else np.empty((0, 2))
