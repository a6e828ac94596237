"""What info says is the same in every environment: the same keys, types and values, also where there is no value."""

import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from pettingzoo.utils import parallel_to_aec

from cad_env.envs.fixed_agents import WHOLE, FixedAgents
from cad_env.envs.parallel import CADParallelEnv, parallel_env
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.types import BRAKE, GO

ID = "CADLeftTurn-v0"
WITH_HAZARD, WITHOUT = 4, 5  # seeds; without, an ego that never brakes meets nobody
SEEDS = [WITHOUT, WITH_HAZARD]
STEPS = 40
OPTIONS = {"ranges": {"collaborators": (3, 3)}, "traffic": "dense"}
EPISODE = {"seed": int, "hazard": bool, "hazard_time": float}
SINGLE = {
    **EPISODE, "speed": float, "crashed": bool, "outcome": object, "is_success": bool, "min_ttc": float,
    "struck_from_behind": bool,
    "bytes_sent": int, "bytes_received": int, "largest_message": int, "messages_sent": int, "messages_lost": int,
    "messages_refused": int, "refused": object,
}  # fmt: skip
PARALLEL = {
    **EPISODE, "waits": bool, "is_success": bool, "crashed": bool, "covered": float, "speed": float,
    "struck_from_behind": bool,
    "bytes_sent": int, "bytes_received": int, "messages_lost": int, "messages_refused": int,
}  # fmt: skip
FIXED = {
    **{name: kind for name, kind in PARALLEL.items() if name != "seed"},
    "seed_high": int, "seed_low": int, "present": bool,
}  # fmt: skip


def action(step: int) -> int:
    return BRAKE if step % 3 == 0 else GO


def alone(env: gym.Env, seed: int) -> list[dict[str, Any]]:
    """The infos of an episode's first steps."""
    infos = [env.reset(seed=seed)[1]]
    return infos + [env.step(action(step))[-1] for step in range(STEPS)]


def together(envs: gym.vector.VectorEnv) -> list[list[dict[str, Any]]]:
    """The same of every seed from a vector environment, as dicts of numpy's numbers."""
    infos = [envs.reset(seed=SEEDS)[1]]
    infos += [envs.step(np.full(len(SEEDS), action(step)))[-1] for step in range(STEPS)]
    for info in infos:
        assert set(info) == {*SINGLE, *(f"_{name}" for name in SINGLE)}
        assert all(info[f"_{name}"].all() for name in SINGLE)
    return [[{name: info[name][place] for name in SINGLE} for info in infos] for place in range(len(SEEDS))]


def equal(one: Any, other: Any) -> bool:
    """Equal, NaN to NaN."""
    return bool(one == other) or (isinstance(one, float) and math.isnan(one) and math.isnan(other))


def assert_same(one: dict[str, Any], other: dict[str, Any], names: set[str]) -> None:
    assert [name for name in names if not equal(one[name], other[name])] == []


@pytest.mark.parametrize("seed", SEEDS)
def test_of_one_ego_by_any_way_to_make_it(seed: int):
    expected = alone(CADEnv(**OPTIONS), seed)
    assert all({name: type(info[name]) for name in info if SINGLE[name] is not object} ==
               {name: kind for name, kind in SINGLE.items() if kind is not object} for info in expected)  # fmt: skip
    assert all(set(info) == set(SINGLE) for info in expected)
    for one, other in zip(expected, alone(gym.make(ID, **OPTIONS), seed), strict=True):
        assert set(other) == set(SINGLE)
        assert_same(one, other, set(SINGLE))
    assert math.isinf(expected[0]["hazard_time"]) is (seed == WITHOUT)


@pytest.mark.parametrize("mode", ["vector_entry_point", "sync", "async"])
def test_of_many_egos_as_of_each_alone(mode: str):
    kinds = {bool: np.bool_, int: np.int64, float: np.float64}
    envs = gym.make_vec(ID, num_envs=len(SEEDS), vectorization_mode=mode, **OPTIONS)
    for seed, infos in zip(SEEDS, together(envs), strict=True):
        for one, other in zip(alone(CADEnv(**OPTIONS), seed), infos, strict=True):
            assert_same(one, other, set(SINGLE))
            assert all(type(other[name]) is kinds.get(kind, type(one[name])) for name, kind in SINGLE.items())
    envs.close()


