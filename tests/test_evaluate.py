"""The scoring command: the same result however it is run, and one line for whatever is wrong."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

import evaluate
from baselines.scoring import identity, score
from baselines.settings import Settings
from baselines.store import Store
from cad_env.scenarios import SCENARIOS
from cad_env.score import Record, parse_record
from policies.saved import SavedModel, save_model
from policies.stgraph import StGraphNet

torch.set_num_threads(1)

SOME = ["--scenario", "left_turn", "--contender", "always-go", "planner-shared", "--episodes", "3"]
LONG = ["--scenario", "left_turn", "--contender", "always-brake", "--episodes", "75"]

Refused = Callable[..., str]


def run(folder: Path, *arguments: str) -> int:
    return evaluate.main([*arguments, "--no-report", "--out", str(folder)])


def records(folder: Path) -> list[Record]:
    return [parse_record(line) for line in (folder / "episodes.jsonl").read_text().splitlines()]


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of SOME."""
    folder = tmp_path_factory.mktemp("done")
    assert run(folder, *SOME) == 0
    return folder


@pytest.fixture
def copy(done: Path, tmp_path: Path) -> Path:
    """Another finished run of SOME, to be damaged."""
    folder = tmp_path / "copy"
    folder.mkdir()
    for name, data in files(done).items():
        (folder / name).write_bytes(data)
    return folder


@pytest.fixture
def models(tmp_path: Path) -> Path:
    for name in ("shared", "own"):
        save_model(tmp_path / "models" / name, SavedModel(StGraphNet(seed=1), 0.5))
    return tmp_path / "models"


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Refused:
    """Runs a command that must be refused; gives what was said."""

    def refusal(folder: Path, *arguments: str) -> str:
        capsys.readouterr()
        assert run(folder, *arguments) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        return said.err

    return refusal


def test_every_contender_meets_the_same_seeds_in_order(done: Path) -> None:
    assert [(record.contender, record.seed) for record in records(done)] == [
        (name, 1_000_000 + k) for name in ("always-go", "planner-shared") for k in range(3)
    ]
    by_seed: dict[int, set[bool]] = {}
    for record in records(done):
        by_seed.setdefault(record.seed, set()).add(record.hazard)
    assert all(len(kinds) == 1 for kinds in by_seed.values())


def test_records_hold_the_bytes_that_were_sent(done: Path) -> None:
    for record in records(done):
        if record.contender == "always-go":
            assert record.bytes_total == record.messages_sent == 0
            assert record.bytes_per_message_mean is record.bytes_per_message_max is None
        else:
            mean, largest = record.bytes_per_message_mean, record.bytes_per_message_max
            assert mean == pytest.approx(record.bytes_total / record.messages_sent, abs=1e-3)
            assert mean is not None
            assert largest is not None
            assert mean <= largest <= 25_000


def test_scores_and_table_come_with_intervals(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(copy, *SOME) == 0
    rows = json.loads((copy / "scores.json").read_text())
    assert {row["contender"] for row in rows} == {"always-go", "planner-shared"}
    assert {"collision_rate", "collision_low", "collision_high", "success_low", "timeouts"} <= rows[0].keys()
    assert "planner-shared" in capsys.readouterr().out


def test_another_program_gets_the_same_rows(done: Path, tmp_path: Path) -> None:
    rows = score(Settings(scenario=("left_turn",), contender=("always-go", "planner-shared"), episodes=3, out=tmp_path))
    assert [vars(row) for row in rows] == json.loads((done / "scores.json").read_text())


def test_two_processes_give_the_files_of_one(models: Path, tmp_path: Path) -> None:
    some = ["--scenario", "left_turn", "--contender", "stgraph", "expert", "--episodes", "26", "--policy", str(models)]
    assert run(tmp_path / "one", *some) == 0
    assert run(tmp_path / "two", *some, "--jobs", "2") == 0
    assert files(tmp_path / "one") == files(tmp_path / "two")


@pytest.mark.parametrize(("kind", "hazard"), [("yes", True), ("no", False)])
def test_a_hazard_can_be_forced(kind: str, hazard: bool, tmp_path: Path) -> None:
    assert (
        run(tmp_path, "--scenario", "left_turn", "--contender", "always-go", "--episodes", "6", "--hazard", kind) == 0
    )
    assert {record.hazard for record in records(tmp_path)} == {hazard}
    assert {row["hazard"] for row in json.loads((tmp_path / "scores.json").read_text())} == {"all", kind}


def test_sharing_over_a_dead_radio_is_sharing_nothing(tmp_path: Path) -> None:
    assert (
        run(
            tmp_path,
            "--scenario",
            "left_turn",
            "--contender",
            "planner-own",
            "planner-shared",
            "--episodes",
            "4",
            "--radio",
            "none",
        )
        == 0
    )
    own, shared = records(tmp_path)[:4], records(tmp_path)[4:]
    assert [vars(record) | {"contender": ""} for record in own] == [
        vars(record) | {"contender": ""} for record in shared
    ]


def test_overrides_reach_the_environment(done: Path, tmp_path: Path) -> None:
    assert (
        run(
            tmp_path,
            "--scenario",
            "left_turn",
            "--contender",
            "planner-shared",
            "--episodes",
            "3",
            "--loss",
            "0.9",
            "--depth",
            "1",
        )
        == 0
    )
    before = [record for record in records(done) if record.contender == "planner-shared"]
    for few, many in zip(before, records(tmp_path), strict=True):
        assert few.messages_lost < many.messages_lost
        assert many.bytes_per_message_mean < few.bytes_per_message_mean  # type: ignore[operator]


def test_results_go_to_their_own_folder_unless_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert evaluate.main(["--scenario", "left_turn", "--contender", "always-go", "--episodes", "1"]) == 0
    assert (tmp_path / "results" / "scores.json").exists()


def test_every_scenario_meets_every_contender_on_the_same_seeds_in_a_table_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, "--contender", "always-go", "planner-own", "--episodes", "2") == 0
    assert [(record.scenario, record.contender, record.seed) for record in records(tmp_path)] == [
        (scene, name, 1_000_000 + k) for scene in SCENARIOS for name in ("always-go", "planner-own") for k in range(2)
    ]
    tables = capsys.readouterr().out.split("\n\n")
    assert [part.splitlines()[2].split()[0] for part in tables] == list(SCENARIOS)


