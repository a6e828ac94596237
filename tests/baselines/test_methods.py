"""Who drives, what is shared with it, and what is said when it cannot."""

import os
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from baselines import cli
from baselines.controls.names import best_control
from baselines.controls.policies import control
from baselines.evaluation.job import job_of
from baselines.evaluation.settings import Settings
from baselines.methods import (
    LEARNED,
    METHODS,
    SHIPPED_METHODS,
    Always,
    folder_of,
    how_to_train,
    learned_named,
    method_named,
    shipped_models,
)
from baselines.training.command import TrainSettings
from cad_env.checks import ConfigError
from cad_env.envs.single import CADEnv
from cad_env.files import FileError
from cad_env.rules.blind import Control
from cad_env.scenarios import SHIPPED
from cad_env.scoring.rollout import BatchPolicy, rollout
from cad_env.types import BRAKE, GO, Policy
from policies.model_folder import SavedModel, save_model
from policies.stgraph.config import StGraphConfig
from policies.stgraph.network import StGraphNet
from policies.stgraph.policy import StGraphPolicy


def policy_of(name: str, models: Path) -> Policy:
    """Who decides in a left turn."""
    return job_of(Settings(models=(models,)), "left_turn", name).policy


@pytest.fixture
def models(tmp_path: Path) -> Path:
    for seed, name in enumerate((name for name in SHIPPED_METHODS if name in LEARNED), 1):
        network = StGraphNet(StGraphConfig(**LEARNED[name].config), seed=seed)
        save_model(tmp_path / name, SavedModel(network, 0.2 * seed))
    return tmp_path


def test_the_table_has_its_rows_by_their_own_names() -> None:
    assert tuple(METHODS)[: len(SHIPPED_METHODS)] == SHIPPED_METHODS
    assert all(method_named(name).name == name for name in METHODS)


def test_of_those_that_ship_only_three_are_sent_anything() -> None:
    assert [name for name in SHIPPED_METHODS if method_named(name).shares] == [
        "planner-shared",
        "stgraph",
        "stgraph-motion",
    ]


def test_only_the_expert_sees_the_truth_and_a_control_its_own_row(models: Path) -> None:
    assert [name for name in SHIPPED_METHODS if policy_of(name, models).privileged] == ["best-blind", "expert"]
    assert isinstance(policy_of("best-blind", models), Control)


def test_the_best_control_is_that_of_the_scenario() -> None:
    for scenario in SHIPPED:
        assert job_of(Settings(), scenario, "best-blind").policy == control(best_control(scenario), scenario)


def test_an_unknown_method_is_refused_with_the_choices() -> None:
    with pytest.raises(
        ValueError,
        match=r"unknown method 'planer': choose among always-go, .*, stgraph-own, .*; did you mean planner-\w+\?$",
    ):
        method_named("planer")


def test_always_is_always(models: Path) -> None:
    for name, action in (("always-go", GO), ("always-brake", BRAKE)):
        assert policy_of(name, models) == Always(action)


def test_each_learned_method_drives_its_own_model(models: Path) -> None:
    shared, own = (policy_of(name, models) for name in ("stgraph", "stgraph-own"))
    assert isinstance(shared, StGraphPolicy)
    assert isinstance(own, StGraphPolicy)
    assert isinstance(shared, BatchPolicy)
    assert (shared.threshold, own.threshold) == (0.2, 0.4)


def test_a_method_without_its_model_says_how_to_train_it(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"^gat needs training, and {tmp_path} has no model of it: `python train.py"):
        policy_of("gat", tmp_path)
    with pytest.raises(ConfigError, match="leave out --models for the model that ships"):
        policy_of("stgraph-own", tmp_path)
    with pytest.raises(ConfigError, match=r"^ppo needs training, .*: `python train\.py --method ppo --out runs/ppo`"):
        job_of(Settings(), "left_turn", "ppo")
    with pytest.raises(ConfigError, match="expert is not learned: choose among stgraph, "):
        learned_named("expert")


@pytest.mark.parametrize("name", [name for name in METHODS if METHODS[name].learned])
def test_the_command_that_trains_a_method_is_one_that_exists(name: str) -> None:
    command, where = re.fullmatch(r"`python (.*)` trains it; then --models (.*)", how_to_train(name)).groups()  # type: ignore[union-attr]
    script, *words = shlex.split(command)
    settings = cli.parsed(TrainSettings, words)
    assert (script, settings.method, settings.models(0)) == ("train.py", (name,), Path(where))
    assert [task.folder for task in settings.tasks()] == [Path(where) / folder_of(name)]


def test_the_command_names_scenarios_that_do_not_ship() -> None:
    assert "train.py --scenario mine.road:ROAD --method gat " in how_to_train("gat", ["mine.road:ROAD"])


def test_a_damaged_model_is_refused(models: Path) -> None:
    os.truncate(models / "stgraph" / "model.safetensors", 100)
    with pytest.raises(FileError, match="truncated or altered"):
        policy_of("stgraph", models)


def test_shipped_models_are_looked_for_in_the_package() -> None:
    assert shipped_models().parts[-3:] == ("policies", "weights", "all")


def test_going_blindly_crashes_and_standing_never_arrives() -> None:
    env = CADEnv(scenario="left_turn", radio="none")
    going = [rollout(env, Always(GO), seed, hazard=True) for seed in range(10)]
    standing = [rollout(env, Always(BRAKE), seed, hazard=True) for seed in range(3)]
    assert sum(episode.outcome == "collision" for episode in going) >= 8
    assert {episode.outcome for episode in standing} == {"timeout"}
    assert np.concatenate([episode.bytes_sent for episode in going]).sum() == 0
