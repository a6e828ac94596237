"""Behaviour cloning: balanced batches, the loss, and what a policy is worth in closed loop."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from cad_env.envs.vector import CADVectorEnv
from cad_env.files import MOST_DATA_BYTES, FileError, read_file, replace_file
from cad_env.scoring.rollout import Episode, rollouts
from cad_env.types import BRAKE, Ints, Policy
from policies.spec import Frames, NetworkSpec
from policies.training.config import TrainingConfig

LOSS = "loss"  # in a checkpoint, beside the tensors of the network and of Adam
_NETWORK, _ADAM = "network.", "adam."  # what their names begin with
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of each parameter
NEEDLESS_COST = 0.1  # failures that a needless brake is as bad as


def balanced(labels: Mapping[str, Ints], config: TrainingConfig, rng: np.random.Generator) -> Iterator[dict[str, Ints]]:
    """Endless batches of frame numbers: equally many of every cell, a fixed share of them with the expert braking.

    In most frames the expert goes, so without the share the network would learn to go always; without the balance it
    would learn mostly from the scenario with long episodes. The batch is rounded to a multiple of the scenarios.
    """
    of_brake, of_go = config.frames_of_each(len(labels))
    kinds = {name: (np.flatnonzero(of == BRAKE), np.flatnonzero(of != BRAKE)) for name, of in labels.items()}
    for name, (brake, go) in kinds.items():
        if not len(brake) or not len(go):
            raise ValueError(f"the demonstrations of {name} must hold frames of both kinds: record more episodes")
    while True:
        yield {
            name: np.concatenate([rng.choice(brake, of_brake), rng.choice(go, of_go)])
            for name, (brake, go) in kinds.items()
        }


def fit(
    spec: NetworkSpec,
    network: nn.Module,
    optimiser: torch.optim.Adam,
    frames: Mapping[str, Frames],
    config: TrainingConfig,
    steps: range,
    total: int,
    rng: np.random.Generator,
    advance: Callable[[int], object],
) -> float:
    """Take the steps numbered `steps` of a run of `total` on the frames of every scenario; return their mean loss.

    One cosine spans all rounds: a rate that rises again in every round costs precision that is never regained.
    """
    network.train()
    batches = balanced({name: of.label for name, of in frames.items()}, config, rng)
    losses = []
    for step in steps:
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * (0.51 + 0.49 * math.cos(math.pi * step / total))
        seen, label = _gathered(frames, next(batches))
        loss = torch.nn.functional.cross_entropy(spec.logits(network, seen), label)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
        advance(1)
    return float(np.mean(losses))


def _gathered(frames: Mapping[str, Frames], chosen: Mapping[str, Ints]) -> tuple[dict[str, Tensor], Tensor]:
    """The observations of the chosen frames of every scenario, in one batch, and their labels."""
    parts = [frames[name].batch(numbers) for name, numbers in chosen.items()]
    seen = {name: torch.from_numpy(np.concatenate([part[name] for part in parts])) for name in parts[0]}
    label = np.concatenate([frames[name].label[numbers] for name, numbers in chosen.items()])
    return seen, torch.from_numpy(label).long()


@dataclass(frozen=True)
class Worth:
    """What a policy is worth on validation episodes of its own; less is better.

    Under several conditions the worst of them counts first, and there the collisions: where nobody can know whether the
    road is free, waiting until the time is up is no failure of the policy, and a mean would hide what it risks.

    A needless brake counts a tenth of a failure. By failures alone, the best would be a policy that brakes in every
    episode, or one that was lucky once in hundreds; by time alone, a reckless one.
    """

    failures: int  # collisions and timeouts
    needless: float  # episodes without a hazard in which it braked
    time: float  # s, mean; of two that cost the same the faster
    worst: int = 0  # collisions in the worst scenario and condition; 0 where there is one condition

    @property
    def cost(self) -> float:
        """In failures."""
        return self.failures + NEEDLESS_COST * self.needless

    def __lt__(self, other: "Worth") -> bool:
        return (self.worst, self.cost, self.time) < (other.worst, other.cost, other.time)


def drive_episodes(
    policy: Policy, envs: CADVectorEnv, seeds: Sequence[int], advance: Callable[[int], object]
) -> list[Episode]:
    """Closed-loop episodes of a network."""
    episodes = []
    for episode in rollouts(envs, policy, seeds):
        episodes.append(episode)
        advance(1)
    return episodes


def save_state(path: Path, network: nn.Module, optimiser: torch.optim.Adam, loss: float = math.nan) -> None:
    """Keep the network, Adam's moments and the last loss, so that a run resumes as if it had not stopped."""
    tensors: dict[str, Tensor] = {f"{_NETWORK}{name}": value for name, value in network.state_dict().items()}
    tensors[LOSS] = torch.tensor(loss, dtype=torch.float64)
    for index, state in optimiser.state_dict()["state"].items():
        tensors |= {f"{_ADAM}{index}.{name}": value for name, value in state.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, safetensors.torch.save(tensors))


def load_state(path: Path, network: nn.Module, optimiser: torch.optim.Adam) -> float:
    """The counterpart of `save_state`, gives the loss; FileError for a file that is damaged or of another network."""
    data = read_file(path, MOST_DATA_BYTES)
    try:
        tensors = safetensors.torch.load(data)
        loss = tensors.pop(LOSS, torch.empty(0))
        if loss.shape != ():
            raise ValueError(f"{LOSS} must be one number")
        state = _adam_state(tensors, optimiser)
        network.load_state_dict({name.removeprefix(_NETWORK): value for name, value in tensors.items()})
        optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
        return float(loss)
    except (SafetensorError, ValueError, KeyError, RuntimeError, TypeError) as error:
        raise FileError(
            path, f"not a checkpoint of this network ({error}): delete it to train that part anew"
        ) from None


def _adam_state(tensors: dict[str, Tensor], optimiser: torch.optim.Adam) -> dict[int, dict[str, Tensor]]:
    """Adam's moments by the number of the parameter, taken out of the tensors; ValueError for any that do not fit.

    A parameter that has had no gradient yet has none.
    """
    parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
    found: dict[int, dict[str, Tensor]] = {}
    for name in [name for name in tensors if name.startswith(_ADAM)]:
        index, _, key = name.removeprefix(_ADAM).partition(".")
        if not index.isdecimal() or int(index) >= len(parameters) or key not in _MOMENTS:
            raise ValueError(f"{name} is nothing of this optimiser")
        value, like = tensors.pop(name), torch.tensor(0.0) if key == "step" else parameters[int(index)]
        if (value.shape, value.dtype) != (like.shape, like.dtype):
            raise ValueError(f"{name} must be {like.dtype} of shape {tuple(like.shape)}")
        found.setdefault(int(index), {})[key] = value
    if not found:
        raise ValueError("it holds nothing of the optimiser")
    if lacking := [index for index, moments in found.items() if len(moments) < len(_MOMENTS)]:
        raise ValueError(f"{_ADAM}{lacking[0]} must have {', '.join(_MOMENTS)}")
    return found
