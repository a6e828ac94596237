"""A copy of an environment is a world of its own, equal in all it does next, whatever becomes of its original."""

import copy
import gc
import hashlib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordVectorStatistics
from pettingzoo import ParallelEnv

from cad_env.envs.fixed_agents import FixedAgents
from cad_env.envs.parallel import parallel_env
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.lidar.config import CloudConfig
from cad_env.rules.expert import Expert
from cad_env.simulation.simulation import Simulation

CLOUD = CloudConfig(azimuths=64, beams=4)
LATE = {"delay": 0.2, "loss": 0.3}  # messages are under way when a copy is made


def wrapped() -> gym.Env:
    """As most users have it, with what Gymnasium adds by itself."""
    env = gym.make("CADOvertaking-v0", radio=LATE)
    return gym.wrappers.RecordEpisodeStatistics(gym.wrappers.TimeLimit(env, 40))


ENVIRONMENTS: dict[str, Callable[[], Any]] = {
    "single": partial(CADEnv, radio=LATE, object_lists=True),
    "single with clouds": partial(CADEnv, cloud=CLOUD, radio=LATE),
    "single with a rule of its own": partial(CADEnv, share=copy.copy, radio=LATE),
    "wrapped": wrapped,
    "vector": partial(CADVectorEnv, 3, radio=LATE, traffic="dense", scenario=["left_turn", "overtaking"]),
    "vector, same step": partial(CADVectorEnv, 2, autoreset_mode="SameStep"),
    "vector that hands out its arrays": partial(CADVectorEnv, 2, copy=False, reward="progress"),
    "vector with clouds": partial(CADVectorEnv, 2, cloud=CLOUD, radio=LATE),
    "vector with a rule of its own": partial(CADVectorEnv, 2, share=copy.copy, radio=LATE),
    "wrapped vector": lambda: RecordVectorStatistics(CADVectorEnv(2)),
    "agents": partial(parallel_env, radio=LATE, max_cycles=40),
    "fixed agents": lambda: FixedAgents(parallel_env("CADOvertaking-v0", max_cycles=40)),
}
COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "cloudpickle": lambda env: cloudpickle.loads(cloudpickle.dumps(env)),
    "deepcopy twice": lambda env: copy.deepcopy(copy.deepcopy(env)),
}
CLOCKS = ("t", "episode_time", "episode_returns")  # what Gymnasium's own wrapper measures of the wall clock


def answers(env: Any, count: int = 50, first: int = 0) -> list[str]:
    """A digest of every answer to `count` decisions, which are the same for everybody; new episodes have no seed."""
    return [digest_of(answer(env, step)) for step in range(first, first + count)]


def answer(env: Any, step: int) -> Any:
    """What an environment says to one decision, or to being reset if it is over."""
    brakes = int(step % 7 > 4)
    if isinstance(env, ParallelEnv):
        return env.step(dict.fromkeys(env.agents, brakes)) if env.agents else env.reset()
    if isinstance(env, gym.vector.VectorEnv):
        return env.step(np.arange(env.num_envs) % 2 * brakes)
    return env.reset() if env.unwrapped.done or ended(env) else env.step(brakes)


def ended(env: gym.Env) -> bool:
    """Whether the time limit of `wrapped` has ended an episode."""
    return env.has_wrapper_attr("_elapsed_steps") and env.get_wrapper_attr("_elapsed_steps") >= 40


def digest_of(said: Any) -> str:
    sha = hashlib.sha256()
    feed(sha, said)
    return sha.hexdigest()


def feed(sha: Any, said: Any) -> None:
    """To the last bit, whatever it is nested in."""
    if isinstance(said, dict):
        for name in sorted(said):
            if name not in CLOCKS:
                sha.update(name.encode())
                feed(sha, said[name])
    elif isinstance(said, list | tuple) or (isinstance(said, np.ndarray) and said.dtype == object):
        for part in said:
            feed(sha, part)
    elif isinstance(said, np.ndarray):
        sha.update(f"{said.dtype} {said.shape}".encode() + said.tobytes())
    else:
        sha.update(repr(said).encode())


def begun(kind: str, steps: int = 20) -> Any:
    """An environment in the middle of an episode."""
    env = ENVIRONMENTS[kind]()
    env.reset(seed=4)
    answers(env, steps)
    return env


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("kind", ENVIRONMENTS)
def test_a_copy_does_what_its_original_does_and_neither_moves_the_other(kind: str, copied: Callable[[Any], Any]):
    expected = answers(begun(kind), first=20)
    assert len(set(expected)) == 50
    env = begun(kind)
    twin = copied(env)
    assert answers(twin, first=20) == expected  # the copy first: had it moved the original, that would differ now
    assert answers(env, first=20) == expected
    ahead = copied(env)
    answers(env, 5)
    assert answers(ahead, 5) == answers(copied(begun_at(kind, 70)), 5)


