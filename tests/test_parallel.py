"""The multi-agent environment: everybody sees and decides for itself, and leaves when it is done."""

import re
import warnings
from types import SimpleNamespace

import cloudpickle
import numpy as np
import pytest
from pettingzoo.test import api_test, max_cycles_test, parallel_api_test, parallel_seed_test, state_test
from pettingzoo.utils import parallel_to_aec
from scenes import Twitchy

import cad_env
from cad_env.env import CADEnv
from cad_env.fixed_agents import FixedAgents
from cad_env.global_state import STATE_FEATURES, STATE_VEHICLES
from cad_env.parallel import CADParallelEnv, parallel_env
from cad_env.planner import Expert
from cad_env.scenarios import SCENARIOS
from cad_env.scenarios.scenario import Scenario
from cad_env.types import BRAKE, GO
from cad_env.world.state import OFF, crashed
from cad_env.world.step import advance

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


def test_the_turn_based_form_passes_pettingzoo_s_tests_too():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "Observation (is not a NumPy array|space for each agent probably should be)")
        api_test(parallel_to_aec(cad_env.parallel_env(ID)), num_cycles=300)
        state_test(parallel_to_aec(cad_env.parallel_env(ID)), cad_env.parallel_env(ID), num_cycles=20)
    max_cycles_test(
        SimpleNamespace(
            parallel_env=lambda max_cycles: parallel_env(max_cycles=max_cycles),
            env=lambda max_cycles: parallel_to_aec(parallel_env(max_cycles=max_cycles)),
        )
    )


def test_agents_are_the_connected_vehicles_and_the_ego_is_the_first():
    env = parallel_env(ranges={"collaborators": (2, 4)})
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
    assert len(parallel_env(ranges={"collaborators": (2, 4)}).possible_agents) == 5


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
    single, many = CADEnv(ranges={"collaborators": (3, 3)}), parallel_env()
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
        assert many.outcomes.get("cav_0") == info["outcome"]
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
    for seed in range(6):
        history = drive(env, seed, action=GO)
        alive = set(history[0][0])
        for observations, rewards, terminations, truncations, infos in history[1:]:
            assert set(observations) == set(rewards) == set(terminations) == set(truncations) == set(infos) == alive
            assert not any(terminations[agent] and truncations[agent] for agent in alive)
            alive = {agent for agent in alive if not (terminations[agent] or truncations[agent])}
        assert not alive
        assert env.agents == []
        assert set(env.outcomes) == set(history[0][0])


def test_an_info_says_how_it_ended_in_numbers():
    env = parallel_env()
    seen = set()
    for seed in range(20):
        *_, (_, rewards, terminations, truncations, infos) = drive(env, seed, action=GO)
        for agent, info in infos.items():
            outcome = env.outcomes[agent]
            assert info["is_success"] is (outcome == "success")
            assert info["crashed"] is (outcome == "collision")
            assert (terminations[agent], truncations[agent]) == (outcome != "timeout", outcome == "timeout")
            assert all(isinstance(value, bool | int | float) for value in info.values())
            assert rewards[agent] == {"waited": 0.0}.get(outcome, rewards[agent])
            seen.add(outcome)
    assert {"collision", "success", "waited"} <= seen


def waiting(env: CADParallelEnv) -> list[str]:
    """The agents of a scene that has just begun that can only wait."""
    _, infos = env.reset(seed=env.simulation.seed, options={"hazard": env.simulation.scene.hazard})
    return [agent for agent, info in infos.items() if info["waits"]]


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_who_waits_is_who_stands_after_half_a_minute_and_all_others_arrive(scenario: Scenario):
    env, told = parallel_env(scenario.gym_id, traffic="dense", penetration=0.5), set()
    for seed in range(15):
        _, infos = env.reset(seed=seed, options={"hazard": False})
        simulation, goal = env.simulation, env._goal
        world, rows = simulation.world, simulation.agents
        for _ in range(300):
            advance(world, simulation.map.routes, rows, np.zeros(len(rows), np.int64), np.zeros(len(world.speed)))
        if crashed(world).any():
            continue  # whoever is behind an accident does not arrive either
        for k, info in enumerate(infos.values()):
            assert info["waits"] == np.isinf(goal[k]) == (world.speed[rows[k]] < 0.1)
            assert info["waits"] or world.progress[rows[k]] >= goal[k]
            told.add(info["waits"])
    assert told == {True, False}


