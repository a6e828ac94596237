"""The multi-agent environment: everybody sees and decides for itself, and leaves when it is done."""

import numpy as np
import pytest
from scenes import Twitchy, everybody

from cad_env.envs.fixed_agents import FixedAgents
from cad_env.envs.parallel import CADParallelEnv, parallel_env
from cad_env.envs.single import CADEnv
from cad_env.rules.expert import Expert
from cad_env.scenarios import SCENARIOS
from cad_env.scenarios.scenario import Scenario
from cad_env.types import BRAKE, GO, MAX_STEPS
from cad_env.world.state import crashed
from cad_env.world.step import advance


def drive(env: CADParallelEnv, seed: int, count: int = MAX_STEPS, action=None) -> list[tuple]:
    """Every step's result, by Twitchy unless an action is given."""
    policy = Twitchy()
    observations, infos = env.reset(seed=seed)
    history = [(observations, {}, {}, {}, infos)]
    while env.agents and len(history) <= count:
        actions = {agent: policy.act(observations[agent]) if action is None else action for agent in env.agents}
        history.append(env.step(actions))
        observations = history[-1][0]
    return history


def test_agents_are_the_connected_vehicles_and_the_ego_is_the_first():
    env = everybody(ranges={"collaborators": (2, 4)})
    for seed in range(10):
        observations, infos = env.reset(seed=seed)
        assert env.agents == [f"cav_{k}" for k in range(len(env.simulation.scene.connected))]
        assert set(env.agents) <= set(env.possible_agents)
        assert list(observations) == list(infos) == env.agents
        assert env.simulation.agents[0] == 0


def test_unless_asked_otherwise_there_are_four_agents_in_every_scene():
    env = everybody()
    for seed in range(10):
        env.reset(seed=seed)
        assert env.agents == env.possible_agents == ["cav_0", "cav_1", "cav_2", "cav_3"]
    assert len(everybody(ranges={"collaborators": (2, 4)}).possible_agents) == 5


def same(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, np.ndarray):
        return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
    return a == b or (a != a and b != b)  # nan, where there is no hazard


def test_the_ego_sees_what_it_sees_in_the_single_agent_environment():
    # As long as the others go, both are the same episode.
    single, many = CADEnv(ranges={"collaborators": (3, 3)}), everybody()
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
    env = everybody()
    env.reset(seed=0)
    moving = [k for k in range(len(env.agents)) if env.simulation.world.speed[env.simulation.agents[k]] > 3.0]
    assert 0 in moving
    for _ in range(20):
        env.step({agent: BRAKE if agent == "cav_0" else GO for agent in env.agents})
    assert env.simulation.world.speed[0] == 0.0
    seen = [env.simulation.observation(k) for k in range(len(env.simulation.agents))]
    assert not same(seen[0], seen[1])


def test_a_finished_agent_leaves_and_does_not_come_back():
    env = everybody()
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
    env = everybody()
    seen = set()
    for seed in range(20):
        *_, (_, rewards, terminations, truncations, infos) = drive(env, seed, action=GO)
        for agent, info in infos.items():
            outcome = env.outcomes[agent]
            assert info["is_success"] is (outcome == "success")
            assert info["crashed"] is (outcome == "collision")
            late = env.simulation.steps == env.max_cycles
            assert terminations[agent] is (outcome in ("success", "collision") or (outcome == "waited" and not late))
            assert truncations[agent] is late
            assert all(isinstance(value, bool | int | float) for value in info.values())
            assert rewards[agent] == {"waited": 0.0}.get(outcome, rewards[agent])
            seen.add(outcome)
    assert {"collision", "success", "waited"} <= seen


def all_others_wait(env: CADParallelEnv) -> list[str]:
    """The other agents of a scene without a hazard, which has just begun, in which all of them can only wait."""
    for seed in range(20):
        env.reset(seed=seed, options={"hazard": False})
        if len(waiting(env)) == 3:
            return waiting(env)
    raise AssertionError("in every scene somebody drives")


