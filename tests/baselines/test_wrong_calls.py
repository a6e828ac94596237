"""Commands and their settings that are called wrongly are refused in one line, before anything is made or driven."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evaluate
import reproduce
import train
from baselines.evaluation.settings import Settings
from baselines.evaluation.store import Merging
from baselines.methods import learned_named
from baselines.paper.command import ReproduceSettings
from baselines.training.command import TrainSettings
from baselines.training.config import training_config
from cad_env.animation import write_gif
from policies.model_folder import load_model
from policies.stgraph.config import StGraphConfig
from policies.training.config import TrainingConfig, small_seed

WRONG_COMMANDS: list[tuple[Callable[[list[str]], int], list[str], str]] = [
    (evaluate.main, ["--budget", "inf"], "budget must be a number from 0 to 1.25e+10, got inf"),
    (evaluate.main, ["--budget", "nan"], "budget must be a number from 0 to 1.25e+10, got nan"),
    (evaluate.main, ["--budget", "-1"], "budget must be a number from 0 to 1.25e+10, got -1.0"),
    (evaluate.main, ["--gnss-yaw-noise", "nan"], "gnss_yaw_noise must be a number from 0 to 180, got nan"),
    (evaluate.main, ["--collaborators", "99"], "collaborators must be a whole number from 0 to 20, got 99"),
    (evaluate.main, ["--first-seed", "-1"], "first-seed must be a whole number from 0 on, got -1"),
    (evaluate.main, ["--out", ""], "out must not be empty, got ''"),
    (evaluate.main, ["--out="], "out must not be empty, got ''"),
    (evaluate.main, ["--method", "expert", ""], "must not be empty, got ''"),
    (evaluate.main, ["--merge", "a", "--out", ""], "out must not be empty, got ''"),
    (train.main, ["--steps", "-5"], "steps must be a whole number from 3 to 10000000, got -5"),
    (train.main, ["--steps", "1"], "steps must be a whole number from 3 to 10000000, got 1"),
    (train.main, ["--validation", "0"], "validation must be a whole number from 1 to 50000, got 0"),
    (train.main, ["--seed", "-1"], "seed must be a whole number from 0 on, got -1"),
    (train.main, ["--out", ""], "out must not be empty, got ''"),
    (reproduce.main, ["--merge", "--out", "nowhere"], "there is no reproduce.json in nowhere"),
    (reproduce.main, ["--out", ""], "out must not be empty, got ''"),
]


@pytest.mark.parametrize(("command", "words", "reason"), WRONG_COMMANDS)
def test_a_wrong_command_is_refused_in_one_line_and_makes_nothing(
    command: Callable[[list[str]], int], words: list[str], reason: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert command(words) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert reason in said.err
    assert list(tmp_path.iterdir()) == []


WRONG_SETTINGS: list[tuple[type, dict[str, Any], str]] = [
    (Settings, {"out": ""}, "out must be a path, got ''"),
    (Settings, {"out": 3}, "out must be a path, got 3"),
    (Settings, {"out": b"x"}, "out must be a path, got b'x'"),
    (Settings, {"models": 3}, "models must be a path, got 3"),
    (Settings, {"method": 3}, "method must be a text, got 3"),
    (Settings, {"method": {"expert"}}, "method must be a text, got {'expert'}"),
    (Settings, {"scenario": ()}, "scenario must name at least one, each once"),
    (Settings, {"scenario": "left"}, "unknown scenario 'left'"),
    (Settings, {"episodes": 3.0}, "episodes must be a whole number from 1 to 10000000, got 3.0"),
    (Settings, {"jobs": True}, "jobs must be a whole number from 1 to 256, got True"),
    (Settings, {"report": "no"}, "report must be True or False, got 'no'"),
    (Settings, {"shard": 3}, "shard must be a text, got 3"),
    (Settings, {"hazard": ["yes"]}, "hazard must be one of all, yes, no"),
    (Settings, {"depth": 5.0}, "depth must be a whole number from 1 to 15, got 5.0"),
    (Merging, {"merge": "x", "report": 1}, "report must be True or False, got 1"),
    (Merging, {"merge": ("x", "")}, "merge must be a path, got ''"),
    (TrainSettings, {"seed": 1.0}, "seed must be a whole number from 0 on, got 1.0"),
    (TrainSettings, {"out": ""}, "out must be a path, got ''"),
    (TrainSettings, {"velocity": "no"}, "velocity must be True or False, got 'no'"),
    (TrainSettings, {"jobs": 1.5}, "jobs must be a whole number from 1 to 64, got 1.5"),
    (ReproduceSettings, {"merge": 1}, "merge must be True or False, got 1"),
    (ReproduceSettings, {"preset": ["quick"]}, "preset must be a text, got ['quick']"),
    (TrainingConfig, {"seed": True}, "seed must be a whole number from 0 on, got True"),
    (TrainingConfig, {"steps": 9.0}, "steps must be a whole number from 3 to 10000000, got 9.0"),
    (TrainingConfig, {"thresholds": "0.5"}, "thresholds must be a number from 0 to 1, got '0.5'"),
    (StGraphConfig, {"hidden": 12.0}, "network hidden must be a whole number from 1 to 256, got 12.0"),
    (StGraphConfig, {"velocity": 1}, "network velocity must be True or False, got 1"),
]


@pytest.mark.parametrize(("kind", "given", "reason"), WRONG_SETTINGS)
def test_wrong_settings_are_refused_in_one_line(kind: type, given: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011  the text is compared below
        kind(**given)
    assert reason in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_text_is_a_path_and_a_single_value_is_a_tuple() -> None:
    settings = Settings(scenario="left_turn", method="expert", models="here", out="there", episodes=np.int64(3))
    assert settings == Settings(("left_turn",), ("expert",), (Path("here"),), 3, out=Path("there"))
    assert settings == Settings(["left_turn"], ["expert"], [Path("here")], 3, out=Path("there"))
    assert hash(settings) == hash(Settings(("left_turn",), ("expert",), (Path("here"),), 3, out=Path("there")))
    assert Merging(merge="x", out="y") == Merging((Path("x"),), Path("y"))
    assert TrainSettings(method="stgraph", seed=3, out="x") == TrainSettings(
        method=("stgraph",), seed=(3,), out=Path("x")
    )
    assert TrainSettings(seed=range(2)).seed == (0, 1)
    assert ReproduceSettings(out="x", method="stgraph") == ReproduceSettings(out=Path("x"), method=("stgraph",))
    assert TrainingConfig(scenarios="left_turn", thresholds=np.float64(0.5)).scenarios == ("left_turn",)


def test_numpy_s_numbers_are_written_as_python_s_own() -> None:
    settings = Settings(loss=np.float64(0.25), penetration=np.float32(0.5), depth=np.int64(3), report=np.bool_(True))
    assert settings == Settings(loss=0.25, penetration=0.5, depth=3)
    assert {type(getattr(settings, name)) for name in ("loss", "penetration", "depth", "report")} == {float, int, bool}
    config = StGraphConfig(hidden=np.int64(8), velocity=np.bool_(True))
    assert (type(config.hidden), type(config.velocity)) == (int, bool)


def test_steps_are_not_rounded_up_to_what_can_be_trained() -> None:
    with pytest.raises(ValueError, match="steps must be a whole number from 3 to 10000000, got 2"):
        training_config(learned_named("stgraph"), {"steps": 2})


@pytest.mark.parametrize("seed", [0, 2**31, 2**32 - 1])
def test_seeds_that_torch_takes_are_as_they_are(seed: int) -> None:
    assert small_seed(seed) == seed


def test_larger_seeds_of_training_are_drawn_from() -> None:
    drawn = [small_seed(seed) for seed in (2**32, 2**32 + 1, 2**63, 2**64, 2**70)]
    assert len(set(drawn)) == len(drawn)
    assert all(0 <= seed < 2**32 for seed in drawn)
    assert TrainingConfig(seed=2**70).seed == 2**70


def test_seeds_of_scoring_may_be_large() -> None:
    settings = Settings(first_seed=2**70, episodes=2)
    assert [seed for task in settings.tasks() for seed in task.seeds][:2] == [2**70, 2**70 + 1]


def test_a_film_is_written_to_a_path_that_is_text(tmp_path: Path) -> None:
    frame = np.zeros((4, 4, 3), np.uint8)
    assert write_gif([frame], str(tmp_path / "film.gif")) == tmp_path / "film.gif"
    assert (tmp_path / "film.gif").read_bytes()[:3] == b"GIF"
    for nothing in ("", None, 3):
        with pytest.raises(ValueError, match="path must be a path, got"):
            write_gif([frame], nothing)
        with pytest.raises(ValueError, match="folder must be a path, got"):
            load_model(nothing)
