"""A run in parts is the run in one piece."""

import json
import shutil
from pathlib import Path

import pytest

import evaluate
from baselines.evaluation.grid import grid
from baselines.evaluation.report import write_report
from baselines.evaluation.store import Merging, merged
from cad_env.files import FileError
from cad_env.scoring.scorecard import parse_record

SOME = ["--scenario", "left_turn", "--method", "always-go", "planner-own", "--episodes", "30"]


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """SOME, finished in two parts."""
    folder = tmp_path_factory.mktemp("shards")
    for part in ("1/2", "2/2"):
        assert evaluate.main([*SOME, "--shard", part, "--out", str(folder)]) == 0
    return [folder / f"shard_{k}_of_2" for k in (1, 2)]


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert evaluate.main(["--merge", *map(str, arguments)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ")
    assert said.err.count("\n") == 1
    return said.err


@pytest.mark.parametrize("count", [1, 2, 3, 7, 50])
def test_every_episode_is_in_exactly_one_shard(count: int) -> None:
    whole = (["left_turn", "overtaking"], ["expert", "always-go"], range(10, 110))
    parts = [grid(*whole, f"{k + 1}/{count}") for k in range(count)]
    keys = [key for part in parts for task in part for key in task.episodes()]
    assert len(keys) == len(set(keys)) == 400
    assert set(keys) == {key for task in grid(*whole) for key in task.episodes()}


def test_merged_shards_are_the_files_of_the_whole_run(shards: list[Path], tmp_path: Path) -> None:
    assert evaluate.main([*SOME, "--out", str(tmp_path / "whole")]) == 0
    assert evaluate.main(["--merge", *map(str, reversed(shards)), "--out", str(tmp_path / "merged")]) == 0
    assert files(tmp_path / "merged") == files(tmp_path / "whole")


def test_a_shard_shows_no_scores_but_says_how_to_go_on(shards: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main([*SOME, "--shard", "1/2", "--out", str(shards[0].parent)]) == 0
    said = capsys.readouterr().out
    assert "--merge" in said
    assert "%" not in said
    assert not (shards[0] / "scores.json").exists()


def test_a_merged_folder_is_a_finished_run(shards: list[Path], tmp_path: Path) -> None:
    merged(Merging(tuple(shards), tmp_path))
    first = (tmp_path / "episodes.jsonl").read_text().splitlines()[0]
    marked = first.replace('"brakes": 0', '"brakes": 12345')
    (tmp_path / "episodes.jsonl").write_text((tmp_path / "episodes.jsonl").read_text().replace(first, marked, 1))
    assert evaluate.main([*SOME, "--out", str(tmp_path)]) == 0
    assert parse_record((tmp_path / "episodes.jsonl").read_text().splitlines()[0]).brakes == 12345


def test_a_missing_shard_is_noticed(shards: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refusal(capsys, shards[0], "--out", tmp_path / "out")
    assert "lack 15 of 90 episodes, such as seed 1000025 of always-go in left_turn" in said
    assert not (tmp_path / "out").exists()


def test_shards_of_different_runs_are_refused_by_name(
    shards: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate.main([*SOME, "--depth", "2", "--shard", "2/2", "--out", str(tmp_path)]) == 0
    said = refusal(capsys, shards[0], tmp_path / "shard_2_of_2", "--out", tmp_path / "out")
    assert "another depth (15, now 2)" in said
    assert not (tmp_path / "out").exists()


def test_shards_are_not_merged_into_the_results_of_another_run(
    shards: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate.main(["--method", "always-go", "--episodes", "1", "--out", str(tmp_path)]) == 0
    before = files(tmp_path)
    assert "another" in refusal(capsys, *shards, "--out", tmp_path)
    assert files(tmp_path) == before


def test_what_is_no_shard_is_refused(shards: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "nowhere" in refusal(capsys, tmp_path / "nowhere")
    assert "merge must name at least one folder" in refusal(capsys, "--out", tmp_path)
    assert "Unrecognized options: --episodes" in refusal(capsys, *shards, "--episodes", "3")
    (tmp_path / "settings.json").write_text("{}")
    assert "settings.json: scenario is missing" in refusal(capsys, tmp_path, "--out", tmp_path / "out")


@pytest.mark.parametrize(
    ("setting", "value", "reason"),
    [
        ("radio", {"rate": "abc"}, "radio.rate must be a number, got 'abc'"),
        ("radio of planner-own", {"rate": []}, "radio of planner-own.rate must be a number, got []"),
        ("method", "always-go", "method must be a list of names, got 'always-go'"),
        ("method", [["always-go"]], "method must be a list of names"),
        ("scenario", {}, "scenario must be a list of names"),
        ("episodes", 10**400, "episodes must be a whole number from 1 to 10000000, got 1000"),
        ("episodes", True, "episodes must be a whole number"),
        ("first_seed", 1.5, "first_seed must be a whole number from 0 on, got 1.5"),
        ("first_seed", -1, "first_seed must be a whole number from 0 on, got -1"),
        ("knowledge of mine:Policy", ["the truth"], "knowledge of mine:Policy must be one of nothing, "),
    ],
)
def test_damaged_settings_of_a_shard_are_refused_with_file_and_field(
    setting: str, value: object, reason: str, shards: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "shard"
    shutil.copytree(shards[0], folder)
    path = folder / "settings.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {setting: value}))
    assert f"error: {path}: {reason}" in refusal(capsys, folder, shards[1], "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(FileError, match="shard"):
        write_report(folder)


@pytest.mark.parametrize("depth", [80, 3000])
def test_a_setting_of_a_shard_may_not_be_nested_for_ever(
    depth: int, shards: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "settings.json"
    path.write_text('{"method": %s}' % ("[" * depth + "]" * depth))
    assert f"{path}: not JSON of at most 64 levels" in refusal(capsys, tmp_path, "--out", tmp_path / "out")
