"""Fleets: everybody is driven, every outcome is counted, and agents of one episode are not taken for independent."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scenes import Steady, Twitchy, everybody

from cad_env.envs.parallel import CADParallelEnv, parallel_env
from cad_env.rules.expert import Expert
from cad_env.rules.planner import Planner
from cad_env.scenarios import SCENARIOS
from cad_env.scoring.fleet import AgentEpisode, FleetEpisode, fleet_scores, fleet_table, rollout_fleet
from cad_env.scoring.interval import Share, clustered, wilson
from cad_env.types import BRAKE, GO


class OneByOne(Twitchy):
    """Twitchy without its batches."""

    act_batch = None


def identical(a: FleetEpisode, b: FleetEpisode) -> bool:
    """All of two episodes but the method, whose name may differ."""
    told = [(one.scenario, one.seed, one.hazard) for one in (a, b)]
    agents = [[(g.name, g.outcome, g.waits, g.bytes_sent, g.bytes_received, g.messages_lost) for g in one.agents]
              for one in (a, b)]  # fmt: skip
    actions = all(np.array_equal(x.action, y.action) for x, y in zip(a.agents, b.agents, strict=True))
    return told[0] == told[1] and agents[0] == agents[1] and actions


@pytest.mark.parametrize("gym_id", [scenario.gym_id for scenario in SCENARIOS.values()])
def test_decisions_in_batches_one_by_one_and_by_name_are_the_same_episode(gym_id: str):
    env = everybody(gym_id)
    together = rollout_fleet(env, Twitchy(), 3, "together")
    assert together.agents[0].bytes_received > 0
    for policies in (OneByOne(), {name: OneByOne() for name in env.possible_agents}):
        assert identical(together, rollout_fleet(env, policies, 3))
    assert not identical(together, rollout_fleet(env, Twitchy(), 4))


def test_an_episode_says_what_each_agent_did_and_how_it_ended():
    env = everybody()
    seen: dict[str, list[int]] = {}

    def watch(env: CADParallelEnv, observations: Mapping, actions: Mapping[str, int]) -> None:
        assert set(observations) >= set(actions) == set(env.agents)
        for agent, action in actions.items():
            seen.setdefault(agent, []).append(action)

    episode = rollout_fleet(env, Twitchy(), 10, "twitchy", hazard=False, watch=watch)
    assert (episode.scenario, episode.method, episode.seed, episode.hazard) == ("left_turn", "twitchy", 10, False)
    assert {agent.name: agent.outcome for agent in episode.agents} == env.outcomes
    for agent in episode.agents:
        assert agent.action.tolist() == seen[agent.name]
        assert agent.time == pytest.approx(0.1 * len(seen[agent.name]))
        assert agent.brakes == sum(seen[agent.name])
        assert agent.bytes_sent > 100 * len(seen[agent.name])  # every message has some bytes
        assert agent.waits == (agent.outcome == "waited")
    assert episode.time == max(agent.time for agent in episode.agents) == pytest.approx(0.1 * env.simulation.steps)


def test_everybody_may_be_driven_by_somebody_else():
    env = everybody("CADLeftTurn-v0", max_cycles=60)
    for seed in range(20):
        _, infos = env.reset(seed=seed)
        driving = [name for name, info in infos.items() if not info["waits"] and info["speed"] > 3.0]
        if len(driving) > 1:
            break
    brakes = driving[-1]
    assert brakes != "cav_0"
    policies = {name: Steady(BRAKE if name == brakes else GO) for name in env.possible_agents}
    by_name = {agent.name: agent for agent in rollout_fleet(env, policies, seed).agents}
    assert by_name[brakes].brakes == len(by_name[brakes].action)
    assert env.simulation.world.speed[env.simulation.agents[int(brakes[4:])]] == 0.0
    assert by_name["cav_0"].brakes == 0


def test_experts_are_given_the_truth_and_do_not_collide():
    env = everybody()
    for seed in range(1_000_000, 1_000_002):
        episode = rollout_fleet(env, Expert(), seed, hazard=True)
        assert episode.collisions == 0
        assert episode.agents[0].outcome == "success"
        assert rollout_fleet(env, Steady(GO), seed, hazard=True).agents[0].outcome == "collision"


def test_a_fleet_that_shares_collides_less_than_one_that_does_not():
    crashed = {}
    for radio in ("dsrc", "none"):
        env = everybody(radio=radio)
        crashed[radio] = sum(rollout_fleet(env, Planner(), seed, hazard=True).collisions for seed in range(12))
    assert crashed["dsrc"] <= 1 < crashed["none"]  # with gaps in streams even the told collide once in a while


@pytest.mark.parametrize(
    ("policies", "complaint"),
    [
        ({"cav_0": Planner()}, "missing: ['cav_1', 'cav_2', 'cav_3']"),
        ({f"cav_{k}": Planner() for k in range(5)}, "unknown: ['cav_4']"),
    ],
)
def test_names_that_do_not_fit_are_refused(policies: dict, complaint: str):
    with pytest.raises(ValueError, match=re.escape(complaint)):
        rollout_fleet(everybody(), policies, 0)


def episode(hazard: bool, *outcomes: str, brakes: int = 0, method: str = "c") -> FleetEpisode:
    """A fleet episode by hand: 2 s each, 100 bytes a decision."""
    action = np.array([BRAKE] * brakes + [GO] * (20 - brakes), np.int8)
    agents = [AgentEpisode(f"cav_{k}", o, o == "waited", action, 2000, 6000, 1) for k, o in enumerate(outcomes)]
    return FleetEpisode("left_turn", method, 0, hazard, tuple(agents))


def test_a_score_counts_episodes_agents_and_those_that_drive():
    rows = fleet_scores(
        [
            episode(True, "collision", "collision", "waited", "success"),
            episode(True, "success", "success", "success", "success"),
            episode(False, "timeout", "waited", "waited", "waited", brakes=1),
        ]
    )
    assert [row.hazard for row in rows] == ["all", "yes", "no"]
    everything, hazard, calm = rows
    assert (everything.episodes, hazard.episodes, calm.episodes) == (3, 2, 1)
    assert (everything.crashed_episodes.count, everything.crashed_episodes.of) == (1, 3)
    assert (everything.crashed_episodes.low, everything.crashed_episodes.high) == wilson(1, 3)
    assert (everything.collisions.count, everything.collisions.of) == (2, 12)
    assert (everything.successes.count, everything.successes.of) == (5, 8)
    assert (everything.timeouts.count, everything.waits) == (1, 4)
    assert everything.mean_time_success == pytest.approx(2.0)
    assert everything.bytes_per_second == pytest.approx(1000.0)
    assert everything.needless_brakes is None
    assert (calm.needless_brakes.count, calm.needless_brakes.of) == (1, 1)
    assert calm.mean_time_success is None
    table = fleet_table(rows).splitlines()
    assert len(table) == 5
    assert re.search(r"left_turn +c +all +3 +33\.3 \[ *6\.1, 79\.2\] +12 +16\.7 ", table[2])


def test_those_who_stand_and_wait_for_each_other_are_a_deadlock():
    env = parallel_env("CADUnsignalised-v0", radio="none", traffic="none", max_cycles=150)
    standing = rollout_fleet(env, Steady(BRAKE), 3)
    assert 1.0 < standing.deadlock < 4.0  # since they came to stand
    assert {agent.outcome for agent in standing.agents} == {"timeout"}
    brakes = {name: Steady(BRAKE if name == "cav_0" else GO) for name in env.possible_agents}
    assert rollout_fleet(env, brakes, 3).deadlock == np.inf  # only one of them stands
    (row, *_) = fleet_scores([standing, replace(standing, deadlock=np.inf)])
    assert (row.deadlocks.count, row.deadlocks.of) == (1, 2)
    assert " 50.0 " in fleet_table([row])


def test_contenders_come_in_the_order_of_their_first_episode():
    rows = fleet_scores([episode(True, "success", method=name) for name in ("b", "a", "b")])
    assert [(row.method, row.hazard) for row in rows] == [("b", "all"), ("b", "yes"), ("a", "all"), ("a", "yes")]


def test_the_interval_of_independent_agents_is_wilson_s_and_of_a_crowd_that_fares_alike_that_of_episodes():
    rng = np.random.default_rng(0)
    independent = rng.binomial(4, 0.1, 2000)
    share, count = clustered(independent.tolist(), [4] * 2000), int(independent.sum())
    assert (share.low, share.high) == pytest.approx(wilson(count, 8000), rel=0.05)
    alike = 4 * rng.binomial(1, 0.1, 500)
    share = clustered(alike.tolist(), [4] * 500)
    assert (share.low, share.high) == pytest.approx(wilson(int(alike.sum()) // 4, 500), rel=1e-6)


def test_where_nothing_happened_the_interval_is_that_of_as_many_agents_as_episodes():
    assert clustered([0] * 50, [4] * 50) == Share(0, 200, 0.0, pytest.approx(wilson(0, 50)[1]))
    assert clustered([4] * 50, [4] * 50) == Share(200, 200, pytest.approx(wilson(50, 50)[0]), 1.0)


def test_the_interval_covers_the_truth_as_often_as_it_says():
    # Half of the episodes are bad ones, in which an agent collides with 0.4; in the others none does.
    rng, held = np.random.default_rng(1), 0
    for _ in range(400):
        counts = rng.binomial(4, 0.4 * rng.binomial(1, 0.5, 60))
        share = clustered(counts.tolist(), [4] * 60)
        held += share.low <= 0.2 <= share.high
    assert 0.92 <= held / 400 <= 0.98
