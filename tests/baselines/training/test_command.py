"""The training command, as its users run it."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE
from stopped_runs import AT_FIRST_REPORT, last_words, stopped_run

from baselines.evaluation.run import opened_store
from baselines.evaluation.training_seeds import runs_of
from baselines.methods import shipped_models
from baselines.training import command as train
from cad_env.scenarios import SHIPPED

ROOT = Path(__file__).parents[3]
TINY = ["--episodes", "6", "--dagger_rounds", "0", "--steps", "9", "--validation", "2", "--score", "2"]


def claimed(settings: train.TrainSettings) -> None:
    for task in settings.tasks():
        train.claim_folder(task)


def command(*arguments: str) -> list[str]:
    return [sys.executable, str(ROOT / "train.py"), *arguments]


RESUME = ["stopped; run the same command to resume"]


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_stopped_by_sigterm_it_ends_as_by_ctrl_c(tmp_path: Path) -> None:
    ended, said = stopped_run("train", [*TINY, "--out", "run"], AT_FIRST_REPORT, "SIGTERM", True, tmp_path)
    assert (ended, last_words(said)) == (143, RESUME)
    assert list(tmp_path.glob("run/demonstrations/*/shard_?????.npz"))


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_stopped_by_ctrl_c_it_goes_on_to_a_table(tmp_path: Path) -> None:
    out = tmp_path / "run"
    ended, said = stopped_run("train", [*TINY, "--out", str(out)], AT_FIRST_REPORT, "SIGINT", True, tmp_path)
    assert (ended, last_words(said)) == (130, RESUME)
    # Every process has ended, so nothing is renamed any more. A shard that is begun goes when it is whole.
    kept = {shard: shard.stat().st_mtime_ns for shard in out.glob("demonstrations/*/shard_?????.npz")}
    assert kept
    second = subprocess.run(
        command(*TINY, "--out", str(out)), capture_output=True, text=True, cwd=tmp_path, timeout=PATIENCE, check=False
    )
    assert second.returncode == 0, second.stderr
    assert all(shard.stat().st_mtime_ns == then for shard, then in kept.items())
    assert "stgraph-motion-own" in second.stdout
    for name in train.MAIN_METHODS:
        assert {"model.safetensors", "config.json", "metrics.csv"} <= {p.name for p in (out / name).iterdir()}
    rows = json.loads(next(out.glob("scores_*/scores.json")).read_text())
    assert {row["method"] for row in rows} == {*train.REFERENCE_METHODS, *train.MAIN_METHODS}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scenario", "left_trun"], "left_trun.*left_turn"),
        (["--scenario", "left_turn", "left_turn"], "each once.*left_turn left_turn"),
        (["--radio", "dsrk"], "dsrk.*dsrc"),
        (["--radio", "none"], "radio must be one that carries something"),
        (["--episodes", "0"], "episodes must be a whole number from 1"),
        (["--steps", "many"], "steps"),
        (["--setps", "9"], "setps"),
        (["--method", "stgraf"], "stgraf.*stgraph-own"),
        (["--seed", "1", "1"], "seed must name at least one, each once"),
        (["--mixing", "2"], "mixing must be a number from 0 to 1"),
    ],
)
def test_bad_input_is_one_clear_line(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train.main([*arguments, "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(message, error), error
    assert not (tmp_path / "run").exists()


def test_a_folder_of_another_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = train.TrainSettings(out=tmp_path / "run", steps=9)
    claimed(settings)
    claimed(settings)
    assert train.main(["--out", str(tmp_path / "run"), "--steps", "12"]) == 2
    assert "another steps (9, now 12)" in capsys.readouterr().err


def test_a_folder_of_other_scenarios_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    claimed(train.TrainSettings(out=tmp_path / "run", scenario=("left_turn",)))
    others = tuple(name for name in SHIPPED if name != "left_turn")
    assert train.main(["--out", str(tmp_path / "run"), "--scenario", *others]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert 'another scenarios (["left_turn"], now ["overtaking", "street_crossing"])' in error


def test_other_rows_are_scored_in_folders_of_their_own_over_the_radio_they_learned_over(tmp_path: Path) -> None:
    usual, other = (
        train.TrainSettings(out=tmp_path, **rows).scoring()
        for rows in ({}, {"method": ("compressed", "gat", "raw-points")})
    )
    assert [run.radio for run in usual] == ["dsrc"]
    learned = {name: run.radio for run in other for name in run.method if name not in train.REFERENCE_METHODS}
    assert learned == {"compressed": "cv2x", "gat": "dsrc", "raw-points": "ideal"}
    assert len({run.out for run in [*usual, *other]}) == 4


@pytest.mark.parametrize("seeds", [(0,), (0, 1)])
def test_a_row_that_is_added_can_be_scored_beside_an_earlier_run(tmp_path: Path, seeds: tuple[int, ...]) -> None:
    for rows in (("stgraph",), train.MAIN_METHODS, ("stgraph-own",)):
        settings = train.TrainSettings(out=tmp_path / "run", method=rows, seed=seeds, scenario=("left_turn",))
        for seed in seeds:
            shutil.copytree(shipped_models(), settings.models(seed), dirs_exist_ok=True)
        for run in settings.scoring():
            for part in runs_of(run).values() if len(seeds) > 1 else [run]:
                opened_store(part)


def test_one_scenario_several_or_all_have_folders_of_their_own() -> None:
    assert train.TrainSettings().folder() == Path("runs/all")
    assert train.TrainSettings(scenario=("left_turn",)).folder() == Path("runs/left_turn")
    assert train.TrainSettings().scenarios() == SHIPPED
    backwards = tuple(reversed(SHIPPED))
    assert train.TrainSettings(scenario=backwards).scenarios() == SHIPPED


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("in the way")
    assert train.main(["--out", str(tmp_path / "file" / "run")]) == 2
    assert capsys.readouterr().err.startswith("error: ")
