"""Many scenes in one process: equal to single environments to the last bit, whoever drives them."""

import copy
import gc
import pickle
import re
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import gymnasium as gym
import numba
import numpy as np
import pytest
from gymnasium.vector import VectorEnv
from scenes import Twitchy

from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.rules.expert import Expert
from cad_env.rules.planner import Planner
from cad_env.scenarios import SCENARIOS
from cad_env.scoring.rollout import Episode, rollout, rollouts
from cad_env.simulation.scene_step import scene_at
from cad_env.types import BRAKE, GO


def same(one: Any, other: Any) -> bool:
    """Equal to the last bit, and of one type."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(*(shown(part, name) for part in (one, other))) for name in one)
    one, other = np.asarray(one), np.asarray(other)
    if one.dtype == object or other.dtype == object:
        pairs = zip(one.ravel(), other.ravel(), strict=True)
        return all(same(a, b) if isinstance(a, dict) else a == b for a, b in pairs)
    return (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())


def shown(infos: dict, name: str) -> Any:
    """What counts of one value of an infos or observations dict: where it has a mask, what the mask shows."""
    mask = infos.get(f"_{name}")
    return infos[name] if mask is None or isinstance(infos[name], dict) else infos[name][mask]


def driven(env: VectorEnv, count: int, seed: int) -> Iterator[tuple]:
    """Every answer of a vector environment that Twitchy drives, and in most steps nobody."""
    answer = env.reset(seed=seed)
    yield answer
    for step in range(count):
        answer = env.step(twitch(step, answer[0], env.num_envs))
        yield answer


def twitch(step: int, observations: dict, count: int) -> np.ndarray:
    return Twitchy().act_batch(observations) if step % 5 == 0 else np.full(count, GO)


def test_law_9_64_scenes_are_64_single_environments_for_whole_episodes_and_into_the_next_ones():
    history = list(driven(CADVectorEnv(64), 140, 1000))
    alone = [CADEnv() for _ in range(64)]
    answers = [env.reset(seed=1000 + place) for place, env in enumerate(alone)]
    over, ended = np.zeros(64, bool), np.zeros(64, int)
    for step, together in enumerate(history):
        for name in together[0]:
            assert np.stack([answer[0][name] for answer in answers]).tobytes() == together[0][name].tobytes(), name
        for name in answers[0][-1]:
            assert same([answer[-1][name] for answer in answers], together[-1][name]), name
        if step > 0:
            told = zip(*(answer[1:4] if len(answer) == 5 else (0.0, False, False) for answer in answers), strict=True)
            assert all(list(one) == other.tolist() for one, other in zip(told, together[1:4], strict=True))
            over = together[2] | together[3]
            ended += over
        actions = twitch(step, together[0], 64)
        answers = [env.reset() if over[k] else env.step(int(actions[k])) for k, env in enumerate(alone)]
    assert ended.min() >= 1
    assert ended.max() >= 2


def test_scenes_of_several_stories_run_side_by_side():
    vector = CADVectorEnv(2 * len(SCENARIOS), scenario=list(SCENARIOS))
    history = list(driven(vector, 40, 7))
    for place, simulation in enumerate(vector.batch.simulations):
        assert simulation.scenario.name == list(SCENARIOS)[place % len(SCENARIOS)]
        env = CADEnv(scenario=simulation.scenario.name)
        seen = env.reset(seed=7 + place)[0]
        for step, together in enumerate(history[:-1]):
            assert all(same(part, together[0][name][place]) for name, part in seen.items())
            seen = env.step(int(twitch(step, together[0], vector.num_envs)[place]))[0]


def test_observations_are_copies_unless_asked_otherwise():
    for kept in (True, False):
        env = CADVectorEnv(2, copy=kept)
        first, _ = env.reset(seed=1)
        before = first["odometry"].copy()
        second, *_ = env.step(np.full(2, GO))
        assert np.shares_memory(first["odometry"], second["odometry"]) is not kept
        assert bool((first["odometry"] == before).all()) is kept


def test_seeds_are_a_number_a_list_or_those_that_follow():
    env, again = CADVectorEnv(3), CADVectorEnv(3)
    assert env.reset(seed=9)[1]["seed"].tolist() == [9, 10, 11]
    assert env.reset(seed=[5, 5, 1])[1]["seed"].tolist() == [5, 5, 1]
    assert again.reset(seed=[5, 5, 1])[1]["seed"].tolist() == [5, 5, 1]
    following = env.reset()[1]["seed"]
    assert following.tolist() == again.reset()[1]["seed"].tolist()
    assert following[0] == following[1] != following[2]
    assert env.reset(seed=[None, 7, None])[1]["seed"][1] == 7


def test_object_lists_are_in_infos_when_asked_for():
    env, single = CADVectorEnv(2, object_lists=True), CADEnv(object_lists=True)
    *_, infos = env.reset(seed=2), env.step(np.full(2, BRAKE))
    single.reset(seed=3)
    *_, info = single.step(BRAKE)
    lists = infos[-1]["object_lists"][1]
    assert all((one == other).all() for one, other in zip(lists, info["object_lists"], strict=True))
    assert "object_lists" not in CADVectorEnv(1).reset(seed=2)[1]


@pytest.mark.parametrize("actions", [[0, 1], [0, 1, 2], [0.5, 0, 0], None, [True] * 3, "go", [[0, 0, 0]], [np.nan] * 3])
def test_actions_that_are_none_are_refused_and_change_nothing(actions: Any):
    env = CADVectorEnv(3)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=re.escape("actions must be 3 times 0 (go) or 1 (brake), got")):
        env.step(actions)
    assert [simulation.steps for simulation in env.batch.simulations] == [0, 0, 0]


@pytest.mark.parametrize(
    ("act", "kind", "complaint"),
    [
        (lambda: CADVectorEnv(0), ValueError, "num_envs must be a whole number from 1 on, got 0"),
        (lambda: CADVectorEnv(2, radoi="dsrc"), ValueError, "unknown option radoi='dsrc': choose among"),
        (lambda: CADVectorEnv(2, autoreset_mode="Never"), ValueError, "autoreset_mode must be one of NextStep"),
        (lambda: CADVectorEnv(2, scenario=[]), ValueError, "scenario must name at least one"),
        (lambda: CADVectorEnv(2).step(np.zeros(2)), gym.error.ResetNeeded, "before the first reset() of all scenes"),
        (lambda: CADVectorEnv(2).reset(seed=[1]), ValueError, "seed must be one number or a list of 2, got [1]"),
        (lambda: CADVectorEnv(2).reset(seed=-1), ValueError, "seed must be a whole number from 0 on, got -1"),
        (lambda: CADVectorEnv(2).reset(options={"hazrad": True}), ValueError, "unknown reset option hazrad=True"),
        (lambda: CADVectorEnv(2).reset(options={"hazard": 1}), ValueError, "hazard must be True, False or None, got 1"),
        (lambda: CADVectorEnv(2).reset(options={"reset_mask": [True]}), ValueError, "must be a numpy array of bools"),
        (lambda: CADVectorEnv(2).reset(options={"reset_mask": np.zeros(2, bool)}), ValueError, "at least one True"),
    ],
)
def test_a_wrong_argument_is_refused_by_name_and_value(act: Any, kind: type, complaint: str):
    with pytest.raises(kind, match=re.escape(complaint)):
        act()


def facts(episode: Episode) -> list:
    values = [getattr(episode, field.name) for field in fields(episode)]
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in values]


@pytest.mark.parametrize("policy", [Expert(), Planner()])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_rules_decide_in_a_batch_as_one_by_one(policy: Any, scenario: str):
    env, seeds = CADEnv(scenario=scenario), range(300, 308)
    alone = {seed: facts(rollout(env, policy, seed, "x", hazard=True)) for seed in seeds}
    together = list(rollouts(CADVectorEnv(3, scenario=scenario), policy, seeds, "x", hazard=True))
    assert {episode.seed: facts(episode) for episode in together} == alone
    assert len(together) == len(seeds)


class Patient:
    """Brakes for the first steps of every episode: a policy with a memory."""

    privileged = False

    def reset(self, seed: int) -> None:
        self.left = seed % 7 + 10

    def act(self, observation: Any) -> int:
        self.left -= 1
        return BRAKE if self.left >= 0 else GO


def test_a_policy_with_a_memory_drives_one_episode_after_the_other():
    episodes = list(rollouts(CADVectorEnv(4), Patient(), range(20, 26)))
    assert [episode.seed for episode in episodes] == list(range(20, 26))
    assert [episode.brakes for episode in episodes] == [seed % 7 + 10 for seed in range(20, 26)]
    assert facts(episodes[3]) == facts(rollout(CADEnv(), Patient(), 23))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_of_an_episode_goes_its_own_way(copied: Any):
    # As highway-env's planners want it: look ahead in a copy, and leave the original alone.
    env, straight = CADEnv(), CADEnv()
    for one in (env, straight):
        one.reset(seed=4)
        one.step(GO)
    twin = copied(env)
    braked = [twin.step(BRAKE) for _ in range(10)]
    gone, expected = [env.step(GO) for _ in range(10)], [straight.step(GO) for _ in range(10)]
    assert all(same(a[0], b[0]) and a[1:] == b[1:] for a, b in zip(gone, expected, strict=True))
    assert braked[-1][-1]["speed"] < gone[-1][-1]["speed"] - 1.0


def test_the_shelf_keeps_the_scenes_that_compiled_code_borrows():
    # Nobody counts references to the arrays of a scene there: freed, they would soon hold something else.
    def records() -> Any:
        env = CADVectorEnv(3)
        env.reset(seed=5)
        return env.batch.batch_state.records, env.batch.simulations[2].world.position.copy()

    kept, expected = records()
    gc.collect()
    rubbish = [np.full(expected.shape, -1.0) for _ in range(5000)]
    assert position_of_ego(kept, 2) == tuple(expected[0])
    assert len(rubbish) == 5000


@numba.njit
def position_of_ego(records: Any, place: int) -> tuple[float, float]:
    scene = scene_at(records, place)
    return scene.world.position[0, 0], scene.world.position[0, 1]
