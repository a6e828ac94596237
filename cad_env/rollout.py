"""The one closed loop: environment + policy -> Episode."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from cad_env.env import CADEnv
from cad_env.types import BRAKE, STEP, Floats, Ints, Observation, Policy


@dataclass(frozen=True)
class Episode:
    """What happened: the unit of evaluation."""

    scenario: str
    contender: str
    seed: int
    hazard: bool
    outcome: str  # success, collision or timeout
    action: Ints  # (n,) int8, one per decision
    speed: Floats  # (n,) m/s of the ego after each decision
    bytes_sent: Ints  # (n,) by all connected vehicles, per decision
    messages_sent: Ints  # (n,)
    largest_message: Ints  # (n,) bytes
    messages_lost: Ints  # (n,) on their way to the ego
    min_ttc: float  # s, inf if nothing was on a collision course
    hazard_timing: float | None = None  # s after an unbraked ego that the hidden vehicle is where they meet

    @property
    def time(self) -> float:
        """s until the outcome."""
        return len(self.action) * STEP

    @property
    def brakes(self) -> int:
        """Decisions to brake."""
        return int((self.action == BRAKE).sum())

    @property
    def bytes_per_message(self) -> float:
        """Mean payload, bytes; NaN if nothing was sent."""
        messages = int(self.messages_sent.sum())
        return float(self.bytes_sent.sum()) / messages if messages else math.nan


@runtime_checkable
class BatchPolicy(Protocol):
    """A policy without memory that can decide for many observations at once, as it would one by one."""

    def act_batch(self, observations: Observation) -> Ints:
        """Observations with a leading dimension n -> (n,) GO or BRAKE."""


# Called before every decision with the environment, what the policy saw, and what it chose.
Watch = Callable[[CADEnv, Any, int], None]


def rollout(
    env: CADEnv,
    policy: Policy,
    seed: int,
    contender: str = "",
    hazard: bool | None = None,
    watch: Watch | None = None,
) -> Episode:
    """Drive one episode to its end."""
    policy.reset(seed)
    run = _Run(env, seed, hazard)
    while not run.over:
        action = policy.act(env.truth() if policy.privileged else run.observation)
        if watch is not None:
            watch(env, run.observation, action)
        run.step(action)
    return run.episode(contender)


def rollouts(
    envs: Sequence[CADEnv],
    policy: Policy,
    seeds: Iterable[int],
    contender: str = "",
    hazard: bool | None = None,
    watch: Watch | None = None,
) -> Iterator[Episode]:
    """Drive an episode per seed, several at a time if the policy decides in batches; episodes come as they end.

    Every episode is the same as `rollout` gives, whatever the number of environments.
    """
    if not isinstance(policy, BatchPolicy):
        for seed in seeds:
            yield rollout(envs[0], policy, seed, contender, hazard, watch)
        return
    waiting = iter(seeds)
    runs = [_Run(env, seed, hazard) for env, seed in zip(envs, waiting, strict=False)]
    while runs:
        seen = {name: np.stack([run.observation[name] for run in runs]) for name in runs[0].observation}
        for run, action in zip(runs, policy.act_batch(seen), strict=True):
            if watch is not None:
                watch(run.env, run.observation, int(action))
            run.step(int(action))
        for k, run in enumerate(runs):
            if run.over:
                yield run.episode(contender)
                following = next(waiting, None)
                if following is not None:
                    runs[k] = _Run(run.env, following, hazard)
        runs = [run for run in runs if not run.over]


class _Run:
    """An episode under way."""

    def __init__(self, env: CADEnv, seed: int, hazard: bool | None) -> None:
        self.env, self.seed = env, seed
        self.observation, self.info = env.reset(seed=seed, options={"hazard": hazard})
        self.over = False
        self.rows: list[tuple[int, float, int, int, int, int]] = []

    def step(self, action: int) -> None:
        self.observation, _, terminated, truncated, self.info = self.env.step(action)
        info = self.info
        told = (info[name] for name in ("bytes_sent", "messages_sent", "largest_message", "messages_lost"))
        self.rows.append((action, info["speed"], *told))
        self.over = terminated or truncated

    def episode(self, contender: str) -> Episode:
        action, speed, sent, messages, largest, lost = (np.array(column) for column in zip(*self.rows, strict=True))
        return Episode(
            self.env.simulation.scenario.name, contender, self.seed, bool(self.info["hazard"]), self.info["outcome"],
            action.astype(np.int8), speed, sent, messages, largest, lost, float(self.info["min_ttc"]),
            self.info.get("hazard_timing"),
        )  # fmt: skip
