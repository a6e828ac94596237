"""Reinforcement learning from scratch: PPO of Stable-Baselines3 on the observations and decisions of the others.

Schulman, Wolski, Dhariwal, Radford and Klimov, "Proximal policy optimization algorithms", 2017. The actor is the
paper's network, so what is saved is a model as any other; the critic, a small network on the same embedding, is
forgotten. The reward is the environment's own. Training goes in parts of `PART` decisions: a killed run resumes
after the last one it finished. Each part draws its random numbers from (seed, part), so stopping changes nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import set_random_seed
from torch import Tensor, nn

from cad_env.checks import check_numbers, check_path, check_seed, check_several, check_whole
from cad_env.config import radio_config
from cad_env.scenarios import SHIPPED, scenario_named
from policies.layers import Linear
from policies.model_folder import SavedModel, load_model, save_model
from policies.spec import fitting
from policies.stgraph.compiled.module import fused_embedding
from policies.stgraph.network import StGraphConfig, StGraphNet
from policies.training.cloning import load_state, save_state
from policies.training.config import small_seed
from policies.training.sb3_env import Scenes

SCENES_AT_ONCE, ROLLOUT = 48, 64  # scenes at once, and decisions in each of them between two updates
PART = 8 * SCENES_AT_ONCE * ROLLOUT  # decisions between two checkpoints
CRITIC = (32, 32)  # widths of the critic on top of the embedding


@dataclass(frozen=True)
class PpoConfig:
    """How the network learns; the numbers are customary ones, and the horizon is some seconds at ten decisions each."""

    radio: str = "dsrc"  # none: without sharing
    learning_rate: float = 1e-3
    discount: float = 0.99
    advantage: float = 0.95  # lambda of generalised advantage estimation
    clip: float = 0.2
    entropy: float = 0.005
    epochs: int = 4
    batch: int = 512
    network: StGraphConfig = field(default_factory=StGraphConfig)

    def __post_init__(self) -> None:
        radio_config(self.radio)
        limits = {
            "learning_rate": (1e-7, 1.0), "discount": (0.0, 1.0), "advantage": (0.0, 1.0), "clip": (0.0, 1.0),
            "entropy": (0.0, 1.0), "epochs": (1, 100), "batch": (2, SCENES_AT_ONCE * ROLLOUT),
        }  # fmt: skip
        check_numbers(self, "", limits)


class Embedding(BaseFeaturesExtractor):
    """The paper's embedding of the scene and the command: what its decision, and here the critic too, is made of."""

    def __init__(self, space: spaces.Dict, config: StGraphConfig, seed: int) -> None:
        super().__init__(space, config.head_width + int(space["command"].shape[0]))  # type: ignore[index]
        self.network = StGraphNet(config, seed)
        self.network.decide = nn.Sequential()  # the actor of the library takes its place

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """(B, head_width + C)."""
        embedded = fused_embedding(self.network, observation)
        return torch.cat([embedded, observation["command"].to(embedded.dtype)], dim=1)


def train_ppo(
    folder: str | Path,
    steps: int,
    seed: int = 0,
    scenarios: Sequence[str] = SHIPPED,
    advance: Callable[[float], object] = lambda done: None,
    config: PpoConfig | None = None,
) -> None:
    """Learn from `steps` decisions, rounded up to whole parts, of scenes of all scenarios; save a model in `folder`.

    Resumes where it stopped; `advance` is told of decisions as they are done.
    """
    config = config or PpoConfig()
    folder, steps, seed = check_path("folder", folder), check_whole("steps", steps, 1, 10**9), check_seed("seed", seed)
    scenarios = check_several("scenarios", scenarios, lambda _, name: scenario_named(name).name)
    config = replace(config, network=fitting(config.network, scenarios))
    parts = -(-steps // PART)
    if (folder / "config.json").exists():
        load_model(folder)
        advance(parts * PART)
        return
    torch.set_num_threads(1)
    model = _learner(Scenes(SCENES_AT_ONCE, tuple(scenarios), config.radio, config.network), config, seed)
    for part in range(parts):
        checkpoint = folder / "checkpoints" / f"part_{part}.safetensors"
        if checkpoint.exists():
            if not (folder / "checkpoints" / f"part_{part + 1}.safetensors").exists():
                load_state(checkpoint, _Kept(model.policy), model.policy.optimizer)  # type: ignore[arg-type]
        else:
            _learn(model, seed, part)
            save_state(checkpoint, _Kept(model.policy), model.policy.optimizer)  # type: ignore[arg-type]
        advance(PART)
    notes = {"ppo": asdict(config), "decisions": parts * PART, "seed": seed, "scenarios": list(scenarios)}
    save_model(folder, SavedModel(actor_of(model, config.network), 0.5, notes))


def _learner(scenes: Scenes, config: PpoConfig, seed: int) -> PPO:
    """The algorithm around a new network, of which `seed` draws the first weights."""
    set_random_seed(small_seed(seed))
    wide = config.network.mlp_width
    return PPO(
        "MultiInputPolicy", scenes, learning_rate=config.learning_rate, n_steps=ROLLOUT, batch_size=config.batch,
        n_epochs=config.epochs, gamma=config.discount, gae_lambda=config.advantage, clip_range=config.clip,
        ent_coef=config.entropy, device="cpu",
        policy_kwargs={
            "features_extractor_class": Embedding,
            "features_extractor_kwargs": {"config": config.network, "seed": small_seed(seed)},
            "net_arch": {"pi": [wide, wide], "vf": list(CRITIC)},
            "activation_fn": nn.ReLU,
        },
    )  # fmt: skip


class _Kept(nn.Module):
    """The parts of a policy of the library, each once: there its embedding has three names."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.embedding, self.heads = policy.features_extractor, policy.mlp_extractor
        self.action, self.value = policy.action_net, policy.value_net


def _learn(model: PPO, seed: int, part: int) -> None:
    """One part, on episodes of its own."""
    set_random_seed(small_seed(seed + 1_000_003 * part))  # the library draws from global chance
    scenes = model.get_env()
    assert scenes is not None
    scenes.seed(seed + 1_000_003 * part)
    model.set_env(scenes, force_reset=True)
    model.learn(PART, reset_num_timesteps=False)


def actor_of(model: PPO, config: StGraphConfig) -> StGraphNet:
    """The paper's network with the weights of the actor."""
    policy: Any = model.policy
    network = StGraphNet(config)
    network.load_state_dict(policy.features_extractor.network.state_dict(), strict=False)
    learned = [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, nn.Linear)]
    own = [layer for layer in network.decide if isinstance(layer, Linear)]
    for to, layer in zip(own, [*learned, policy.action_net], strict=True):
        to.load_state_dict(layer.state_dict())
    return network
