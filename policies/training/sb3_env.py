"""Many scenes as Stable-Baselines3 wants them: its VecEnv, over the vector environment of this project."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from cad_env.envs.vector import CADVectorEnv
from cad_env.types import Ints, Observation
from policies.stgraph.config import StGraphConfig
from policies.training.config import VALIDATION_SEEDS

SEEDS = VALIDATION_SEEDS  # episodes to learn from have seeds below


class Scenes(VecEnv):
    """`count` scenes of the scenarios in turn, each begun anew, with the next seed drawn, in the step in which it ends.

    Shows the parts of an observation that the network reads. As the library has it, the `info` of an episode's last
    step holds `terminal_observation` and `TimeLimit.truncated`, and `episode` with its return and length.
    """

    def __init__(self, count: int, scenarios: Sequence[str], radio: str, config: StGraphConfig) -> None:
        self.scenes = CADVectorEnv(count, "Disabled", scenario=scenarios, radio=radio, coverage=config.coverage)
        whole = self.scenes.single_observation_space
        self.names = config.reads
        self.render_mode = None
        super().__init__(count, spaces.Dict({name: whole[name] for name in self.names}), spaces.Discrete(2))
        self._chance = np.random.default_rng(0)
        self._actions: Ints = np.zeros(count, np.int64)
        self._earned, self._length = np.zeros(count), np.zeros(count, np.int64)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """What the seeds of all episodes from the next reset on are drawn from."""
        self._chance = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> Observation:
        """New episodes everywhere."""
        self._earned[:], self._length[:] = 0.0, 0
        return self._shown(self.scenes.reset(seed=self._drawn())[0])

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the decisions (count,)."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Do as decided."""
        seen, rewards, ended, cut, _ = self.scenes.step(self._actions)
        self._earned += rewards
        self._length += 1
        over = ended | cut
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for place in np.flatnonzero(over).tolist():
            infos[place] = {
                "terminal_observation": {name: seen[name][place] for name in self.names},
                "TimeLimit.truncated": bool(cut[place] and not ended[place]),
                "episode": {"r": float(self._earned[place]), "l": int(self._length[place])},
            }
        if over.any():
            self._earned[over], self._length[over] = 0.0, 0
            seen = self.scenes.reset(seed=self._drawn(), options={"reset_mask": over})[0]
        return self._shown(seen), rewards.astype(np.float32), over, infos

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The same of every scene."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Scenes have no settings of their own."""
        raise AttributeError(f"scenes cannot change {attr_name}")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Scenes have no methods of their own."""
        raise AttributeError(f"scenes have no method {method_name}")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No scene is."""
        return [False] * len(list(self._get_indices(indices)))

    def _drawn(self) -> list[int]:
        return [int(seed) for seed in self._chance.integers(SEEDS, size=self.num_envs)]

    def _shown(self, seen: Observation) -> Observation:
        return {name: seen[name] for name in self.names}
