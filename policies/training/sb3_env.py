"""Many scenes as Stable-Baselines3 wants them: its VecEnv, over the vector environment of this project."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from cad_env.checks import check_several, check_text
from cad_env.config import check_names
from cad_env.envs.scaling import scaled_observation, scaled_space
from cad_env.envs.vector import CADVectorEnv
from cad_env.types import Ints, Observation
from policies.training.config import VALIDATION_SEEDS

SEEDS = VALIDATION_SEEDS  # episodes to learn from have seeds below


class CADVecEnv(VecEnv):
    """`num_envs` scenes in one process as a VecEnv of Stable-Baselines3.

    Keyword arguments: those of CADVectorEnv (`scenario`, one or a list that the scenes take in turn, `radio`, `hold`,
    `reward`, ...) but `autoreset_mode` and `copy`; `reads`, the parts of an observation to show (default: all); and
    `scaled=True`, which shows them as `ScaledObservation` does. An episode that ends begins anew in the same step, on
    a seed drawn below 900,000: those of validation and evaluation are above. As the library has it, the `info` of an
    episode's last step holds `terminal_observation` and `TimeLimit.truncated`, `episode` with its return and length in
    decisions, and `is_success`.

    >>> envs = CADVecEnv(2, scenario="left_turn", reads=("ego", "command"), hold=5)
    >>> _ = envs.seed(3)
    >>> {name: part.shape for name, part in envs.reset().items()}
    {'ego': (2, 4), 'command': (2, 6)}
    """

    def __init__(
        self, num_envs: int = 1, reads: Sequence[str] | None = None, scaled: bool = False, **options: Any
    ) -> None:
        self.scenes = CADVectorEnv(num_envs, "Disabled", **options)
        whole = self.scenes.single_observation_space
        self.names = tuple(whole) if reads is None else check_several("reads", reads, check_text)
        check_names("part of an observation", dict.fromkeys(self.names), list(whole))
        self.render_mode = None
        self._scaled = scaled
        shown = spaces.Dict({name: whole[name] for name in self.names})
        super().__init__(self.scenes.num_envs, scaled_space(shown) if scaled else shown, spaces.Discrete(2))
        self._chance = np.random.default_rng(0)
        self._actions: Ints = np.zeros(num_envs, np.int64)
        self._earned, self._length = np.zeros(num_envs), np.zeros(num_envs, np.int64)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """What the seeds of all episodes from the next reset on are drawn from."""
        self._chance = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> Observation:
        """New episodes everywhere."""
        self._earned[:], self._length[:] = 0.0, 0
        return self._shown(self.scenes.reset(seed=self._drawn())[0])

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the decisions (num_envs,)."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Do as decided."""
        seen, rewards, ended, cut, told = self.scenes.step(self._actions)
        self._earned += rewards
        self._length += 1
        over, shown = ended | cut, self._shown(seen)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for place in np.flatnonzero(over).tolist():
            infos[place] = {
                "terminal_observation": {name: part[place] for name, part in shown.items()},
                "TimeLimit.truncated": bool(cut[place] and not ended[place]),
                "episode": {"r": float(self._earned[place]), "l": int(self._length[place])},
                "is_success": bool(told["is_success"][place]),
            }
        if over.any():
            self._earned[over], self._length[over] = 0.0, 0
            shown = self._shown(self.scenes.reset(seed=self._drawn(), options={"reset_mask": over})[0])
        return shown, rewards.astype(np.float32), over, infos

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
        shown = {name: seen[name] for name in self.names}
        return scaled_observation(shown) if self._scaled else shown
