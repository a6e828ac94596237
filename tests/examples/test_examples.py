"""The examples run, tiny."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
import torch

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name: str) -> ModuleType:
    """A script of the examples as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_the_fleets_of_three_contenders_are_scored():
    fleet = example("fleet")
    table = fleet.main(fleet.Settings(episodes=2)).splitlines()
    assert [line.split()[1] for line in table[2:] if " all " in line] == ["always-go", "planner-shared", "stgraph"]


@pytest.fixture
def _as_many_threads_as_before():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.mark.usefixtures("_as_many_threads_as_before")
def test_ppo_learns_to_drive_the_ego():
    table = example("ppo_sb3").main(steps=256, episodes=2, scenes=4).splitlines()
    assert [line.split()[1] for line in table[2:] if " all " in line] == ["before", "after"]


@pytest.mark.usefixtures("_as_many_threads_as_before")
def test_parameter_shared_ppo_learns_through_supersuit():
    pytest.importorskip("supersuit")
    ppo = example("ppo_parameter_sharing")
    settings = ppo.Settings(steps=64, scenes=2, rollout=8, episodes=1)
    table = ppo.main(settings).splitlines()
    assert [line.split()[1] for line in table[2:] if " all " in line] == ["before", "after"]


def test_the_vector_environment_has_every_agent_and_goes_on_to_the_next_scene():
    pytest.importorskip("supersuit")
    ppo = example("ppo_parameter_sharing")
    env = ppo.many_scenes(ppo.Settings(scenes=2, seed=3))
    again = ppo.many_scenes(ppo.Settings(scenes=2, seed=3))
    assert env.num_envs == 8
    env.reset()
    again.reset()
    ended = 0
    for _ in range(310):
        one, other = env.step([0] * 8), again.step([0] * 8)
        assert (one[1] == other[1]).all()
        assert one[2].reshape(2, 4).all(axis=1).tolist() == one[2].reshape(2, 4).any(axis=1).tolist()  # all together
        ended += int(one[2].sum())
    assert ended >= 8
