"""The multi-agent environment: everybody sees and decides for itself, and leaves when it is done."""

import re
import warnings

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test
from scenes import Twitchy

import cad_env
from cad_env.env import CADEnv
from cad_env.parallel import CADParallelEnv, parallel_env
from cad_env.planner import Expert
from cad_env.types import BRAKE, GO

ID = "CADLeftTurn-v0"


def drive(env: CADParallelEnv, seed: int, count: int = 300, action=None) -> list[tuple]:
    """Every step's result, by Twitchy unless an action is given."""
    policy = Twitchy()
    observations, infos = env.reset(seed=seed)
    history = [(observations, {}, {}, {}, infos)]
    while env.agents and len(history) <= count:
        actions = {agent: policy.act(observations[agent]) if action is None else action for agent in env.agents}
        history.append(env.step(actions))
        observations = history[-1][0]
    return history


def test_pettingzoo_s_own_test_passes_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(cad_env.parallel_env(ID), num_cycles=1000)
        parallel_seed_test(lambda: cad_env.parallel_env(ID), num_cycles=50)


def test_agents_are_the_connected_vehicles_and_the_ego_is_the_first():
    env = parallel_env(traffic={"collaborators": (2, 4)})
    for seed in range(10):
        observations, infos = env.reset(seed=seed)
        assert env.agents == [f"cav_{k}" for k in range(len(env.simulation.scene.connected))]
        assert set(env.agents) <= set(env.possible_agents)
        assert list(observations) == list(infos) == env.agents
        assert env.simulation.agents[0] == 0


def test_unless_asked_otherwise_there_are_four_agents_in_every_scene():
    env = parallel_env()
    for seed in range(10):
        env.reset(seed=seed)
        assert env.agents == env.possible_agents == ["cav_0", "cav_1", "cav_2", "cav_3"]
    assert len(parallel_env(traffic={"collaborators": (2, 4)}).possible_agents) == 5