def test_an_agent_at_a_red_light_waits_for_the_others_to_be_done_and_is_paid_nothing():
    env = parallel_env()
    env.reset(seed=1, options={"hazard": False})
    standing = waiting(env)
    assert standing == ["cav_1", "cav_2", "cav_3"]
    while env.agents:
        before = env.agents
        _, rewards, _, truncations, infos = env.step(dict.fromkeys(env.agents, GO))
        assert all(rewards[agent] == 0.0 for agent in standing)
        assert all(infos[agent]["covered"] == 0.0 and not infos[agent]["is_success"] for agent in standing)
    assert before == ["cav_0", *standing]  # they leave in the step in which the last that drives does
    assert not any(truncations.values())
    assert env.outcomes == {"cav_0": "success"} | dict.fromkeys(standing, "waited")


def test_who_waits_leaves_even_if_the_last_that_drives_runs_out_of_time():
    env = parallel_env(max_cycles=40)
    history = drive(env, 1, action=BRAKE)
    *_, terminations, truncations, _ = history[-1]
    assert len(history) == 41
    assert env.outcomes["cav_0"] == "timeout"
    assert truncations["cav_0"] is True
    assert env.outcomes["cav_1"] == "waited"
    assert terminations["cav_1"] is True


def test_a_waiting_agent_that_is_hit_has_crashed():
    env = parallel_env()
    env.reset(seed=1)
    world, row = env.simulation.world, env.simulation.agents[2]
    world.position[row] = world.position[0]  # somebody is put on top of it
    _, rewards, terminations, _, infos = env.step(dict.fromkeys(env.agents, GO))
    assert rewards["cav_2"] == -1.0
    assert terminations["cav_2"] is True
    assert infos["cav_2"]["crashed"] is True
    assert env.outcomes["cav_2"] == "collision"


def test_time_is_up_after_max_cycles():
    env = parallel_env(max_cycles=7)
    history = drive(env, 0, action=BRAKE)
    assert len(history) == 8
    assert history[-1][3]["cav_0"] is True


def test_the_share_of_the_way_adds_up_to_one_for_whoever_arrives():
    env, arrived = parallel_env(), 0
    for seed in range(12):
        history = drive(env, seed, action=GO)
        for agent, outcome in env.outcomes.items():
            earned = sum(step[1].get(agent, 0.0) for step in history[1:])
            if outcome == "success":
                arrived += agent != "cav_0"
                assert earned == pytest.approx(2.0, abs=0.03)  # its way, and what it overshoots in its last step, and 1
    assert arrived > 0


def test_who_has_left_drives_on():
    env = parallel_env()
    env.reset(seed=10)
    while len(env.agents) == 4:
        env.step(dict.fromkeys(env.agents, GO))
    gone = next(k for k, agent in enumerate(env.possible_agents) if agent not in env.agents)
    row, outcome = env.simulation.agents[gone], env.outcomes[f"cav_{gone}"]
    progress = env.simulation.world.progress[row]
    env.step(dict.fromkeys(env.possible_agents, BRAKE))  # what it is asked to do now does not matter
    assert env.simulation.world.progress[row] > progress
    assert env.outcomes[f"cav_{gone}"] == outcome


def test_every_agent_can_ask_the_expert():
    env = parallel_env()
    for seed in range(1_000_000, 1_000_003):
        env.reset(seed=seed, options={"hazard": True})
        while env.agents:
            env.step({agent: Expert().act(env.truth(agent)) for agent in env.agents})
        assert env.outcomes["cav_0"] == "success"
        assert "collision" not in env.outcomes.values()


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


def test_with_fixed_agents_everybody_stays_to_the_end():
    plain, fixed = parallel_env(max_cycles=120), FixedAgents(parallel_env(max_cycles=120))
    seen, _ = plain.reset(seed=10)
    filled, infos = fixed.reset(seed=10)
    assert same(seen, filled)
    left: dict[str, bool] = {}
    while fixed.agents:
        assert fixed.agents == fixed.possible_agents
        there = set(plain.agents)
        seen, earned, _, late, _ = plain.step(dict.fromkeys(plain.agents, GO))
        left.update({agent: late[agent] for agent in there - set(plain.agents)})
        filled, rewards, terminations, truncations, infos = fixed.step(dict.fromkeys(fixed.agents, GO))
        for agent in fixed.possible_agents:
            assert infos[agent]["present"] is (agent in there)
            assert rewards[agent] == earned.get(agent, 0.0)
            assert (
                same(filled[agent], seen[agent]) if agent in there else not any(v.any() for v in filled[agent].values())
            )
            assert fixed.observation_space(agent).contains(filled[agent])
            assert terminations[agent] is (not plain.agents and not left[agent])
            assert truncations[agent] is (not plain.agents and left[agent])
    assert not plain.agents
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
        (lambda env: parallel_env(max_cycles=0), ValueError, "max_cycles must be a whole number of decisions from 1"),
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
