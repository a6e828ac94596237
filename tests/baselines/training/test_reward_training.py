"""train.py with methods that learn by reward."""

from pathlib import Path

import pytest

from baselines.cli import parsed
from baselines.methods import shipped_models
from baselines.training.command import TrainSettings, main
from baselines.training.config import DECISION, RewardTask, claim_folder, perform_training
from cad_env.checks import ConfigError
from policies.model_folder import load_model
from policies.training import ppo


def task_of(out: Path, *words: str) -> RewardTask:
    """The only task of a command."""
    (task,) = parsed(TrainSettings, ["--scenario", "left_turn", "--out", str(out), *words]).tasks()
    assert isinstance(task, RewardTask)
    return task


def test_each_method_begins_with_what_it_says(tmp_path: Path) -> None:
    scratch = task_of(tmp_path, "--method", "ppo", "--decisions", "1000", "--reward", "progress", "--seed", "3")
    assert (scratch.config.clone, scratch.config.reward, scratch.seed, scratch.work()) == (
        None, "progress", 3, 1000 * DECISION,
    )  # fmt: skip
    shipped = str(shipped_models() / "stgraph-motion")
    assert task_of(tmp_path, "--method", "ppo-from-clone").config.clone == shipped
    own = task_of(tmp_path, "--method", "ppo-from-clone", "--clone", str(tmp_path / "mine"))
    assert own.config.clone == str(tmp_path / "mine")
    assert load_model(shipped).network.config == scratch.config.network


def test_it_trains_a_model_that_loads_and_refuses_to_mix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("SCENES_AT_ONCE", 2), ("ROLLOUT", 64), ("PART", 128)):
        monkeypatch.setattr(ppo, name, value)
    told: list[float] = []
    task = task_of(tmp_path, "--method", "ppo-from-clone", "--decisions", "256")
    perform_training(task, told.append)
    assert sum(told) == pytest.approx(task.work())
    saved = load_model(task.folder)
    assert saved.training["decisions"] == 256
    assert saved.training["ppo"]["clone"] == "stgraph-motion"
    claim_folder(task)
    with pytest.raises(ConfigError, match=r"ppo-from-clone holds a run with another reward .* use another --out"):
        claim_folder(task_of(tmp_path, "--method", "ppo-from-clone", "--decisions", "256", "--reward", "progress"))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--method", "ppo", "--reward", "fast"], "reward must be one of progress, safety-first, time-and-safety"),
        (["--method", "ppo", "--clone", "models/mine"], "clone is what ppo-from-clone begins with, got models/mine"),
        (["--method", "ppo", "--decisions", "0"], "decisions must be a whole number from 1 to"),
        (["--method", "ppo-from-clone", "--clone", "nowhere"], "nowhere"),
    ],
)
def test_nonsense_is_refused_in_one_line(words: list[str], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    said = capsys.readouterr().err.strip()
    assert reason in said
    assert "\n" not in said