def test_scenarios_come_in_the_order_they_are_asked_for() -> None:
    backwards = tuple(reversed(SCENARIOS))
    assert Settings(scenario=backwards).scenarios() == backwards
    assert Settings().scenarios() == tuple(SCENARIOS)


def test_the_command_that_is_noted_asks_for_the_same_episodes() -> None:
    asked = Settings(
        scenario=("left_turn",), contender=("expert",), loss=0.3, jobs=2, policy=(Path("a b"),), shard="1/2"
    )
    words = shlex.split(asked.command())
    assert words[:2] == ["python", "evaluate.py"]
    assert evaluate.parsed(Settings, words[2:]) == replace(asked, jobs=1, shard=None)


@pytest.mark.parametrize("cut", [1, 30, 400, 800])
def test_a_torn_file_is_completed_to_what_it_would_have_been(copy: Path, done: Path, cut: int) -> None:
    (copy / "scores.json").unlink()
    path = copy / "episodes.jsonl"
    os.truncate(path, path.stat().st_size - cut)
    assert run(copy, *SOME) == 0
    assert files(copy) == files(done)


def test_finished_episodes_are_not_driven_again(copy: Path) -> None:
    path = copy / "episodes.jsonl"
    marked = json.loads(path.read_text().splitlines()[0]) | {"brakes": 12345}
    path.write_text(json.dumps(marked) + "\n")
    assert run(copy, *SOME) == 0
    assert [record.brakes for record in records(copy)].count(12345) == 1


