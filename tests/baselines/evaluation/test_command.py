"""The scoring command as it is asked: processes, folders, models, and one line for whatever is wrong."""

import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

import evaluate
from baselines import cli
from baselines.evaluation.run import identity
from baselines.evaluation.settings import Settings
from baselines.evaluation.store import Store, read_records
from baselines.methods import METHODS
from cad_env.scenarios import SHIPPED, scenario_names
from policies.model_folder import SavedModel, save_model
from policies.stgraph.network import StGraphNet
from tests.baselines.evaluation.test_run import SOME, Refused, files, run

torch.set_num_threads(1)


@pytest.fixture
def models(tmp_path: Path) -> Path:
    for name in ("stgraph", "stgraph-own"):
        save_model(tmp_path / "models" / name, SavedModel(StGraphNet(seed=1), 0.5))
    return tmp_path / "models"


def test_two_processes_give_the_files_of_one(models: Path, tmp_path: Path) -> None:
    some = ["--scenario", "left_turn", "--method", "stgraph", "expert", "--episodes", "26", "--models", str(models)]
    assert run(tmp_path / "one", *some) == 0
    assert run(tmp_path / "two", *some, "--jobs", "2") == 0
    assert files(tmp_path / "one") == files(tmp_path / "two")


def test_results_go_to_their_own_folder_unless_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert evaluate.main(["--scenario", "left_turn", "--method", "always-go", "--episodes", "1"]) == 0
    assert (tmp_path / "results" / "scores.json").exists()


def test_scenarios_come_in_the_order_they_are_asked_for() -> None:
    backwards = tuple(reversed(SHIPPED))
    assert Settings(scenario=backwards).scenarios() == backwards
    assert Settings().scenarios() == SHIPPED


def test_the_command_that_is_noted_asks_for_the_same_episodes() -> None:
    asked = Settings(scenario=("left_turn",), method=("expert",), loss=0.3, jobs=2, models=(Path("a b"),), shard="1/2")
    words = shlex.split(asked.command())
    assert words[:2] == ["python", "evaluate.py"]
    assert cli.parsed(Settings, words[2:]) == replace(asked, jobs=1, shard=None)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--scenario", "moon"], "unknown scenario 'moon': choose among left_turn"),
        (["--scenario", "left_turn", "left_turn"], "scenario must name at least one, each once"),
        (["--scenario"], "scenario must name at least one"),
        (["--shard", "0/2"], "shard must be i/n with i from 1 to n, such as 2/8, got '0/2'"),
        (["--shard", "3/2"], "shard must be i/n"),
        (["--shard", "half"], "shard must be i/n"),
        (["--method", "nobody"], "unknown method 'nobody': choose among always-go"),
        (["--method", "blind-soon"], "blind-D needs a number of seconds from 0 to 60, such as blind-0.5, got"),
        (["--method", "slow-0"], "slow-V needs a speed in m/s from 1 to 50, such as slow-5, got 'slow-0'"),
        (["--method", "expert", "expert"], "each once"),
        (["--method"], "at least one"),
        (["--radio", "am"], "unknown radio 'am': choose one of none, ideal, dsrc, cv2x"),
        (["--radoi", "dsrc"], "Unrecognized options: --radoi, dsrc; did you mean --radio?"),
        (["--gnss_nosie=1"], "; did you mean --gnss-noise?"),
        (["--no-repotr"], "; did you mean --no-report?"),
        (["--megre", "a", "b"], "; did you mean --merge?"),
        (["--episodes", "many"], "--episodes: invalid literal for int() with base 10: 'many'"),
        (["--episodes", "0"], "episodes must be a whole number from 1"),
        (["--episodes"], "'--episodes'"),
        (["--first-seed", "-1"], "first-seed must be a whole number from 0"),
        (["--jobs", "0"], "jobs must be a whole number from 1"),
        (["--loss", "1.1"], "radio loss must be a number from 0 to 1, got 1.1"),
        (["--loss", "nan"], "radio loss must be a number from 0 to 1, got nan"),
        (["--delay", "-0.1"], "radio delay"),
        (["--sensor-noise", "inf"], "sensor noise"),
        (["--gnss-noise", "-1"], "sensor gnss_noise"),
        (["--depth", "16"], "depth must be a whole number from 1 to 15, got 16"),
        (["--gif", "-1"], "gif must be a whole number from 0"),
        (["--gif", "1", "--shard", "1/2"], "gif is for a whole run"),
        (["--traffic", "heavy"], "traffic must be one of none, light, dense, got 'heavy'"),
        (["--penetration", "1.5"], "penetration must be a number from 0 to 1, got 1.5"),
        (["--hazard", "maybe"], "hazard must be one of all, yes, no, got 'maybe'"),
        (["--hazard", "yse"], "hazard must be one of all, yes, no, got 'yse'; did you mean yes?"),
        (["--radio", "DSRC"], "; did you mean dsrc?"),
        (["--traffic", "lihgt"], "; did you mean light?"),
        (["--scenario", "left-turn"], "; did you mean left_turn?"),
        (["--method", "stgraf"], "; did you mean stgraph?"),
        (["--backend", "rya"], "; did you mean ray?"),
        (["--method", "stgraph", "--models", "nowhere"], "stgraph needs training, and nowhere has no model of it"),
        (["--method", "gat"], "gat needs training, and "),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments: list[str], reason: str, refused: Refused, tmp_path: Path) -> None:
    assert reason in refused(tmp_path / "out", *arguments)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "box",
    [
        "╭─ Value error ──╮\n│ Error parsing  │\n│ --n: no number │\n│ ────────────── │\n│ See --help     │",
        " Value error     \n --------------- \n  Error parsing  \n  --n: no number \n  -------------- \n  See --help",
    ],
    ids=["frame", "plain"],
)
def test_the_command_lines_own_message_becomes_one_line(box: str) -> None:
    assert cli._first_part(box, "Settings") == "Error parsing --n: no number"
    assert cli._first_part(box.replace("parsing ", "parsing Settings: "), "Settings") == "--n: no number"


