"""How many episodes and optimiser steps a reproduction of the paper's tables takes."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from baselines.paper.sweeps import SWEPT_EPISODES
from cad_env.checks import check_numbers
from policies.training.config import TrainingConfig

EVERY_POINT, END_POINTS = "every", "ends"  # of a sweep


@dataclass(frozen=True)
class Preset:
    """Episodes are counted per scenario, and where something drives, per method too."""

    seeds: tuple[int, ...]  # of training
    training: Mapping[str, Any]  # of TrainingConfig, where it differs from the defaults
    open_loop: int  # held-out episodes of the expert
    scored: int  # episodes in closed loop
    swept: int  # episodes at a point of a sweep
    sweep_points: str  # one of EVERY_POINT, END_POINTS
    ppo_steps: int  # decisions that PPO learns from

    def __post_init__(self) -> None:
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds must be at least one, each once, got {self.seeds}")
        if self.sweep_points not in (EVERY_POINT, END_POINTS):
            raise ValueError(f"sweep_points must be {EVERY_POINT} or {END_POINTS}, got {self.sweep_points!r}")
        most = {"open_loop": (1, 100_000), "scored": (1, 10**9), "ppo_steps": (1, 10**9), "swept": (0, 10**6)}
        check_numbers(self, "", most)

    @property
    def episodes(self) -> int:
        """Of the expert, to learn from."""
        episodes: int = self.training.get("episodes", TrainingConfig.episodes)
        return episodes


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "quick": Preset(
            seeds=(0,), open_loop=30, scored=100, swept=16, sweep_points=END_POINTS, ppo_steps=60_000,
            training={"episodes": 160, "dagger_rounds": 1, "dagger_episodes": 60, "steps": 1200, "validation": 12},
        ),
        "hour": Preset(
            seeds=(0,), open_loop=40, scored=150, swept=24, sweep_points=END_POINTS, ppo_steps=60_000,
            training={"episodes": 240, "dagger_episodes": 60, "steps": 1500, "validation": 18},
        ),
        "full": Preset(
            seeds=(0, 1, 2), open_loop=100, scored=500, swept=SWEPT_EPISODES, sweep_points=EVERY_POINT,
            ppo_steps=300_000, training={},
        ),
    }
)  # fmt: skip