@pytest.fixture(scope="module")
def long_run(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of an uninterrupted run of LONG."""
    folder = tmp_path_factory.mktemp("long")
    assert run(folder, *LONG) == 0
    return files(folder)


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize(("how", "code"), [("SIGINT", 130), ("SIGKILL", -9)])
def test_a_stopped_run_leaves_no_worker_and_goes_on(
    how: str, code: int, long_run: dict[str, bytes], tmp_path: Path
) -> None:
    command = [sys.executable, evaluate.__file__, *LONG, "--jobs", "2", "--out", str(tmp_path)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    path = tmp_path / "episodes.jsonl"
    while process.poll() is None and not (path.exists() and path.stat().st_size):
        time.sleep(0.01)
    # Ctrl-C reaches every process of a terminal, a kill only one.
    (os.killpg if how == "SIGINT" else os.kill)(process.pid, getattr(signal, how))
    said = process.communicate(timeout=60)[1]  # ends only when the workers, who share standard error, have ended
    assert process.returncode == code
    if how == "SIGINT":
        assert said.count("\n") == 1
        assert "the same command goes on from there" in said
    done_before = records(tmp_path)
    assert 25 <= len(done_before) < 75
    assert run(tmp_path, *LONG) == 0
    assert files(tmp_path) == long_run


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--scenario", "moon"], "unknown scenario 'moon': choose among left_turn"),
        (["--scenario", "left_turn", "left_turn"], "scenario must name at least one, each once"),
        (["--scenario"], "scenario must name at least one"),
        (["--shard", "0/2"], "shard must be i/n with i from 1 to n, such as 2/8, got '0/2'"),
        (["--shard", "3/2"], "shard must be i/n"),
        (["--shard", "half"], "shard must be i/n"),
        (["--contender", "nobody"], "unknown contender 'nobody': choose among always-go"),
        (["--contender", "expert", "expert"], "each once"),
        (["--contender"], "at least one"),
        (["--radio", "am"], "unknown radio 'am': choose one of none, ideal, dsrc, cv2x"),
        (["--radoi", "dsrc"], "Unrecognized options: --radoi"),
        (["--episodes", "many"], "--episodes: invalid literal for int() with base 10: 'many'"),
        (["--episodes", "0"], "episodes must be a number from 1"),
        (["--episodes"], "'--episodes'"),
        (["--first-seed", "-1"], "first-seed must be a number from 0"),
        (["--jobs", "0"], "jobs must be a number from 1"),
        (["--loss", "1.1"], "radio loss must be a number from 0 to 1, got 1.1"),
        (["--loss", "nan"], "radio loss must be a number from 0 to 1, got nan"),
        (["--delay", "-0.1"], "radio delay"),
        (["--sensor-noise", "inf"], "sensor noise"),
        (["--gnss-noise", "-1"], "sensor gnss_noise"),
        (["--depth", "16"], "depth must be a number from 1 to 15, got 16"),
        (["--gif", "-1"], "gif must be a number from 0"),
        (["--gif", "1", "--shard", "1/2"], "gif is for a whole run"),
        (["--traffic", "heavy"], "traffic must be one of none, light, dense, got 'heavy'"),
        (["--penetration", "1.5"], "penetration must be a number from 0 to 1, got 1.5"),
        (["--hazard", "maybe"], "hazard must be one of all, yes, no, got 'maybe'"),
        (["--contender", "stgraph", "--policy", "nowhere"], f"no folder {Path('nowhere', 'shared')}"),
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
    assert evaluate._first_part(box, "Settings") == "Error parsing --n: no number"
    assert evaluate._first_part(box.replace("parsing ", "parsing Settings: "), "Settings") == "--n: no number"


def test_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        evaluate.main(["--help"])
    assert stopped.value.code == 0
    assert "--sensor-noise" in capsys.readouterr().out


def test_help_waits_for_no_heavy_import() -> None:
    heavy = ("torch", "numba", "highway_env", "matplotlib", "scipy.stats")
    code = f"import evaluate, sys; sys.exit(bool(set({heavy}) & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (["--episodes", "4"], "episodes"), (["--first-seed", "5"], "first_seed"), (["--radio", "cv2x"], "radio"),
        (["--loss", "0.2"], "radio"), (["--hazard", "yes"], "hazard"), (["--depth", "2"], "depth"),
        (["--sensor-noise", "0.3"], "sensor_noise"), (["--traffic", "none"], "traffic"),
        (["--penetration", "0.5"], "penetration"), (["--contender", "expert"], "contender"),
    ],
)  # fmt: skip
def test_other_settings_in_the_same_folder_are_refused_by_name(
    change: list[str], name: str, refused: Refused, copy: Path, done: Path
) -> None:
    assert f"another {name} (" in refused(copy, *SOME, *change)
    assert files(copy) == files(done)


def test_another_model_in_the_same_folder_is_refused(refused: Refused, models: Path, tmp_path: Path) -> None:
    some = ["--scenario", "left_turn", "--contender", "stgraph", "--episodes", "1", "--policy", str(models)]
    assert run(tmp_path / "out", *some) == 0
    save_model(models / "shared", SavedModel(StGraphNet(seed=2), 0.5))
    assert "another model of stgraph (" in refused(tmp_path / "out", *some)


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
    damage(models / "own")
    some = ["--scenario", "left_turn", "--contender", "always-go", "stgraph-own", "--policy", str(models)]
    assert str(models / "own") in refused(tmp_path / "out", *some)


@pytest.mark.parametrize("below", ["", "deeper"])
def test_a_folder_that_cannot_be_written_is_refused(below: str, refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert str(tmp_path / "file") in refused(tmp_path / "file" / below, *SOME)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("settings.json", "{", "settings.json is damaged"),
        ("settings.json", "[]", "another scenario"),
        ("episodes.jsonl", '{"seed": 1}\n', "episodes.jsonl line 1: an episode's record must have the keys"),
        ("episodes.jsonl", "\x00\x00\n", "episodes.jsonl line 1: not JSON"),
    ],
)
def test_damaged_results_are_refused_and_kept(name: str, text: str, reason: str, refused: Refused, copy: Path) -> None:
    (copy / name).write_text(text)
    assert reason in refused(copy, *SOME)
    assert (copy / name).read_text() == text


def test_episodes_of_unknown_settings_are_refused(refused: Refused, copy: Path) -> None:
    (copy / "settings.json").unlink()
    assert "has episodes but no settings.json" in refused(copy, *SOME)


def test_a_run_of_other_scenarios_is_another_run(refused: Refused, tmp_path: Path) -> None:
    settings = Settings(scenario=("left_turn",), contender=("expert",), episodes=1)
    other = identity(settings) | {"scenario": ["left_turn", "overtaking"]}
    Store(tmp_path, other)
    some = ["--scenario", "left_turn", "--contender", "expert", "--episodes", "1"]
    assert 'another scenario (["left_turn", "overtaking"], now ["left_turn"])' in refused(tmp_path, *some)
