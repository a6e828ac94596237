"""The graph network inside a policy of Stable-Baselines3: put in, taken out, or begun with from a clone."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from cad_env.checks import ConfigError
from cad_env.envs.scaling import scaled_observation
from cad_env.types import BRAKE, GO, Ints, Observation
from policies.layers import Linear
from policies.model_folder import SavedModel, load_model
from policies.stgraph.compiled.module import fused_embedding
from policies.stgraph.config import StGraphConfig
from policies.stgraph.network import StGraphNet

CRITIC = (32, 32)  # widths of the critic on top of the embedding


class GraphFeatures(BaseFeaturesExtractor):
    """The graph network's embedding of the scene, and the command: what its decision, and a critic, is made of.

    For `policy_kwargs` of any algorithm of the library, in environments that show what the network reads,
    `config.reads`, unscaled; `seed` draws its first weights.
    """

    def __init__(self, space: spaces.Dict, config: StGraphConfig, seed: int = 0) -> None:
        super().__init__(space, config.head_width + int(space["command"].shape[0]))  # type: ignore[index]
        self.network = StGraphNet(config, seed)
        self.network.decide = nn.Sequential()  # the actor of the library takes its place

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """(B, head_width + C)."""
        embedded = fused_embedding(self.network, observation)
        return torch.cat([embedded, observation["command"].to(embedded.dtype)], dim=1)


class SB3Policy:
    """A trained model of the library as a policy, for `rollout`, `rollouts` and `rollout_fleet`: the likelier decision.

    It is shown what its model reads, scaled if that learned from scaled observations, and decides ten times a second,
    for however long its decisions held while it learned.
    """

    privileged = False

    def __init__(self, model: BaseAlgorithm, scaled: bool = False) -> None:
        self.model, self.scaled = model, scaled
        space: Any = model.observation_space
        self.names = tuple(space)

    def reset(self, seed: int) -> None:
        """Nothing to forget: all memory is in the observation's window."""

    def act(self, observation: Observation) -> int:
        """GO or BRAKE for one observation."""
        return int(self.act_batch({name: observation[name][None] for name in self.names})[0])

    def act_batch(self, observations: Observation) -> Ints:
        """GO or BRAKE, (n,), for observations stacked along a new first axis."""
        shown = {name: observations[name] for name in self.names}
        return np.asarray(
            self.model.predict(scaled_observation(shown) if self.scaled else shown, deterministic=True)[0]
        )


class Detached(nn.Module):
    """Lets numbers through and no gradients back."""

    def forward(self, x: Tensor) -> Tensor:
        """x, of any shape."""
        return x.detach()


class Kept(nn.Module):
    """The parts of a policy of the library, each once: there its embedding has three names."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.embedding, self.heads = policy.features_extractor, policy.mlp_extractor
        self.action, self.value = policy.action_net, policy.value_net


def policy_settings(config: StGraphConfig, seed: int) -> dict[str, Any]:
    """`policy_kwargs` by which the library's actor is the graph network; `seed` draws its first weights."""
    return {
        "features_extractor_class": GraphFeatures,
        "features_extractor_kwargs": {"config": config, "seed": seed},
        "net_arch": {"pi": [config.mlp_width, config.mlp_width], "vf": list(CRITIC)},
        "activation_fn": nn.ReLU,
    }


def lean_towards_go(model: PPO, bias: float) -> None:
    """Raise the logit of GO in the actor's last layer: before it has learned anything, it goes e^bias times a brake."""
    policy: Any = model.policy
    with torch.no_grad():
        policy.action_net.bias[GO] += bias


def graph_model(folder: str | Path) -> SavedModel:
    """The model in a folder; ConfigError, one line, for one that is no graph network, FileError for a damaged one."""
    clone = load_model(folder)
    if not isinstance(clone.network, StGraphNet):
        raise ConfigError(f"a clone to begin with must be a graph network (spec stgraph), got one of {clone.spec.name}")
    return clone


def begin_with(model: PPO, clone: SavedModel) -> None:
    """Give the actor the weights of a clone, which then brakes where it is likelier than not that the clone does.

    The critic no longer moves the embedding: it begins by chance and would spoil what was learned.
    """
    policy: Any = model.policy
    network: Any = clone.network
    policy.features_extractor.network.load_state_dict(network.state_dict(), strict=False)
    for layer, own in zip(_layers_of_actor(policy), _layers_of(network), strict=True):
        layer.load_state_dict(own.state_dict())
    with torch.no_grad():
        policy.action_net.bias[BRAKE] -= math.log(clone.threshold / (1.0 - clone.threshold))
    policy.mlp_extractor.value_net.insert(0, Detached())


def freeze_actor(model: PPO, frozen: bool, embedding: bool) -> None:
    """Whether the decisions stay as they are while the critic learns; with `embedding`, that of the scene too."""
    policy: Any = model.policy
    policy.features_extractor.requires_grad_(not (frozen and embedding))
    for part in (policy.mlp_extractor.policy_net, policy.action_net):
        part.requires_grad_(not frozen)


def actor_of(model: PPO, config: StGraphConfig) -> StGraphNet:
    """The graph network with the weights of the actor."""
    policy: Any = model.policy
    network = StGraphNet(config)
    network.load_state_dict(policy.features_extractor.network.state_dict(), strict=False)
    for own, layer in zip(_layers_of(network), _layers_of_actor(policy), strict=True):
        own.load_state_dict(layer.state_dict())
    return network


def _layers_of(network: StGraphNet) -> list[nn.Module]:
    return [layer for layer in network.decide if isinstance(layer, Linear)]


def _layers_of_actor(policy: Any) -> list[nn.Module]:
    return [*(layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, nn.Linear)), policy.action_net]
