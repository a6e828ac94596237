"""The vector environment: many scenes in one process, by Gymnasium's conventions, bit for bit equal to single ones."""

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cad_env.checks import check_seed, check_switch, check_whole
from cad_env.envs.hold import checked_hold
from cad_env.envs.rewards import Reward, ego_step, progress, reward_named
from cad_env.envs.single import as_array, check_scenario_of_id, checked_options
from cad_env.lidar.config import space_with
from cad_env.numerics.record_array import CopiedWhole
from cad_env.scenarios.scenario import Scenario
from cad_env.simulation.batch import SceneBatch, masked
from cad_env.simulation.scene_step import COLLIDED, SUCCEEDED
from cad_env.simulation.setup import setup_from
from cad_env.types import BRAKE, GO, MAX_STEPS, Bools, Floats, Ints, Observation

_Step = tuple[Observation, Floats, Bools, Bools, dict[str, Any]]


class CADVectorEnv(CopiedWhole, VectorEnv[Observation, Ints, Any]):
    """`num_envs` scenes, each as CADEnv gives it: observations, rewards, seeds and infos are equal to the last bit.

    Keyword arguments: those of CADEnv but `config` and `render_mode`; `scenario` may also be a list of them, which the
    scenes take in turn. `autoreset_mode` is one of Gymnasium's ("NextStep", "SameStep", "Disabled"), `copy=False`
    hands out the same arrays at every step; `max_episode_steps` ends episodes before their time is up, as Gymnasium's
    TimeLimit does (None or -1: it does not). With `hold=k` a decision holds for k steps of 0.1 s, or until the episode
    ends, and earns their sum, as in `HoldDecision`. Options of `reset`: `hazard`, and `reset_mask`, (num_envs,) bools.

    >>> envs = CADVectorEnv(num_envs=3, radio="dsrc")
    >>> observations, infos = envs.reset(seed=1, options={"hazard": True})
    >>> observations["tracks"].shape, infos["seed"].tolist()
    ((3, 24, 15, 3), [1, 2, 3])
    """

    metadata = {"render_modes": [], "render_fps": 10, "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    _spec: EnvSpec | None = None

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        scenario: str | Scenario | Sequence[str | Scenario] = "left_turn",
        object_lists: bool = False,
        reward: str | Reward = "progress",
        max_episode_steps: int | None = None,
        hold: int = 1,
        **options: Any,
    ) -> None:
        self.hold = checked_hold(hold)
        self.num_envs = num_envs = check_whole("num_envs", num_envs, 1)
        self.copy, self._object_lists = check_switch("copy", copy), check_switch("object_lists", object_lists)
        self._reward = reward_named(reward)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        names: list[Any] = [scenario]
        if isinstance(scenario, Iterable) and not isinstance(scenario, str):
            names = list(scenario)
        if not names:
            raise ValueError(f"scenario must name at least one, got {scenario!r}")
        setups = [setup_from({**options, "scenario": name}) for name in names]
        self.batch = SceneBatch([setups[place % len(setups)] for place in range(num_envs)])
        self.single_observation_space: spaces.Dict = space_with(
            setups[0].cloud, self.batch.simulations[0].scenario.command_count, setups[0].coverage
        )
        self.single_action_space: spaces.Discrete = spaces.Discrete(2)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._everywhere = np.ones(num_envs, np.bool_)
        self._over = np.zeros(num_envs, np.bool_)  # episodes that have ended and not begun anew
        self._decisions = np.zeros(num_envs, np.int64)  # so far in each episode
        self._limit = _checked_limit(max_episode_steps)
        self._chance: list[np.random.Generator | None] = [None] * num_envs
        self._started = False

    @property  # an attribute in Gymnasium
    def spec(self) -> EnvSpec | None:
        """The id it was made by, and with what."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        check_scenario_of_id(spec, [each.scenario.name for each in self.batch.simulations])
        self._spec = spec

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Draw scenes: of seed, seed + 1, ..., of a list of seeds, or without one going on from the last."""
        options, seeds = checked_options(options, ["hazard", "reset_mask"]), _checked_seeds(seed, self.num_envs)
        which = self._everywhere
        if "reset_mask" in options:
            which = _checked_mask(options["reset_mask"], self.num_envs)
            self._check_started()
        for place in np.flatnonzero(which).tolist():
            self._start(place, seeds[place], options["hazard"])
        self._started = True
        return self._observations(), self._infos(which)

    def step(self, actions: Ints) -> _Step:
        """Decide in every scene, GO or BRAKE, (num_envs,); what happens to ended episodes is the autoreset mode's."""
        self._check_started()
        chosen = _checked_actions(actions, self.num_envs)
        over = self._over.copy()
        if self.autoreset_mode == AutoresetMode.DISABLED and over.any():
            raise RuntimeError(f"the episodes of the scenes {np.flatnonzero(over).tolist()} are over: reset them first")
        rewards = self._held(np.flatnonzero(~over), chosen)
        for place in np.flatnonzero(over).tolist():
            self._start(place)
        terminations, truncations = self._ended(), self._decisions >= self._limit
        self._over = terminations | truncations
        final = self._begun_anew() if self.autoreset_mode == AutoresetMode.SAME_STEP and self._over.any() else {}
        return self._observations(), rewards, terminations, truncations, {**final, **self._infos(self._everywhere)}

    def _held(self, going: Ints, chosen: Ints) -> Floats:
        """Decide in the scenes `going` and let it hold: what each scene earned, (num_envs,)."""
        total = np.zeros(self.num_envs)
        for _ in range(self.hold):
            total[going] += self._played(going, chosen)
            going = going[~(self._ended() | (self._decisions >= self._limit))[going]]
            if not len(going):
                break
        return total

    def _played(self, going: Ints, chosen: Ints) -> Floats:
        """Let 0.1 s pass in the scenes `going` (n,): what they earned, (n,)."""
        before = self._progress(going)
        self.batch.step(going, chosen[going])
        self._decisions[going] += 1
        if self._reward is progress:  # which the compiled step has computed already
            return self.batch.rewards[going]
        return self._earned(going, chosen, before)

    def _ended(self) -> Bools:
        """(num_envs,) True where the ego has arrived or collided."""
        outcomes = self.batch.outcomes
        ended: Bools = (outcomes == SUCCEEDED) | (outcomes == COLLIDED)
        return ended

    def _progress(self, going: Ints) -> list[float]:
        """m along their routes, of the egos of some scenes; nothing where no reward of its own asks for it."""
        if self._reward is progress:
            return []
        return [float(self.batch.simulations[place].world.progress[0]) for place in going.tolist()]

    def _earned(self, going: Ints, chosen: Ints, before: list[float]) -> Floats:
        """(n,) by a reward of its own."""
        places = zip(going.tolist(), before, strict=True)
        return np.array(
            [self._reward(ego_step(self.batch.simulations[k], int(chosen[k]), start)) for k, start in places]
        )

    def _begun_anew(self) -> dict[str, Any]:
        """Start the scenes that are over; what there was to see and to say at their end."""
        ended, seen = self._over.copy(), np.full(self.num_envs, None, object)
        for place in np.flatnonzero(ended).tolist():
            seen[place] = self.batch.observation(place)
        said = self._infos(ended)
        for place in np.flatnonzero(ended).tolist():
            self._start(place)
        return {**masked({"final_obs": seen}, ended), "final_info": said, "_final_info": ended.copy()}

    def _start(self, place: int, seed: int | None = None, hazard: bool | None = None) -> None:
        """As CADEnv.reset: a seed is the episode's and starts the chance of the later ones."""
        chance = self._chance[place]
        if seed is not None or chance is None:
            chance, _ = np_random(seed)
            self._chance[place] = chance
        self.batch.start(place, int(chance.integers(2**31)) if seed is None else seed, hazard)
        self._over[place], self._decisions[place] = False, 0

    def _observations(self) -> Observation:
        seen = self.batch.observations
        return {name: part.copy() for name, part in seen.items()} if self.copy else dict(seen)

    def _infos(self, which: Bools) -> dict[str, Any]:
        lists = self.batch.object_lists(which) if self._object_lists else {}
        return {**self.batch.infos(which), **lists}

    def _check_started(self) -> None:
        if not self._started:
            raise gym.error.ResetNeeded("Cannot step before the first reset() of all scenes")


