"""How long one vehicle takes to decide: from what four vehicles detect to GO or BRAKE, and the network by itself."""

import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from stages import FOUR

import cad_env
from baselines.evaluation.job import job_of
from baselines.evaluation.settings import Settings

TRACKS = 12  # of the network by itself, all of them in all 15 frames
DECISIONS = 1000

Figures = dict[str, float]


class Decisions:
    """The shipped network deciding for one scene at a time, as a vehicle would."""

    def __init__(self) -> None:
        self._env = gym.make("CADLeftTurn-v0", ranges=FOUR)
        self._policy: Any = job_of(Settings(), "left_turn", "stgraph").policy
        observation, _ = self._env.reset(seed=0)
        self._full = {name: part.copy() for name, part in observation.items()}
        rng = np.random.default_rng(0)
        self._full["mask"][:] = 0
        self._full["mask"][:TRACKS] = 1
        self._full["tracks"][:TRACKS] = rng.uniform(-40.0, 40.0, self._full["tracks"][:TRACKS].shape)
        self._policy.act(self._full)

    def measured(self, seed: int) -> Figures:
        """Milliseconds of CPU time. A whole step is counted, so the world and its detections are in it, too."""
        whole, over, action = list[int](), True, cad_env.GO
        while len(whole) < DECISIONS:
            if over:
                self._env.reset(seed=seed + len(whole))
            start = time.thread_time_ns()
            observation, _, terminated, truncated, _ = self._env.step(action)
            action = self._policy.act(observation)
            whole.append(time.thread_time_ns() - start)
            over = terminated or truncated
        alone = [_timed(lambda: self._policy.act(self._full)) for _ in range(DECISIONS)]
        return {
            "step and decision, 4 vehicles, batch 1, median (ms)": float(np.median(whole)) * 1e-6,
            "step and decision, 4 vehicles, batch 1, 99th percentile (ms)": float(np.percentile(whole, 99)) * 1e-6,
            f"network alone, {TRACKS} tracks x 15 frames, batch 1 (ms)": float(np.median(alone)) * 1e-6,
        }


def _timed(act: Callable[[], object]) -> int:
    start = time.thread_time_ns()
    act()
    return time.thread_time_ns() - start
