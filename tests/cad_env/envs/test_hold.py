"""A decision that holds is the same as deciding so often, to the last bit."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

from cad_env.envs.fixed_agents import FixedAgents
from cad_env.envs.hold import HoldDecision, HoldParallel
from cad_env.envs.parallel import CADParallelEnv
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.types import MAX_STEPS

SEED = 5


def by_hand(env: CADEnv, action: int, times: int) -> tuple:
    """The same action so often, or until the episode ends; rewards summed."""
    total = 0.0
    for _ in range(times):
        observation, reward, terminated, truncated, info = env.step(action)
        total += reward
        if terminated or truncated:
            break
    return observation, total, terminated, truncated, info


def assert_same(one: dict, other: dict) -> None:
    """Two observations are equal."""
    assert one.keys() == other.keys()
    for name, part in one.items():
        np.testing.assert_array_equal(part, other[name])


@pytest.mark.parametrize("reward", ["progress", "time-and-safety"])
def test_it_equals_stepping_by_hand(reward: str) -> None:
    held, bare = HoldDecision(CADEnv(reward=reward), 7), CADEnv(reward=reward)
    held.reset(seed=SEED)
    bare.reset(seed=SEED)
    over, k = False, 0
    while not over:
        one, other = held.step(int(k % 4 == 1)), by_hand(bare, int(k % 4 == 1), 7)
        assert_same(one[0], other[0])
        assert one[1:] == other[1:]
        over, k = one[2] or one[3], k + 1
    assert held.unwrapped.steps % 7 != 0  # it ended while a decision held


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("reward", ["progress", "safety-first"])
def test_side_by_side_it_equals_the_wrapper(mode: str, reward: str) -> None:
    count = 3
    envs = CADVectorEnv(count, mode, reward=reward, hold=5, traffic="none")
    alone = [HoldDecision(CADEnv(reward=reward, traffic="none"), 5) for _ in range(count)]
    envs.reset(seed=SEED)
    for place, env in enumerate(alone):
        env.reset(seed=SEED + place)
    rng, over, begun = np.random.default_rng(0), np.zeros(count, bool), 0
    for _ in range(MAX_STEPS // 5):
        actions = (rng.random(count) < 0.2).astype(int)
        seen, rewards, ended, cut, infos = envs.step(actions)
        for place, env in enumerate(alone):
            if over[place]:  # the step in which it begins anew
                observation, _ = env.reset()
                wanted: tuple = (observation, 0.0, False, False)
            else:
                wanted = env.step(int(actions[place]))[:4]
            shown = {name: part[place] for name, part in seen.items()}
            if mode == "SameStep" and (wanted[2] or wanted[3]):
                shown = infos["final_obs"][place]
                env.reset()
            assert_same(shown, wanted[0])
            assert (rewards[place], ended[place], cut[place]) == wanted[1:4]
        begun += int((ended | cut).sum())
        over = (ended | cut) if mode == "NextStep" else over
    assert begun > count


@pytest.mark.parametrize("fixed", [False, True])
def test_every_agent_holds_and_who_leaves_meanwhile_is_as_it_left(fixed: bool) -> None:
    def made() -> Any:
        bare = CADParallelEnv(reward="time-and-safety")
        return FixedAgents(bare) if fixed else bare

    held, bare = HoldParallel(made(), 6), made()
    held.reset(seed=SEED)
    bare.reset(seed=SEED)
    left_meanwhile = False
    for k in range(MAX_STEPS):
        action = int(k % 4 == 1)
        begun, found = set(held.agents), held.step(dict.fromkeys(held.agents, action))
        total, last = dict.fromkeys(begun, 0.0), {}
        for part in range(6):
            step = bare.step(dict.fromkeys(bare.agents, action))
            for agent in step[1]:
                total[agent] += step[1][agent]
                last[agent] = [each[agent] for each in step]
            left_meanwhile |= part < 5 and len(bare.agents) < len(begun)
            if not bare.agents:
                break
        assert set(found[0]) == set(last) == begun
        assert (found[1], held.agents) == (total, bare.agents)
        for agent, (seen, _, *how) in last.items():
            assert_same(found[0][agent], seen)
            assert [each[agent] for each in found[2:]] == how
        if not held.agents:
            break
    assert left_meanwhile


def test_it_is_an_environment_of_pettingzoo() -> None:
    parallel_api_test(HoldParallel(CADParallelEnv(waiting=True), 5), num_cycles=100)


def test_a_time_limit_ends_an_episode_while_a_decision_holds() -> None:
    envs = CADVectorEnv(1, "Disabled", hold=5, max_episode_steps=8)
    envs.reset(seed=SEED)
    assert not envs.step(np.zeros(1, int))[3][0]
    assert envs.step(np.zeros(1, int))[3][0]
    assert envs.batch.simulations[0].steps == 8


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version:UserWarning")
def test_it_is_an_environment_of_gymnasium() -> None:
    env = HoldDecision(gym.make("CADLeftTurn-v0"), 5)
    check_env(env, skip_render_check=True)
    assert env.spec.additional_wrappers[-1].kwargs == {"steps": 5}


@pytest.mark.parametrize("wrong", [0, 1.5, MAX_STEPS + 1, "5", True])
def test_a_wrong_number_is_refused_in_one_line(wrong: object) -> None:
    for make in (lambda: HoldDecision(CADEnv(), wrong), lambda: CADVectorEnv(1, hold=wrong)):
        with pytest.raises(ValueError, match=r"^hold must be a whole number from 1 to 400, got "):
            make()
