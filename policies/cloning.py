"""Behaviour cloning: balanced batches, the loss, and what a driver is worth in closed loop."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from cad_env.env import CADEnv
from cad_env.files import replace_file
from cad_env.rollout import Episode, rollouts
from cad_env.types import BRAKE, Ints
from policies.demonstrations import Frames
from policies.driver import LearnedPolicy
from policies.fused import fused_logits
from policies.saved import ModelError
from policies.stgraph import StGraphNet


@dataclass(frozen=True)
class Recipe:
    """How a network is fitted."""

    batch: int = 64  # graphs
    learning_rate: float = 5e-3  # of Adam, at the start of a round; falls to a tenth by a cosine
    brake_share: float = 0.3  # of every batch; in the recorded frames it is about a tenth


def balanced(labels: Ints, batch: int, brake_share: float, rng: np.random.Generator) -> Iterator[Ints]:
    """Endless batches of frame numbers with a fixed share of frames in which the expert brakes.

    Without it most batches say "go", and the clone learns to.
    """
    brake, go = np.flatnonzero(labels == BRAKE), np.flatnonzero(labels != BRAKE)
    if not len(brake) or not len(go):
        raise ValueError("the demonstrations must hold frames of both kinds: record more episodes")
    of_brake = round(batch * brake_share)
    while True:
        yield np.concatenate([rng.choice(brake, of_brake), rng.choice(go, batch - of_brake)])


def fit(
    network: StGraphNet,
    optimiser: torch.optim.Adam,
    frames: Frames,
    recipe: Recipe,
    steps: range,
    total: int,
    rng: np.random.Generator,
    advance: Callable[[int], object],
) -> float:
    """Take the steps numbered `steps` of a round of `total`; return their mean loss."""
    network.train()
    batches = balanced(frames.label, recipe.batch, recipe.brake_share, rng)
    losses = []
    for step in steps:
        for group in optimiser.param_groups:
            group["lr"] = recipe.learning_rate * (0.55 + 0.45 * math.cos(math.pi * step / total))
        chosen = next(batches)
        seen = {name: torch.from_numpy(value) for name, value in frames.batch(chosen).items()}
        loss = torch.nn.functional.cross_entropy(
            fused_logits(network, seen), torch.from_numpy(frames.label[chosen]).long()
        )
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
        advance(1)
    return float(np.mean(losses))


@dataclass(frozen=True)
class Worth:
    """What a driver is worth on validation episodes of its own; smaller is better, in this order."""

    failures: int  # collisions and timeouts
    time: float  # s, mean

    def __lt__(self, other: "Worth") -> bool:
        return (self.failures, self.time) < (other.failures, other.time)


def drive(
    network: StGraphNet,
    threshold: float,
    envs: Sequence[CADEnv],
    seeds: Sequence[int],
    advance: Callable[[int], object],
) -> list[Episode]:
    """Closed-loop episodes of a network."""
    episodes = []
    for episode in rollouts(envs, LearnedPolicy(network, threshold), seeds):
        episodes.append(episode)
        advance(1)
    return episodes


def worth(episodes: Sequence[Episode]) -> Worth:
    """The worth of a driver by what happened to it."""
    failures = sum(episode.outcome != "success" for episode in episodes)
    return Worth(failures, float(np.mean([episode.time for episode in episodes])))


def save_state(path: Path, network: StGraphNet, optimiser: torch.optim.Adam) -> None:
    """Keep the network and Adam's moments, so that a run goes on as if it had not stopped."""
    tensors: dict[str, Tensor] = {f"network.{name}": value for name, value in network.state_dict().items()}
    for index, state in optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{index}.{name}": value for name, value in state.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, safetensors.torch.save(tensors))


def load_state(path: Path, network: StGraphNet, optimiser: torch.optim.Adam) -> None:
    """The counterpart of `save_state`; ModelError for a file that is damaged or of another network."""
    try:
        tensors = safetensors.torch.load(path.read_bytes())
        network.load_state_dict({n.removeprefix("network."): v for n, v in tensors.items() if n.startswith("network.")})
        state: dict[int, dict[str, Tensor]] = {}
        for name, value in tensors.items():
            if name.startswith("adam."):
                _, index, key = name.split(".")
                state.setdefault(int(index), {})[key] = value
        optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
    except (SafetensorError, ValueError, KeyError, RuntimeError) as error:
        raise ModelError(
            path, f"not a checkpoint of this network ({error}): delete it to train that part anew"
        ) from None
