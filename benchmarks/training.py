"""How many graphs a second one core trains on: the fused network, the dense one and a message-passing twin.

The same network, weights and recorded scenes for all; a step is forward, backward and Adam. The twin, by PyTorch
Geometric, is that of the tests; its graphs are built off the clock, because ours are arrays as the environment gives
them.
"""

import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stages import FOUR
from torch import Tensor, nn

from cad_env.envs.vector import CADVectorEnv
from cad_env.rules.expert import Expert
from cad_env.scenarios import SCENARIOS
from cad_env.scoring.rollout import rollouts
from policies.stgraph.compiled.module import fused_logits
from policies.stgraph.network import StGraphConfig, StGraphNet

BATCH, EPISODES, STEPS, TWIN_STEPS = 96, 16, 20, 4
KEYS = ("tracks", "mask", "command", "ego", "kind")

Figures = dict[str, float]
Seen = dict[str, Tensor]


class Training:
    """Batches of scenes that the expert drove through, and every network to be trained on them."""

    def __init__(self) -> None:
        torch.set_num_threads(1)
        self.recorded = {name: _recorded(name) for name in SCENARIOS}
        mixed = {key: torch.cat([seen[key] for seen in self.recorded.values()]) for key in KEYS}
        self._twin_batches = _twin_batches(mixed)
        self._mixed = mixed

    def measured(self, seed: int) -> Figures:
        """Graphs a second of CPU time, once."""
        chance = np.random.default_rng(seed)
        figures = {}
        for name, seen in self.recorded.items():
            batches = [_chosen(seen, chance) for _ in range(STEPS)]
            figures[f"training, fused, {name} (graphs/s)"] = _rate(StGraphNet(), fused_logits, batches)
        batches = [_chosen(self._mixed, chance) for _ in range(STEPS)]
        fused = _rate(StGraphNet(), fused_logits, batches)
        figures["training, fused, all scenes (graphs/s)"] = fused
        dense = _rate(StGraphNet(), lambda network, seen: network(seen), batches[:TWIN_STEPS])
        figures["training, dense, all scenes (graphs/s)"] = dense
        if self._twin_batches:
            twin = _rate(_twin(), lambda network, graphs: network(graphs), self._twin_batches)
            figures["training, PyG twin, all scenes (graphs/s)"] = twin
            figures["training, fused over PyG twin"] = fused / twin
        return figures


def _recorded(scenario: str) -> Seen:
    """What the ego saw in some episodes of the expert, every fifth frame."""
    seen: list[dict[str, Any]] = []
    envs = CADVectorEnv(EPISODES, scenario=scenario, ranges=FOUR)
    for _ in rollouts(envs, Expert(), range(EPISODES), watch=lambda _, observation, __: seen.append(observation)):
        pass
    return {key: torch.from_numpy(np.stack([one[key] for one in seen[::5]])) for key in KEYS}


def _chosen(seen: Seen, chance: np.random.Generator) -> Seen:
    which = torch.from_numpy(chance.integers(len(seen["mask"]), size=BATCH))
    return {key: part[which] for key, part in seen.items()}


def _rate(network: nn.Module, logits: Callable[[Any, Any], Tensor], batches: list[Any]) -> float:
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    label = torch.arange(BATCH) % 2
    _step(optimiser, logits(network, batches[0]), label)  # whatever happens once
    start = time.process_time()
    for batch in batches:
        _step(optimiser, logits(network, batch), label)
    return BATCH * len(batches) / (time.process_time() - start)


def _step(optimiser: torch.optim.Optimizer, logits: Tensor, label: Tensor) -> None:
    loss = nn.functional.cross_entropy(logits, label)
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()


def _twin_batches(seen: Seen) -> list[Any]:
    if find_spec("torch_geometric") is None:
        return []
    sys.path.append(str(Path(__file__).resolve().parent.parent / "tests"))
    from pyg_twin import to_hetero_data

    chance = np.random.default_rng(0)
    batches = [_chosen(seen, chance) for _ in range(TWIN_STEPS)]
    config = StGraphConfig()
    return [
        [to_hetero_data(*(batch[key][k].numpy() for key in KEYS), config=config) for k in range(BATCH)]
        for batch in batches
    ]


def _twin() -> nn.Module:
    from pyg_twin import PygTwin

    twin = PygTwin(StGraphConfig())
    twin.load_state_dict(StGraphNet().state_dict())
    return twin
