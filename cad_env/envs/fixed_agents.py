"""For libraries that want the same agents from the first step to the last, such as SuperSuit's vector environments."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pettingzoo.utils.wrappers import BaseParallelWrapper

from cad_env.envs.parallel import CADParallelEnv, Infos, Step
from cad_env.numerics.record_array import CopiedWhole
from cad_env.types import Observation


class FixedAgents(CopiedWhole, BaseParallelWrapper[str, Observation, int]):
    """Every possible agent stays until the last one is done, and all end in the same step.

    Whoever has left, or is not in this scene, sees zeros, earns nothing, and its actions are ignored; its info is the
    one it left with. `info["present"]` is True for whoever acts. In the last step an agent is truncated if its own
    time ran out, and terminated otherwise.
    """

    def __init__(self, env: CADParallelEnv) -> None:
        super().__init__(env)
        self.agents: list[str] = []

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Infos]:
        """As the environment's, with everybody in it."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self.agents = list(self.env.possible_agents)
        self._left: Infos = {agent: {} for agent in self.agents}  # what each was told last
        self._late = dict.fromkeys(self.agents, False)
        return self._seen(observations), self._told(infos)

    def step(self, actions: Mapping[str, int]) -> Step:
        """As the environment's, of every possible agent."""
        observations, rewards, _, truncations, infos = self.env.step(dict(actions))
        self._late.update(truncations)
        over, everyone = not self.env.agents, self.agents
        terminations = {agent: over and not self._late[agent] for agent in everyone}
        truncations = {agent: over and self._late[agent] for agent in everyone}
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
        return {agent: {**info, "present": agent in infos} for agent, info in self._left.items()}
