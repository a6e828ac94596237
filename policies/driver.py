"""The learned driver: a trained network and a threshold as a Policy."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from cad_env.config import check_range
from cad_env.types import Ints, Observation
from policies.saved import load_model
from policies.stgraph import StGraphNet

_AT_ONCE = 256  # graphs in one pass, which bounds the memory of a large batch


class LearnedPolicy:
    """Brakes when the network's P(brake) reaches the threshold; decides each scene by itself, alone or in a batch.

    It computes in double precision: how a sum is ordered depends on the size of the batch, and in single precision
    that could turn a decision near the threshold, and with it an episode.
    """

    privileged = False

    def __init__(self, network: StGraphNet, threshold: float = 0.5) -> None:
        check_range("threshold", threshold, 0.0, 1.0)
        self.threshold = threshold
        self._network = copy.deepcopy(network).double().eval().requires_grad_(False)
        config = network.config
        self._keys = ["tracks", "mask", "command"]
        self._keys += ["ego"] * (config.velocity or config.ego_speed) + ["kind"] * config.class_input

    @classmethod
    def load(cls, folder: str | Path) -> "LearnedPolicy":
        """The driver in a model folder; raises policies.saved.ModelError when the folder is damaged."""
        model = load_model(folder)
        return cls(model.network, model.threshold)

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
        whole = {key: torch.tensor(observations[key]) for key in self._keys}
        starts = range(0, len(whole["mask"]), _AT_ONCE)
        with torch.inference_mode():
            parts = [self._probability({k: v[start : start + _AT_ONCE] for k, v in whole.items()}) for start in starts]
        return np.concatenate(parts) if parts else np.empty(0)

    def _probability(self, observations: dict[str, torch.Tensor]) -> NDArray[np.float64]:
        go, brake = self._network(observations).unbind(1)
        probability: NDArray[np.float64] = torch.sigmoid(brake - go).numpy()
        return probability