def waiting(env: CADParallelEnv) -> list[str]:
    """The agents of a scene that has just begun that can only wait."""
    _, infos = env.reset(seed=env.simulation.seed, options={"hazard": env.simulation.scene.hazard})
    return [agent for agent, info in infos.items() if info["waits"]]


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
def test_who_waits_is_who_stands_when_time_is_up_and_all_others_arrive(scenario: Scenario):
    env, told = everybody(scenario.gym_id, traffic="dense", penetration=0.5), set()
    for seed in range(15):
        _, infos = env.reset(seed=seed, options={"hazard": False})
        simulation, goal = env.simulation, env._goal
        world, rows = simulation.world, simulation.agents
        for _ in range(MAX_STEPS):
            advance(world, simulation.map.routes, rows, np.zeros(len(rows), np.int64), np.zeros(len(world.speed)))
        if crashed(world).any():
            continue  # whoever is behind an accident does not arrive either
        for k, info in enumerate(infos.values()):
            assert info["waits"] == np.isinf(goal[k]) == (world.speed[rows[k]] < 0.1)
            assert info["waits"] or world.progress[rows[k]] >= goal[k]
            told.add(info["waits"])
    assert told == {True, False}


def test_an_agent_at_a_red_light_waits_for_the_others_to_be_done_and_is_paid_nothing():
    env = everybody()
    standing = all_others_wait(env)
    assert standing == ["cav_1", "cav_2", "cav_3"]
    while env.agents:
        before = env.agents
        _, rewards, _, truncations, infos = env.step(dict.fromkeys(env.agents, GO))
        assert all(rewards[agent] == 0.0 for agent in standing)
        assert all(infos[agent]["covered"] == 0.0 and not infos[agent]["is_success"] for agent in standing)
    assert before == ["cav_0", *standing]  # they leave in the step in which the last that drives does
    assert not any(truncations.values())
    assert env.outcomes == {"cav_0": "success"} | dict.fromkeys(standing, "waited")


def test_when_time_is_up_all_that_are_left_are_truncated_those_that_only_waited_too():
    env = everybody(max_cycles=40)
    all_others_wait(env)
    history = drive(env, env.simulation.seed, action=BRAKE)
    _, rewards, terminations, truncations, _ = history[-1]
    assert len(history) == 41
    assert env.outcomes == {"cav_0": "timeout"} | dict.fromkeys(["cav_1", "cav_2", "cav_3"], "waited")
    assert terminations == dict.fromkeys(env.possible_agents, False)
    assert truncations == dict.fromkeys(env.possible_agents, True)
    assert [rewards[agent] for agent in env.possible_agents[1:]] == [0.0, 0.0, 0.0]


def rllib_goes_on(terminations: dict[str, bool], truncations: dict[str, bool]) -> bool:
    """What RLlib's ParallelPettingZooEnv makes of a step: it ends when all are terminated, or all truncated."""
    return not (all(terminations.values()) or all(truncations.values()))


@pytest.mark.parametrize("wrapped", [lambda env: env, FixedAgents], ids=["plain", "fixed"])
@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
@pytest.mark.parametrize(("action", "cycles"), [(BRAKE, MAX_STEPS), (GO, MAX_STEPS), (GO, 60)])
def test_rllib_s_wrapper_sees_the_end_when_it_comes(scenario: Scenario, wrapped, action: int, cycles: int):
    env = wrapped(everybody(scenario.gym_id, max_cycles=cycles))
    for seed in range(7000000, 7000003):
        env.reset(seed=seed)
        while env.agents:
            everyone = env.agents
            _, _, terminations, truncations, _ = env.step(dict.fromkeys(everyone, action))
            assert set(terminations) == set(truncations) == set(everyone)
            assert rllib_goes_on(terminations, truncations) is bool(env.agents)
        if action == BRAKE:
            assert all(truncations.values())


def test_who_crashes_in_the_last_step_of_all_is_terminated_and_truncated_with_the_others():
    seed, crash = next(
        (seed, k)
        for seed in range(20)
        for k, step in enumerate(drive(everybody(), seed, action=GO)[1:], 1)
        if "cav_0" in step[4] and step[4]["cav_0"]["crashed"]
    )
    env = everybody(max_cycles=crash)
    *_, terminations, truncations, infos = drive(env, seed, action=GO)[-1]
    assert truncations == dict.fromkeys(infos, True)
    assert len(infos) > 1
    assert [agent for agent in infos if terminations[agent]] == [agent for agent in infos if infos[agent]["crashed"]]
    assert terminations["cav_0"] is True


