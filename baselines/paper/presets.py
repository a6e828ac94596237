"""How much of everything a reproduction of the paper's tables takes."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from baselines.paper.sweeps import SWEPT_EPISODES
from cad_env.config import check_range

EVERY_POINT, END_POINTS = "every", "ends"  # which points of a sweep


@dataclass(frozen=True)
class Preset:
    """Episodes are counted per scenario, and where something drives, per method too."""

    seeds: tuple[int, ...]  # of training
    episodes: int  # driven by the expert, to learn from
    dagger_rounds: int  # DAgger rounds
    dagger_episodes: int  # in each of them
    steps: int  # optimiser steps of the first round; later rounds take half as many
    validation: int  # closed-loop episodes after each third of a round
    open_loop: int  # held-out episodes of the expert
    scored: int  # episodes in closed loop
    swept: int  # episodes at a point of a sweep
    sweep_points: str  # EVERY_POINT of a sweep, or its END_POINTS
    ppo_steps: int  # decisions that PPO learns from

    def __post_init__(self) -> None:
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds must be at least one, each once, got {self.seeds}")
        if self.sweep_points not in (EVERY_POINT, END_POINTS):
            raise ValueError(f"sweep_points must be {EVERY_POINT} or {END_POINTS}, got {self.sweep_points!r}")
        for name, most in (("open_loop", 100_000), ("scored", 10**9), ("ppo_steps", 10**9)):
            check_range(name, getattr(self, name), 1, most)
        check_range("swept", self.swept, 0, 10**6)


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "quick": Preset(
            seeds=(0,), episodes=160, dagger_rounds=1, dagger_episodes=60, steps=1200, validation=12, open_loop=30,
            scored=100, swept=16, sweep_points=END_POINTS, ppo_steps=60_000,
        ),
        "hour": Preset(
            seeds=(0,), episodes=240, dagger_rounds=2, dagger_episodes=60, steps=1500, validation=18, open_loop=40,
            scored=150, swept=24, sweep_points=END_POINTS, ppo_steps=60_000,
        ),
        "full": Preset(
            seeds=(0, 1, 2), episodes=1500, dagger_rounds=2, dagger_episodes=400, steps=2400, validation=60,
            open_loop=100, scored=500, swept=SWEPT_EPISODES, sweep_points=EVERY_POINT, ppo_steps=300_000,
        ),
    }
)  # fmt: skip
