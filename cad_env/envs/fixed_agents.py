"""For libraries that want the same agents from the first step to the last: SuperSuit's vector environments, and RLlib
and TorchRL where the number of connected vehicles varies."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pettingzoo.utils.wrappers import BaseParallelWrapper

from cad_env.envs.parallel import CADParallelEnv, Infos, Step
from cad_env.numerics.record_array import CopiedWhole
from cad_env.types import Observation

WHOLE = 2**24  # float32 holds whole numbers exactly up to here


class FixedAgents(CopiedWhole, BaseParallelWrapper[str, Observation, int]):
    """Every possible agent stays until the last one is done, and all end in the same step.

    Whoever has left, or is not in this scene, sees zeros, earns nothing, and its actions are ignored. This stands in
    for SuperSuit's `black_death`, which takes no Dict observations. In the last step everybody is truncated if time is
    up, and whoever has ended by itself, or was never there, is terminated.

    Infos have the same keys for everybody. `present` is True for whoever acts. The info of an agent that has left is
    the one it left with; of one that is not in this scene it says what is true of the whole episode, and else False
    and 0. TorchRL keeps infos as float32, which rounds large whole numbers: in place of `seed` there are `seed_high`
    and `seed_low`, and seed = seed_high * 2**24 + seed_low, which is exact there for seeds below 2**48.
    """

    def __init__(self, env: CADParallelEnv) -> None:
        super().__init__(env)
        self.agents: list[str] = []

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Infos]:
        """As the environment's, with everybody in it."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self.agents = list(self.env.possible_agents)
        absent = _absent(next(iter(infos.values())), self.env.unwrapped.simulation.episode_info())
        self._left: Infos = dict.fromkeys(self.agents, absent)  # what each was told last
        self._ended = dict.fromkeys(self.agents, True)  # by itself, and not because time was up
        return self._seen(observations), self._told(infos)

    def step(self, actions: Mapping[str, int]) -> Step:
        """As the environment's, of every possible agent."""
        observations, rewards, ended, late, infos = self.env.step(dict(actions))
        self._ended.update(ended)
        over, everyone = not self.env.agents, self.agents
        terminations = {agent: over and self._ended[agent] for agent in everyone}
        truncations = dict.fromkeys(everyone, over and any(late.values()))
        if over:
            self.agents = []
        earned = {agent: rewards.get(agent, 0.0) for agent in everyone}
        return self._seen(observations), earned, terminations, truncations, self._told(infos)

    def _seen(self, observations: Mapping[str, Observation]) -> dict[str, Observation]:
        everyone = self.env.possible_agents
        return {agent: observations.get(agent) or self._nothing(agent) for agent in everyone}

    def _nothing(self, agent: str) -> Observation:
        space: Any = self.observation_space(agent)
        return {name: np.zeros(box.shape, box.dtype) for name, box in space.spaces.items()}

    def _told(self, infos: Infos) -> Infos:
        self._left.update(infos)
        return {agent: {**_split_seed(info), "present": agent in infos} for agent, info in self._left.items()}


def _absent(told: Mapping[str, Any], episode: Mapping[str, Any]) -> dict[str, Any]:
    """The info of an agent that is not in this scene, with the keys and types of one that is."""
    return {**{name: type(value)() for name, value in told.items()}, **episode}


def _split_seed(info: Mapping[str, Any]) -> dict[str, Any]:
    """The info with its seed in two whole numbers."""
    high, low = divmod(info["seed"], WHOLE)
    return {"seed_high": high, "seed_low": low, **{name: value for name, value in info.items() if name != "seed"}}