def test_who_can_only_wait_is_no_agent_unless_asked_for():
    everyone, drivers = everybody(), parallel_env()
    standing = all_others_wait(everyone)
    asked = {"seed": everyone.simulation.seed, "options": {"hazard": False}}
    observations, infos = everyone.reset(**asked)
    fewer, fewer_infos = drivers.reset(**asked)
    assert drivers.agents == ["cav_0"] == [agent for agent in everyone.agents if agent not in standing]
    while drivers.agents:
        assert same(fewer["cav_0"], observations["cav_0"])  # those that wait see and tell as before
        assert same(fewer_infos["cav_0"], infos["cav_0"])
        observations, rewards, _, _, infos = everyone.step(dict.fromkeys(everyone.agents, GO))
        fewer, fewer_rewards, _, _, fewer_infos = drivers.step({"cav_0": GO})
        assert fewer_rewards == {"cav_0": rewards["cav_0"]}
    assert drivers.outcomes == {"cav_0": "success"}


@pytest.mark.parametrize("team", [0.5, 1.0])
def test_the_team_s_share_of_a_reward_is_the_same_for_all(team: float):
    alone, together = (parallel_env("CADUnsignalised-v0", traffic="none", team=part) for part in (0.0, team))
    count = len(alone.reset(seed=1)[0])
    assert count == 4
    together.reset(seed=1)
    while alone.agents:
        actions = dict.fromkeys(alone.agents, GO)
        own, shared = alone.step(actions)[1], together.step(actions)[1]
        expected = {agent: (1 - team) * value + team * sum(own.values()) / count for agent, value in own.items()}
        assert shared == pytest.approx(expected)
    assert "collision" in alone.outcomes.values()


def test_a_waiting_agent_that_is_hit_has_crashed():
    env = everybody()
    all_others_wait(env)
    world, row = env.simulation.world, env.simulation.agents[2]
    world.position[row] = world.position[0]  # somebody is put on top of it
    _, rewards, terminations, _, infos = env.step(dict.fromkeys(env.agents, GO))
    assert rewards["cav_2"] == -1.0
    assert terminations["cav_2"] is True
    assert infos["cav_2"]["crashed"] is True
    assert env.outcomes["cav_2"] == "collision"


def test_time_is_up_after_max_cycles():
    env = everybody(max_cycles=7)
    history = drive(env, 0, action=BRAKE)
    assert len(history) == 8
    assert history[-1][3]["cav_0"] is True


def test_the_share_of_the_way_adds_up_to_one_for_whoever_arrives():
    env, arrived = everybody(), 0
    for seed in range(12):
        history = drive(env, seed, action=GO)
        for agent, outcome in env.outcomes.items():
            earned = sum(step[1].get(agent, 0.0) for step in history[1:])
            if outcome == "success":
                arrived += agent != "cav_0"
                assert earned == pytest.approx(2.0, abs=0.03)  # its way, and what it overshoots in its last step, and 1
    assert arrived > 0


def test_who_has_left_drives_on():
    env = everybody()
    for seed in range(20):  # until somebody leaves who has more road before it while another is under way
        env.reset(seed=seed)
        while len(env.agents) == 4:
            env.step(dict.fromkeys(env.agents, GO))
        if env.agents:
            break
    gone = next(k for k, agent in enumerate(env.possible_agents) if agent not in env.agents)
    row, outcome = env.simulation.agents[gone], env.outcomes[f"cav_{gone}"]
    progress = env.simulation.world.progress[row]
    env.step(dict.fromkeys(env.possible_agents, BRAKE))  # what it is asked to do now does not matter
    assert env.simulation.world.progress[row] > progress
    assert env.outcomes[f"cav_{gone}"] == outcome


def test_every_agent_can_ask_the_expert():
    env = everybody()
    for seed in range(1_000_000, 1_000_003):
        env.reset(seed=seed, options={"hazard": True})
        while env.agents:
            env.step({agent: Expert().act(env.truth(agent)) for agent in env.agents})
        assert env.outcomes["cav_0"] == "success"
        assert "collision" not in env.outcomes.values()