def same(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f")) if isinstance(a, np.ndarray) else a == b


def test_two_environments_of_one_seed_agree_for_100_steps():
    # PettingZoo's own seed test compares one step only.
    one, other = drive(parallel_env(), 3, 100), drive(parallel_env(), 3, 100)
    assert len(one) == len(other) > 60
    assert all(same(a, b) for left, right in zip(one, other, strict=True) for a, b in zip(left, right, strict=True))
    different = drive(parallel_env(), 4, 5)
    assert not same(different[1][0]["cav_0"], one[1][0]["cav_0"])


def test_the_ego_sees_what_it_sees_in_the_single_agent_environment():
    # As long as the others go, both are the same episode.
    single, many = CADEnv(traffic={"collaborators": (3, 3)}), parallel_env()
    observation, _ = single.reset(seed=6)
    observations, _ = many.reset(seed=6)
    policy, ended = Twitchy(), False
    while not ended:
        assert same(observation, observations["cav_0"])
        action = policy.act(observation)
        observation, reward, terminated, truncated, info = single.step(action)
        actions = dict.fromkeys(many.agents, GO) | {"cav_0": action}
        observations, rewards, terminations, truncations, infos = many.step(actions)
        ended = terminated or truncated
        assert rewards["cav_0"] == pytest.approx(reward)
        assert (terminations["cav_0"], truncations["cav_0"]) == (terminated, truncated)
        assert infos["cav_0"]["outcome"] == info["outcome"]
        assert infos["cav_0"]["bytes_received"] == info["bytes_received"]


def test_everybody_decides_for_itself():
    env = parallel_env()
    env.reset(seed=0)
    moving = [k for k in range(len(env.agents)) if env.simulation.world.speed[env.simulation.agents[k]] > 3.0]
    assert 0 in moving
    for _ in range(20):
        env.step({agent: BRAKE if agent == "cav_0" else GO for agent in env.agents})
    assert env.simulation.world.speed[0] == 0.0
    seen = [env.simulation.observation(k) for k in range(len(env.simulation.agents))]
    assert not same(seen[0], seen[1])


def test_a_finished_agent_leaves_and_does_not_come_back():
    env = parallel_env()
    sizes, ended = [], {}
    for seed in range(6):
        history = drive(env, seed, action=GO)
        alive = set(history[0][0])
        for observations, rewards, terminations, truncations, infos in history[1:]:
            assert set(observations) == set(rewards) == set(terminations) == set(truncations) == set(infos) == alive
            for agent in sorted(alive):
                if terminations[agent] or truncations[agent]:
                    assert not (terminations[agent] and truncations[agent])
                    assert infos[agent]["outcome"] in {"success", "collision", "timeout"}
                    ended[infos[agent]["outcome"]] = True
                    alive.discard(agent)
                else:
                    assert infos[agent]["outcome"] is None
        assert not alive
        assert env.agents == []
        sizes.append(len(history))
    assert {"success", "timeout"} <= set(ended)  # the waiting truck never arrives
    assert max(sizes) == 301


def test_who_has_left_drives_on():
    env = parallel_env()
    env.reset(seed=1, options={"hazard": False})
    while "cav_0" in env.agents:
        env.step(dict.fromkeys(env.agents, GO))
    progress = env.simulation.world.progress[0]
    env.step(dict.fromkeys(env.agents, GO))
    assert env.simulation.world.progress[0] > progress


def test_every_agent_can_ask_the_expert():
    env = parallel_env()
    for seed in range(1_000_000, 1_000_003):
        _, infos = env.reset(seed=seed, options={"hazard": True})
        outcome = None
        while outcome is None:
            actions = {agent: Expert().act(env.truth(agent)) if agent == "cav_0" else GO for agent in env.agents}
            *_, infos = env.step(actions)
            outcome = infos["cav_0"]["outcome"]
        assert outcome == "success"


def test_spaces_are_the_same_object_every_time():
    env = parallel_env()
    for agent in env.possible_agents:
        assert env.observation_space(agent) is env.observation_space(agent)
        assert env.action_space(agent) is env.action_space(agent)


def test_a_seed_is_an_episode_here_as_there():
    env = parallel_env()
    env.reset(seed=42)
    assert env.simulation.seed == 42
    single = CADEnv(traffic={"collaborators": (3, 3)})
    single.reset(seed=42)
    assert env.simulation.scene == single.simulation.scene
    env.reset()
    assert env.simulation.seed != 42


def test_pictures_show_the_scene():
    env = parallel_env(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (720, 720, 3)
    assert picture.std() > 5.0
    env.close()
    assert parallel_env().render() is None


@pytest.mark.parametrize(
    ("call", "error", "complaint"),
    [
        (lambda env: env.step({"cav_0": GO}), ValueError, "one action for each of ['cav_0'"),
        (lambda env: env.step({**dict.fromkeys(env.agents, GO), "cav_9": GO}), ValueError, "one action for each of"),
        (lambda env: env.step(dict.fromkeys(env.agents, 2)), ValueError, "action must be 0 (go) or 1 (brake), got 2"),
        (
            lambda env: env.step(dict.fromkeys(env.agents, float("nan"))), ValueError,
            "action must be 0 (go) or 1 (brake), got nan",
        ),
        (lambda env: env.reset(seed=0, options={"hazard": "yes"}), ValueError, "hazard must be True, False or None"),
        (lambda env: parallel_env("CADRightTurn-v0"), ValueError, "unknown environment 'CADRightTurn-v0': choose"),
        (lambda env: parallel_env(radio="5g"), ValueError, "unknown radio '5g'"),
        (lambda env: parallel_env(radoi="dsrc"), ValueError, "unknown option radoi='dsrc'"),
        (lambda env: parallel_env(traffic="heavy"), ValueError, "traffic must be a dict of the scenario's ranges"),
        (lambda env: parallel_env(traffic={"ego": 1}), ValueError, "unknown left_turn parameter ego=1"),
        (lambda env: parallel_env(render_mode="ascii"), ValueError, "unknown render_mode 'ascii'"),
        (lambda env: parallel_env().step({}), RuntimeError, "no agent is left: call reset() before step()"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused(call, error: type[Exception], complaint: str):
    env = parallel_env()
    env.reset(seed=0)
    with pytest.raises(error, match=re.escape(complaint)):
        call(env)


def test_a_step_after_the_last_agent_has_left_is_refused():
    env = parallel_env()
    drive(env, 0, action=GO)
    with pytest.raises(RuntimeError, match="no agent is left"):
        env.step({})
