"""The laws of the seed: 7, noise, radio and policy do not move the traffic, and 9, one seed is one episode."""

import json
import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import scenes
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import Steady, Twitchy, digest, started, steps

from cad_env.config import RadioConfig
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.scoring.rollout import Episode, rollout, rollouts
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, GO
from tests.laws.test_laws import EVERYWHERE, seeds

# --- 7. Named streams ------------------------------------------------------------------------------------------

OTHER_SETUPS = [
    {"sensor": {"noise": 3.0, "miss": 0.5, "gnss_noise": 5.0, "gnss_yaw_noise": 0.5, "range": 20.0}},
    {"radio": "none"},
    {"radio": {"loss": 0.9, "delay": 1.0}},
    {"depth": 1},
]


@EVERYWHERE
@settings(max_examples=5)
@given(seeds, st.sampled_from(OTHER_SETUPS))
def test_law_7_noise_and_radio_do_not_move_the_traffic(where: dict, seed: int, options: dict):
    usual, other = started(seed, **where), started(seed, **where, **options)
    assert usual.scene == other.scene
    for name, one, two in zip(usual.world._fields, usual.world, other.world, strict=True):
        assert one.tobytes() == two.tobytes(), name


@EVERYWHERE
@settings(max_examples=2)
@given(seeds)
def test_law_7_the_radio_does_not_move_what_the_sensors_report(where: dict, seed: int):
    radios = ("dsrc", "none", RadioConfig(loss=0.9, delay=0.3))
    simulations = [started(seed, **where, radio=radio) for radio in radios]
    for _ in zip(*(steps(simulation, 40) for simulation in simulations), strict=True):
        for agent in range(len(simulations[0].agents)):
            graphs = [simulation.own_graph(agent) for simulation in simulations]
            assert len({graph.position.tobytes() + graph.mask.tobytes() for graph in graphs}) == 1


@EVERYWHERE
@settings(max_examples=2)
@given(seeds)
def test_law_7_another_policy_meets_the_same_traffic(where: dict, seed: int):
    drawn = []
    env = CADEnv(**where)
    for policy in (Steady(GO), Steady(BRAKE), Twitchy()):
        rollout(env, policy, seed)
        env.reset(seed=seed)
        drawn.append(b"".join(part.tobytes() for part in env.simulation.world))
    assert len(set(drawn)) == 1


# --- 9. One seed, one episode ----------------------------------------------------------------------------------


@EVERYWHERE
@settings(max_examples=1)
@given(seeds)
def test_law_9_the_same_seed_gives_the_same_episode_twice(where: dict, seed: int):
    assert digest(seed, **where) == digest(seed, **where) != digest(seed + 1, **where)


def test_law_9_a_fresh_process_gives_the_same_episode():
    program = "import json, scenes; print(json.dumps([scenes.digest(seed) for seed in (1, 2)]))"
    env = {**os.environ, "PYTHONHASHSEED": "77"}
    here = Path(scenes.__file__).parent
    answer = subprocess.run(
        [sys.executable, "-c", program], cwd=here, env=env, capture_output=True, text=True, check=True
    )
    assert json.loads(answer.stdout) == [digest(1), digest(2)]


def facts(episode: Episode) -> list:
    """Everything an episode holds, comparable."""
    values = [getattr(episode, field.name) for field in fields(episode)]
    values = [value.tolist() if isinstance(value, np.ndarray) else value for value in values]
    return [None if value != value else value for value in values]  # a nan does not equal itself


def test_law_9_side_by_side_is_as_alone():
    numbers, seen = range(100, 113), {"alone": {}, "together": {}}

    def watch(how: str):
        def note(where: CADEnv | Simulation, observation: dict, action: int) -> None:
            simulation = where if isinstance(where, Simulation) else where.simulation
            parts = b"".join(observation[name].tobytes() for name in sorted(observation))
            seen[how].setdefault(simulation.seed, []).append((parts, action))

        return note

    alone = [rollout(CADEnv(), Twitchy(), number, watch=watch("alone")) for number in numbers]
    envs = CADVectorEnv(8)
    together = list(rollouts(envs, Twitchy(), numbers, watch=watch("together")))
    assert len(together) == len(alone)
    assert [episode.seed for episode in together] != list(numbers)  # they end in another order, and yet
    assert [facts(e) for e in sorted(together, key=lambda e: e.seed)] == [facts(e) for e in alone]
    assert seen["together"] == seen["alone"]


def test_law_9_an_episode_does_not_depend_on_those_before_it():
    env, fresh = CADEnv(), CADEnv()
    for seed in (5, 6, 7):
        rollout(env, Twitchy(), seed)
    assert facts(rollout(env, Twitchy(), 8)) == facts(rollout(fresh, Twitchy(), 8))


@pytest.mark.slow
def test_law_9_holds_for_many_seeds():
    envs = CADVectorEnv(64)
    together = {e.seed: facts(e) for e in rollouts(envs, Twitchy(), range(500))}
    env = CADEnv()
    assert all(facts(rollout(env, Twitchy(), seed)) == together[seed] for seed in range(500))
