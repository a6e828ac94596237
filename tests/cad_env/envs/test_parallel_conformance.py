"""The multi-agent environment by PettingZoo's conventions: its own tests, spaces, seeds, state and refusals."""

import re
import warnings
from types import SimpleNamespace

import cloudpickle
import numpy as np
import pytest
from pettingzoo.test import api_test, max_cycles_test, parallel_api_test, parallel_seed_test, state_test
from pettingzoo.utils import parallel_to_aec
from scenes import everybody as parallel_env

from cad_env.envs.fixed_agents import FixedAgents
from cad_env.envs.global_state import STATE_FEATURES, STATE_VEHICLES
from cad_env.envs.single import CADEnv
from cad_env.types import GO, MAX_STEPS
from cad_env.world.state import OFF
from tests.cad_env.envs.test_parallel import drive, same

ID = "CADLeftTurn-v0"


def test_pettingzoo_s_own_test_passes_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(parallel_env(ID), num_cycles=1000)
        parallel_seed_test(lambda: parallel_env(ID), num_cycles=50)


def test_the_turn_based_form_passes_pettingzoo_s_tests_too():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "Observation (is not a NumPy array|space for each agent probably should be)")
        api_test(parallel_to_aec(parallel_env(ID)), num_cycles=300)
        state_test(parallel_to_aec(parallel_env(ID)), parallel_env(ID), num_cycles=20)
    max_cycles_test(
        SimpleNamespace(
            parallel_env=lambda max_cycles: parallel_env(max_cycles=max_cycles),
            env=lambda max_cycles: parallel_to_aec(parallel_env(max_cycles=max_cycles)),
        )
    )


def test_two_environments_of_one_seed_agree_for_100_steps():
    # PettingZoo's own seed test compares one step only.
    one, other = drive(parallel_env(), 3, 100), drive(parallel_env(), 3, 100)
    assert len(one) == len(other) > 60
    assert all(same(a, b) for left, right in zip(one, other, strict=True) for a, b in zip(left, right, strict=True))
    different = drive(parallel_env(), 4, 5)
    assert not same(different[1][0]["cav_0"], one[1][0]["cav_0"])


def test_spaces_are_the_same_object_every_time():
    env = parallel_env()
    for agent in env.possible_agents:
        assert env.observation_space(agent) is env.observation_space(agent)
        assert env.action_space(agent) is env.action_space(agent)


def test_a_seed_is_an_episode_here_as_there():
    env = parallel_env()
    env.reset(seed=42)
    assert env.simulation.seed == 42
    single = CADEnv(ranges={"collaborators": (3, 3)})
    single.reset(seed=42)
    assert env.simulation.scene == single.simulation.scene
    env.reset()
    assert env.simulation.seed != 42


def test_resets_without_a_seed_go_on_from_the_last_one():
    one, other = parallel_env(), parallel_env()
    drawn = []
    for env in (one, other):
        env.reset(seed=5)
        for _ in range(3):
            env.reset()
            drawn.append(env.simulation.seed)
    assert drawn[:3] == drawn[3:]
    assert len(set(drawn)) == 3


def test_copies_of_an_environment_that_was_never_seeded_differ():
    # SuperSuit makes its vector environments of copies, and resets them without a seed.
    env = parallel_env()
    copies = [cloudpickle.loads(cloudpickle.dumps(env)) for _ in range(2)]
    seeds = [copy.reset() and copy.simulation.seed for copy in copies]
    assert seeds[0] != seeds[1]


def test_the_state_is_the_truth_agents_first():
    env = parallel_env()
    env.reset(seed=3)
    for _ in range(20):
        env.step(dict.fromkeys(env.agents, GO))
        state = env.state()
        assert env.state_space.contains(state)
    rows = dict(zip(STATE_FEATURES, state.reshape(STATE_VEHICLES, -1).T, strict=True))
    world, agents = env.simulation.world, env.simulation.agents
    assert rows["connected"].sum() == len(agents)
    np.testing.assert_allclose(rows["x"][: len(agents)], world.position[agents, 0], rtol=1e-6)
    np.testing.assert_allclose(rows["speed"][: len(agents)], world.speed[agents], rtol=1e-6)
    assert rows["present"].sum() == (world.driver != OFF).sum()
    assert all((column[rows["present"] == 0] == 0).all() for column in rows.values())


@pytest.mark.parametrize(("seed", "cycles", "late"), [(1, 80, True), (1, MAX_STEPS, False)])
def test_with_fixed_agents_everybody_stays_to_the_end(seed: int, cycles: int, late: bool):
    plain, fixed = parallel_env(max_cycles=cycles), FixedAgents(parallel_env(max_cycles=cycles))
    seen, _ = plain.reset(seed=seed)
    filled, infos = fixed.reset(seed=seed)
    assert same(seen, filled)
    left: dict[str, bool] = {}
    while fixed.agents:
        assert fixed.agents == fixed.possible_agents
        there = set(plain.agents)
        seen, earned, ended, _, _ = plain.step(dict.fromkeys(plain.agents, GO))
        left.update({agent: ended[agent] for agent in there - set(plain.agents)})
        filled, rewards, terminations, truncations, infos = fixed.step(dict.fromkeys(fixed.agents, GO))
        for agent in fixed.possible_agents:
            assert infos[agent]["present"] is (agent in there)
            assert rewards[agent] == earned.get(agent, 0.0)
            assert (
                same(filled[agent], seen[agent]) if agent in there else not any(v.any() for v in filled[agent].values())
            )
            assert fixed.observation_space(agent).contains(filled[agent])
            assert terminations[agent] is (not plain.agents and left[agent])
            assert truncations[agent] is (not plain.agents and late)
    assert not plain.agents
    assert any(terminations.values())
    parallel_api_test(FixedAgents(parallel_env()), num_cycles=300)


def test_pictures_show_the_scene():
    env = parallel_env(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (720, 720, 3)
    assert picture.std() > 5.0
    env.close()
    with pytest.warns(UserWarning, match="without specifying any render mode"):
        assert parallel_env().render() is None


@pytest.mark.parametrize(
    ("call", "error", "complaint"),
    [
        (lambda env: env.step({**dict.fromkeys(env.agents, GO), 3: GO}), ValueError, "one action for each of"),
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
        (lambda env: parallel_env(traffic="heavy"), ValueError, "traffic must be one of none, light, dense"),
        (lambda env: parallel_env(ranges={"ego": 1}), ValueError, "unknown left_turn range ego=1"),
        (lambda env: parallel_env(render_mode="ascii"), ValueError, "unknown render_mode 'ascii'"),
        (lambda env: parallel_env(max_cycles=0), ValueError, "max_cycles must be a whole number from 1 on"),
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