def begun_at(kind: str, steps: int) -> Any:
    """An environment after some of the decisions that `begun` and `answers` take."""
    env = begun(kind)
    answers(env, steps - 20, first=20)
    return env


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("kind", ENVIRONMENTS)
def test_a_copy_outlives_its_original(kind: str, copied: Callable[[Any], Any]):
    expected = answers(begun(kind), first=20)
    env = begun(kind)
    twin = copied(env)
    env.reset(seed=9)
    del env
    gc.collect()
    rubbish = [np.full(count, np.nan) for count in range(1, 400) for _ in range(8)]  # in what was freed
    assert answers(twin, first=20) == expected
    assert len(rubbish) == 8 * 399


@pytest.mark.parametrize("kind", ENVIRONMENTS)
def test_a_copy_of_what_has_not_begun_can_begin(kind: str):
    env = ENVIRONMENTS[kind]()
    twin = pickle.loads(cloudpickle.dumps(env))
    for each in (env, twin):
        each.reset(seed=4)
    assert answers(twin, 5) == answers(env, 5)


@pytest.mark.parametrize("kind", [kind for kind in ENVIRONMENTS if not kind.startswith("wrapped")])
def test_a_shallow_copy_is_a_whole_one(kind: str):
    # With Gymnasium's wrappers it is not: these share the environment that they wrap.
    expected = answers(begun(kind), first=20)
    env = begun(kind)
    twin = copy.copy(env)
    assert answers(twin, first=20) == expected
    assert answers(env, first=20) == expected


def test_a_copy_goes_on_in_another_process(tmp_path: Path):
    kinds = [kind for kind in ENVIRONMENTS if kind != "single with a rule of its own"]
    (tmp_path / "copies").write_bytes(cloudpickle.dumps({kind: begun(kind) for kind in kinds}))
    code = f"""
import pickle, sys
from test_copies import answers
copies = pickle.load(open({str(tmp_path / "copies")!r}, "rb"))
print(*(f"{{kind}}={{''.join(answers(env, first=20))}}" for kind, env in copies.items()), sep="\\n")
"""
    here = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    said = subprocess.run([sys.executable, "-c", code], env=here, check=True, capture_output=True, text=True)
    expected = [f"{kind}={''.join(answers(begun(kind), first=20))}" for kind in kinds]
    assert said.stdout.splitlines() == expected


def test_the_parts_of_an_environment_can_be_copied_too():
    env = begun("vector")
    for part in (env.batch, env.batch.simulations[1]):
        for copied in (*COPIES.values(), copy.copy):
            twin = copied(part)
            simulations = [twin] if isinstance(twin, Simulation) else twin.simulations
            before = [simulation.world.position.copy() for simulation in env.batch.simulations]
            for simulation in simulations:
                simulation.step(np.zeros(len(simulation.agents), np.int64))
                assert simulation.steps == 21
            for simulation, place in zip(env.batch.simulations, before, strict=True):
                assert simulation.steps == 20
                assert simulation.world.position.tobytes() == place.tobytes()


def test_a_privileged_policy_may_keep_a_copy_of_the_truth():
    env = begun("vector")
    which = np.arange(3)
    kept = copy.deepcopy(env.batch.truths(which))
    decided = Expert().act_batch(env.batch.truths(which)).tolist()
    del env
    gc.collect()
    assert Expert().act_batch(kept).tolist() == decided


def test_a_copied_batch_shows_what_its_own_steps_fill():
    env = begun("vector that hands out its arrays")
    twin = copy.deepcopy(env)
    shown = twin.step(np.zeros(2, np.int64))[0]
    assert all(shown[name].tobytes() == part.tobytes() for name, part in env.step(np.zeros(2, np.int64))[0].items())
    assert not any(np.shares_memory(shown[name], part) for name, part in env.batch.observations.items())
    simulation = twin.batch.simulations[1]
    assert all(part.tobytes() == shown[name][1].tobytes() for name, part in simulation.observation(0).items())


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("make", [CADEnv, parallel_env])
def test_what_was_drawn_can_be_copied(make: Callable[..., Any], copied: Callable[[Any], Any]):
    env = make(render_mode="rgb_array")
    env.reset(seed=1)
    image = env.render()
    twin = copied(env)
    assert (twin.render() == image).all()
    answers(twin, 10)
    assert (twin.render() != image).any()
    assert (env.render() == image).all()
    twin.close()
    assert (env.render() == image).all()
    env.close()
