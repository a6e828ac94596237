"""The one closed loop, for one episode or many side by side: environment + policy -> Episode."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cad_env.checks import check_seed
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.simulation.batch import SceneBatch
from cad_env.simulation.scene_step import UNDER_WAY
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, MAX_STEPS, STEP, Floats, Ints, Observation, Policy

BRAKE_WINDOW = 5  # decisions: 0.5 s


@dataclass(frozen=True)
class Episode:
    """What happened: the unit of evaluation."""

    scenario: str
    method: str
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
    hazard_time: float  # s after the start, when an ego that never brakes would be hit; inf if it would not
    connected: int  # vehicles, the ego included
    struck_from_behind: bool = False  # the collision was one with a vehicle that followed the ego

    @property
    def time(self) -> float:
        """s until the outcome."""
        return len(self.action) * STEP

    @property
    def brakes(self) -> int:
        """Decisions to brake."""
        return int((self.action == BRAKE).sum())

    @property
    def hardest_brake(self) -> float:
        """m/s2, the largest mean deceleration of the ego over 0.5 s; 0 where it never slows down."""
        drop = self.speed[:-BRAKE_WINDOW] - self.speed[BRAKE_WINDOW:]
        return max(0.0, float(drop.max(initial=0.0))) / (BRAKE_WINDOW * STEP)

    @property
    def bytes_per_message(self) -> float:
        """Mean payload, bytes; NaN if nothing was sent."""
        messages = int(self.messages_sent.sum())
        return float(self.bytes_sent.sum()) / messages if messages else math.nan


@runtime_checkable
class BatchPolicy(Protocol):
    """A policy without memory that can decide for many observations at once, as it would one by one."""

    def act_batch(self, observations: Any) -> Ints:
        """(n,) GO or BRAKE for observations with a leading dimension n, or for the Truths of n scenes if privileged."""


# Called before every decision with the environment, or its simulation, what the policy saw, and what it chose.
Watch = Callable[[CADEnv, Observation, int], None]
WatchOfMany = Callable[[Simulation, Observation, int], None]


def rollout(
    env: CADEnv,
    policy: Policy,
    seed: int,
    method: str = "",
    hazard: bool | None = None,
    watch: Watch | None = None,
) -> Episode:
    """Drive one episode to its end. seed: any whole number from 0 on."""
    seed = check_seed("seed", seed)
    policy.reset(seed)
    observation, info = env.reset(seed=seed, options={"hazard": hazard})
    log = _Log(1)
    while info["outcome"] is None:
        action = policy.act(env.truth() if policy.privileged else observation)
        if watch is not None:
            watch(env, observation, action)
        observation, _, _, _, info = env.step(action)
        log.note(_HERE, np.array([action]), {name: np.array([info[name]]) for name in _LOGGED})
    return log.episode(0, env.simulation, method)


def rollouts(
    envs: CADVectorEnv | Sequence[CADEnv],
    policy: Policy,
    seeds: Iterable[int],
    method: str = "",
    hazard: bool | None = None,
    watch: WatchOfMany | None = None,
) -> Iterator[Episode]:
    """Drive an episode per seed, as many at a time as there are scenes in the vector environment, yielded as they end.

    Every episode is the same as `rollout` gives, whatever the number of scenes; a policy that does not decide in
    batches drives one at a time. The environment must be reset before it is stepped by hand again. Of a list of single
    environments only the settings count.
    """
    if isinstance(envs, CADVectorEnv):
        batch = envs.batch
    else:
        batch = SceneBatch([env.simulation.setup for env in envs])
    together, log = isinstance(policy, BatchPolicy), _Log(len(batch))
    decide = _decide_together if together else _decide_alone

    def begun() -> Iterator[int]:
        for seed in seeds:
            policy.reset(check_seed("seed", seed))
            yield seed

    def act(which: Ints, _: Ints) -> Ints:
        actions = decide(policy, batch, which)
        if watch is not None:
            for place, action in zip(which.tolist(), actions.tolist(), strict=True):
                watch(batch.simulations[place], batch.observation(place), action)
        return actions

    def noted(which: Ints, actions: Ints) -> None:
        log.note(which, actions, {name: batch.step_info(name)[which] for name in _LOGGED})

    for _, place in play_episodes(batch, begun(), act, noted, hazard, len(batch) if together else 1):
        yield log.episode(place, batch.simulations[place], method)


def play_episodes(
    batch: SceneBatch,
    seeds: Iterable[int],
    decide: Callable[[Ints, Ints], Ints],
    noted: Callable[[Ints, Ints], object] = lambda which, actions: None,
    hazard: bool | None = None,
    side_by_side: int | None = None,
) -> Iterator[tuple[int, int]]:
    """Play an episode per seed, `side_by_side` (default: all scenes) at once; yield (its number, its scene) as it ends.

    `decide` gets the scenes under way, (n,), and the numbers of the episodes in them, (n,), and returns actions (n,).
    `noted` gets these scenes and actions after the step.
    """
    waiting, under_way = iter(enumerate(seeds)), dict[int, int]()
    free = list(range(len(batch) if side_by_side is None else side_by_side))
    while True:
        for place, (episode, seed) in zip(free, waiting, strict=False):
            batch.start(place, seed, hazard)
            under_way[place] = episode
        if not under_way:
            return
        which = np.array(list(under_way))
        actions = decide(which, np.array(list(under_way.values())))
        batch.step(which, actions)
        noted(which, actions)
        free = which[batch.outcomes[which] != UNDER_WAY].tolist()
        for place in free:
            yield under_way.pop(place), place


def _decide_together(policy: Any, batch: SceneBatch, which: Ints) -> Ints:
    """What a BatchPolicy decides, (n,), in the scenes `which` (n,)."""
    if policy.privileged:
        return np.asarray(policy.act_batch(batch.truths(which)))
    return np.asarray(policy.act_batch({name: part[which] for name, part in batch.observations.items()}))


def _decide_alone(policy: Policy, batch: SceneBatch, which: Ints) -> Ints:
    """What any policy decides, (1,), in the one scene `which` (1,)."""
    place = int(which[0])
    seen = batch.simulations[place].truth() if policy.privileged else batch.observation(place)
    return np.array([policy.act(seen)])


_HERE = np.zeros(1, np.int64)
_LOGGED = ("speed", "bytes_sent", "messages_sent", "largest_message", "messages_lost")


class _Log:
    """What was decided and step_info in the episodes under way, one a scene."""

    def __init__(self, scenes: int) -> None:
        self._length = np.zeros(scenes, np.int64)
        self._action = np.zeros((scenes, MAX_STEPS), np.int8)
        self._step_info = {
            name: np.zeros((scenes, MAX_STEPS), float if name == "speed" else np.int64) for name in _LOGGED
        }

    def note(self, which: Ints, actions: Ints, step_info: Mapping[str, NDArray[Any]]) -> None:
        """Add a step of the scenes `which` (n,)."""
        at = which, self._length[which]
        self._action[at] = actions
        for name, value in step_info.items():
            self._step_info[name][at] = value
        self._length[which] += 1

    def episode(self, place: int, simulation: Simulation, method: str) -> Episode:
        """The episode that ended in a scene, whose next one may begin."""
        count, self._length[place] = int(self._length[place]), 0
        info = simulation.info()
        return Episode(
            simulation.scenario.name, method, info["seed"], info["hazard"], info["outcome"],
            self._action[place, :count].copy(), min_ttc=info["min_ttc"], hazard_time=info["hazard_time"],
            connected=len(simulation.agents), struck_from_behind=info["struck_from_behind"],
            **{name: part[place, :count].copy() for name, part in self._step_info.items()},
        )  # fmt: skip