def test_at_the_end_of_an_episode_that_begins_anew_in_the_same_step():
    envs = CADVectorEnv(len(SEEDS), autoreset_mode="SameStep")
    envs.reset(seed=SEEDS)
    ended = np.zeros(len(SEEDS), bool)
    while not ended[0]:
        _, _, terminations, truncations, infos = envs.step(np.full(len(SEEDS), GO))
        ended = terminations | truncations
    final, single, over = infos["final_info"], CADEnv(), False
    single.reset(seed=SEEDS[0])
    while not over:
        _, _, terminated, truncated, info = single.step(GO)
        over = terminated or truncated
    assert math.isinf(info["hazard_time"])
    assert set(final) == set(infos) - {"final_info", "_final_info", "final_obs", "_final_obs"}
    assert_same(info, {name: final[name][0] for name in SINGLE}, set(SINGLE))


def assert_kinds(infos: dict[str, dict[str, Any]], kinds: dict[str, type]) -> None:
    for info in infos.values():
        assert {name: type(value) for name, value in info.items()} == kinds


@pytest.mark.parametrize("seed", SEEDS)
def test_of_every_connected_vehicle_and_of_the_whole_episode_as_of_the_ego(seed: int):
    single, env, fixed = CADEnv(**OPTIONS), parallel_env(ID, **OPTIONS), FixedAgents(parallel_env(ID, **OPTIONS))
    _, info = single.reset(seed=seed)
    infos, filled = env.reset(seed=seed)[1], fixed.reset(seed=seed)[1]
    while env.agents:
        assert_kinds(infos, PARALLEL)
        assert_kinds(filled, FIXED)
        for agent, told in infos.items():
            assert_same(told, info, set(EPISODE))
            assert_same(told, filled[agent], set(PARALLEL) - {"seed"})
        if "cav_0" in infos:
            assert_same(infos["cav_0"], info, set(SINGLE) & set(PARALLEL) - {"bytes_sent"})
        if "cav_0" in env.agents:
            *_, info = single.step(GO)
        *_, infos = env.step(dict.fromkeys(env.agents, GO))
        *_, filled = fixed.step(dict.fromkeys(fixed.agents, GO))


def test_in_turns_as_all_at_once():
    env, turns = parallel_env(ID), parallel_to_aec(parallel_env(ID))
    infos = env.reset(seed=WITHOUT)[1]
    turns.reset(seed=WITHOUT)
    assert_kinds(turns.infos, PARALLEL)
    for agent, info in infos.items():
        assert_same(info, turns.infos[agent], set(PARALLEL))


def varying(penetration: float = 0.4) -> CADParallelEnv:
    return parallel_env("CADOvertaking-v0", penetration=penetration)


@pytest.mark.parametrize("make", [varying, lambda: parallel_env(ID, ranges={"collaborators": (0, 4)})])
def test_with_fixed_agents_whoever_is_absent_has_the_same_keys(make: Callable[[], CADParallelEnv]):
    env, absent = FixedAgents(make()), 0
    for seed in (2**31 + 5, *range(5)):
        _, infos = env.reset(seed=seed)
        there = set(env.env.agents)
        while env.agents:
            assert list(infos) == env.possible_agents
            assert_kinds(infos, FIXED)
            episode = env.env.simulation.episode_info()
            for agent in env.possible_agents:
                info = infos[agent]
                assert info["seed_high"] * WHOLE + info["seed_low"] == seed
                assert np.float32(info["seed_high"]) == info["seed_high"]
                assert np.float32(info["seed_low"]) == info["seed_low"]
                assert_same(info, episode, {"hazard", "hazard_time"})
                if agent not in there:
                    absent += 1
                    said = [info[name] for name in FIXED if name not in {*EPISODE, "seed_high", "seed_low"}]
                    assert not any(said)
            *_, infos = env.step(dict.fromkeys(env.agents, GO))
    assert absent > 100