def _autoreset_mode(mode: Any) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError:
        choices = ", ".join(each.value for each in AutoresetMode)
        raise ValueError(f"autoreset_mode must be one of {choices}, got {mode!r}") from None


def _checked_seeds(seed: Any, count: int) -> list[int | None]:
    """Of every scene, by what `reset` was given; ValueError for what is neither a seed nor a list of them."""
    if seed is None:
        return [None] * count
    if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str | bytes) and np.ndim(seed) == 1:
        if len(seed) != count:
            raise ValueError(f"seed must be one number or a list of {count}, got {seed!r}")
        return [None if each is None else check_seed("seed", each) for each in seed]
    first = check_seed("seed", seed)
    return [first + place for place in range(count)]


def _checked_mask(mask: Any, count: int) -> Bools:
    """The scenes to reset."""
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        raise ValueError(f"options['reset_mask'] must be a numpy array of bools, got {mask!r}")
    if mask.shape != (count,) or not mask.any():
        raise ValueError(f"options['reset_mask'] must hold {count} bools and at least one True, got {mask!r}")
    return mask


def _checked_limit(given: int | None) -> int:
    """Decisions in the longest episode; Gymnasium's make_vec hands over the limit of the id."""
    if given is None or given == -1:
        return MAX_STEPS
    if isinstance(given, bool) or not isinstance(given, int) or given < 1:
        raise ValueError(f"max_episode_steps must be a whole number from 1 on, -1 or None, got {given!r}")
    return min(given, MAX_STEPS)


def _checked_actions(actions: Any, count: int) -> Ints:
    """GO or BRAKE for every scene as integers; ValueError for anything else."""
    chosen = as_array(actions)
    if chosen.shape != (count,) or chosen.dtype.kind not in "iuf" or not ((chosen == GO) | (chosen == BRAKE)).all():
        raise ValueError(f"actions must be {count} times {GO} (go) or {BRAKE} (brake), got {actions!r}")
    return chosen.astype(np.int64)
