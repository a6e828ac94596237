"""Decisions that hold for longer than 0.1 s: exploration by chance then moves the ego, instead of shaking it."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs
from pettingzoo.utils.wrappers import BaseParallelWrapper

from cad_env.checks import check_whole
from cad_env.types import MAX_STEPS, Observation

_Stepped = tuple[Observation, float, bool, bool, dict[str, Any]]


class HoldDecision(gym.Wrapper[Observation, Any, Observation, Any], RecordConstructorArgs):
    """Every decision holds for `steps` steps of the environment, or until the episode ends.

    The reward is the sum of theirs, in their order; observation, info and how it stands are those of the last of them.
    It equals stepping that often by hand to the last bit, and `CADVectorEnv(hold=steps)`. ConfigError for a number that
    is not whole or not from 1 to MAX_STEPS.

    >>> env = HoldDecision(gym.make("cad_env:CADLeftTurn-v0"), 5)
    >>> observation, info = env.reset(seed=1)
    >>> observation, reward, terminated, truncated, info = env.step(0)
    >>> env.unwrapped.steps
    5
    """

    def __init__(self, env: gym.Env[Observation, Any], steps: int = 5) -> None:
        RecordConstructorArgs.__init__(self, steps=steps)
        gym.Wrapper.__init__(self, env)
        self.hold = checked_hold(steps)

    def step(self, action: Any) -> _Stepped:
        """Decide, and let the time of the decision pass."""
        observation, total, terminated, truncated, info = self.env.step(action)
        for _ in range(self.hold - 1):
            if terminated or truncated:
                break
            observation, reward, terminated, truncated, info = self.env.step(action)
            total = float(total) + float(reward)
        return observation, float(total), terminated, truncated, info


class HoldParallel(BaseParallelWrapper[str, Observation, int]):
    """The same for every agent of a PettingZoo environment: `parallel_env(...)`, or `FixedAgents` around it.

    An agent that leaves while its decision holds earns what it earned until then, and its observation, info and how it
    stands are those of the step in which it left.

    >>> from cad_env import parallel_env
    >>> env = HoldParallel(parallel_env("CADLeftTurn-v0"), 5)
    >>> observations, infos = env.reset(seed=1)
    >>> observations, rewards, terminations, truncations, infos = env.step(dict.fromkeys(env.agents, 0))
    >>> env.unwrapped.simulation.steps
    5
    """

    def __init__(self, env: Any, steps: int = 5) -> None:
        super().__init__(env)
        self.hold = checked_hold(steps)
        self.agents: list[str] = []

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
        """As the environment's."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self.agents = self.env.agents
        return observations, infos

    def step(self, actions: Mapping[str, int]) -> tuple[Any, ...]:
        """Everybody decides; let the time of the decisions pass."""
        parts: list[dict[str, Any]] = [{} for _ in range(5)]  # as the environment gives them
        totals = dict.fromkeys(self.env.agents, 0.0)
        for _ in range(self.hold):
            step = self.env.step({agent: actions[agent] for agent in self.env.agents})
            for part, new in zip(parts, step, strict=True):
                part.update(new)
            totals = {agent: total + step[1].get(agent, 0.0) for agent, total in totals.items()}
            if not self.env.agents:
                break
        self.agents = self.env.agents
        return parts[0], totals, *parts[2:]


def checked_hold(steps: Any) -> int:
    """A number of steps that a decision may hold for; ConfigError otherwise."""
    return check_whole("hold", steps, 1, MAX_STEPS)