def test_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        evaluate.main(["--help"])
    assert stopped.value.code == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert all(word in shown for word in ("--sensor-noise", "blind-D", "stop-D", "slow-V", "best-blind"))
    assert f"Methods: {', '.join(METHODS)}" in shown
    assert f"Scenarios: {', '.join(scenario_names())}." in shown


def test_help_waits_for_no_heavy_import() -> None:
    heavy = ("torch", "numba", "highway_env", "matplotlib", "scipy.stats")
    code = f"import evaluate, sys; sys.exit(bool(set({heavy}) & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_another_model_in_the_same_folder_is_refused(refused: Refused, models: Path, tmp_path: Path) -> None:
    some = ["--scenario", "left_turn", "--method", "stgraph", "--episodes", "1", "--models", str(models)]
    assert run(tmp_path / "out", *some) == 0
    save_model(models / "stgraph", SavedModel(StGraphNet(seed=2), 0.5))
    assert "another model of stgraph (" in refused(tmp_path / "out", *some)


def test_a_threshold_takes_the_place_of_the_models_own(refused: Refused, models: Path, tmp_path: Path) -> None:
    some = [
        "--scenario",
        "left_turn",
        "--method",
        "stgraph",
        "always-go",
        "--episodes",
        "2",
        "--models",
        str(models),
    ]
    assert run(tmp_path / "out", *some, "--threshold", "0") == 0
    found = {record.method: record.outcome for record in read_records(tmp_path / "out")}
    assert found["stgraph"] == "timeout"  # whatever P(brake) is, it brakes
    assert found["always-go"] != "timeout"
    assert "another threshold (0.0, now 1.0)" in refused(tmp_path / "out", *some, "--threshold", "1")
    assert "threshold must be a number from 0 to 1, got 1.5" in refused(tmp_path / "new", *some, "--threshold", "1.5")


def _truncate(folder: Path) -> None:
    os.truncate(folder / "model.safetensors", 200)


def _alter(folder: Path) -> None:
    data = bytearray((folder / "model.safetensors").read_bytes())
    data[-1] ^= 1
    (folder / "model.safetensors").write_bytes(data)


def _spoil_config(folder: Path) -> None:
    (folder / "config.json").write_text("{")


def _lose_config(folder: Path) -> None:
    (folder / "config.json").unlink()


@pytest.mark.parametrize("damage", [_truncate, _alter, _spoil_config, _lose_config])
def test_a_damaged_model_is_refused(
    damage: Callable[[Path], Any], refused: Refused, models: Path, tmp_path: Path
) -> None:
    damage(models / "stgraph-own")
    some = ["--scenario", "left_turn", "--method", "always-go", "stgraph-own", "--models", str(models)]
    assert str(models / "stgraph-own") in refused(tmp_path / "out", *some)


@pytest.mark.parametrize("below", ["", "deeper"])
def test_a_folder_that_cannot_be_written_is_refused(below: str, refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert str(tmp_path / "file") in refused(tmp_path / "file" / below, *SOME)


def test_a_run_of_other_scenarios_is_another_run(refused: Refused, tmp_path: Path) -> None:
    settings = Settings(scenario=("left_turn",), method=("expert",), episodes=1)
    other = identity(settings) | {"scenario": ["left_turn", "overtaking"]}
    Store(tmp_path, other)
    some = ["--scenario", "left_turn", "--method", "expert", "--episodes", "1"]
    assert 'another scenario (["left_turn", "overtaking"], now ["left_turn"])' in refused(tmp_path, *some)


@pytest.mark.skipif(os.name != "posix", reason="locales as POSIX has them")
def test_a_run_whose_names_no_locale_can_write_ends_well(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252"}
    out = tmp_path / "results_训练"
    command = [sys.executable, evaluate.__file__, "--scenario", "left_turn", "--method", "always-go"]
    done = subprocess.run(
        [*command, "--episodes", "1", "--out", str(out)], env=environment, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr.count(b"Error")) == (0, 0)
    assert b"results_\\u8bad\\u7ec3" in done.stdout
    assert (out / "report.html").exists()
