"""Many scenes in one process, by Gymnasium's conventions: its own vectors, specs, statistics and autoreset."""

import json
import pickle
import re
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.scenarios import SCENARIOS
from cad_env.types import GO, MAX_STEPS
from tests.cad_env.envs.test_vector import same, twitch

IDS = [scenario.gym_id for scenario in SCENARIOS.values()]
ID = IDS[0]


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_it_says_at_every_step_what_gymnasium_s_own_vector_of_single_environments_says(mode: str):
    options = {"radio": {"delay": 0.1}, "traffic": "dense"}
    ours = gym.make_vec(ID, num_envs=4, vectorization_mode="vector_entry_point", autoreset_mode=mode, **options)
    theirs = gym.make_vec(ID, num_envs=4, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **options)
    one, other = (env.reset(seed=40, options={"hazard": True}) for env in (ours, theirs))
    ended = 0
    for step in range(230):
        assert all(same(a, b) for a, b in zip(one, other, strict=True)), step
        actions = twitch(step, one[0], 4)
        one, other = ours.step(actions), theirs.step(actions)
        ended += int((one[2] | one[3]).sum())
    assert ended >= 8  # so that episodes of seeds that followed by themselves are among them


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("limit", [25, MAX_STEPS + 1])
def test_a_limit_of_one_s_own_is_gymnasium_s_time_limit(mode: str, limit: int):
    ours = gym.make_vec(ID, num_envs=3, max_episode_steps=limit, autoreset_mode=mode)
    theirs = gym.make_vec(
        ID, num_envs=3, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, max_episode_steps=limit
    )
    one, other = (env.reset(seed=8) for env in (ours, theirs))
    cut = 0
    for step in range(80):
        assert all(same(a, b) for a, b in zip(one, other, strict=True)), step
        one, other = (env.step(np.full(3, GO)) for env in (ours, theirs))
        cut += one[3].sum()
    assert cut == (9 if limit == 25 else 0)


@pytest.mark.parametrize("limit", [0, -2, 2.5, True, "300"])
def test_a_limit_that_is_none_is_refused(limit: object):
    with pytest.raises(
        ValueError, match=re.escape(f"max_episode_steps must be a whole number from 1 on, -1 or None, got {limit!r}")
    ):
        CADVectorEnv(1, max_episode_steps=limit)


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_makes_it_of_every_id_without_a_warning(name: str):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make_vec(name, num_envs=3, vectorization_mode="vector_entry_point")
        assert isinstance(env, CADVectorEnv)
        assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
        observations, _ = env.reset(seed=1)
        assert observations in env.observation_space
        env.action_space.seed(2)
        for _ in range(20):
            observations, rewards, terminations, truncations, _ = env.step(env.action_space.sample())
            assert observations in env.observation_space
        assert (rewards.dtype, terminations.dtype, truncations.dtype) == (np.float64, np.bool_, np.bool_)
        assert env.single_observation_space == gym.make(name).observation_space
        assert env.single_action_space == gym.make(name).action_space
        env.close()
    assert env.batch.simulations[0].scenario.gym_id == name


def test_a_spec_goes_through_json_and_pickle_with_its_options():
    spec = gym.make_vec(
        ID, num_envs=3, vectorization_mode="vector_entry_point", depth=5, autoreset_mode="SameStep"
    ).spec
    for again in (EnvSpec.from_json(spec.to_json()), pickle.loads(pickle.dumps(spec))):
        env = gym.make_vec(again)
        assert (env.num_envs, env.autoreset_mode) == (3, AutoresetMode.SAME_STEP)
        assert env.batch.simulations[2].setup.depth == 5
    assert json.loads(spec.to_json())["kwargs"]["num_envs"] == 3


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_gymnasium_s_statistics_are_those_of_the_single_environments(mode: str):
    env = RecordEpisodeStatistics(CADVectorEnv(4, autoreset_mode=mode))
    env.reset(seed=50)
    found: dict[int, tuple[float, int]] = {}
    while len(found) < 4:
        *_, infos = env.step(np.full(4, GO))
        for place in np.flatnonzero(infos.get("_episode", [])):
            found.setdefault(int(place), (infos["episode"]["r"][place], infos["episode"]["l"][place]))
    for place, (total, length) in found.items():
        single, rewards, over = CADEnv(), [], False
        single.reset(seed=50 + place)
        while not over:
            _, reward, terminated, truncated, _ = single.step(GO)
            rewards.append(reward)
            over = terminated or truncated
        assert (total, length) == (pytest.approx(sum(rewards)), len(rewards))


def test_without_autoreset_the_scenes_that_ended_wait_to_be_reset():
    env = CADVectorEnv(3, autoreset_mode="Disabled")
    observations, _ = env.reset(seed=[3, 4, 5])
    ended = np.zeros(3, bool)
    while not ended.any():
        observations, _, terminations, truncations, _ = env.step(np.full(3, GO))
        ended = terminations | truncations
    with pytest.raises(RuntimeError, match=r"the episodes of the scenes \[\d\] are over: reset them first"):
        env.step(np.full(3, GO))
    options = {"reset_mask": ended, "hazard": False}
    anew, infos = env.reset(seed=[60, 61, 62], options=options)
    assert set(options) == {"reset_mask", "hazard"}
    for name in observations:
        assert (anew[name][~ended] == observations[name][~ended]).all()
    place = int(np.flatnonzero(ended)[0])
    alone, _ = CADEnv().reset(seed=60 + place, options={"hazard": False})
    assert all(same(part, anew[name][place]) for name, part in alone.items())
    assert infos["_seed"].tolist() == ended.tolist()
    assert infos["seed"].tolist() == [60 + k if k == place else 0 for k in range(3)]
    env.step(np.full(3, GO))
