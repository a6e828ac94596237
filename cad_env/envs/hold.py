"""Decisions that hold for longer than 0.1 s: exploration by chance then moves the ego, instead of shaking it."""

from typing import Any

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs

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


def checked_hold(steps: Any) -> int:
    """A number of steps that a decision may hold for; ConfigError otherwise."""
    return check_whole("hold", steps, 1, MAX_STEPS)
