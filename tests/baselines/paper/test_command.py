"""One command makes all tables; here with as little of everything as there can be."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from stopped_runs import AT_FIRST_LOOK, last_words, stopped_run

from baselines.cli import parsed
from baselines.evaluation.grid import Task as Episodes
from baselines.evaluation.run import drive_task, identity
from baselines.evaluation.settings import Settings
from baselines.evaluation.store import read_records
from baselines.folder_note import claim, difference
from baselines.methods import LEARNED
from baselines.paper import command as reproduce
from baselines.paper.gathering import commands, gather
from baselines.paper.presets import PRESETS, Preset
from baselines.paper.report import write_results
from baselines.paper.tasks import PaperTask, Plan, in_table, measuring, perform, scoring, training, units, work_of
from baselines.workers import heard
from cad_env.scoring.scorecard import Record

torch.set_num_threads(1)

TINY = Preset(
    seeds=(0, 1), open_loop=2, scored=2, swept=1, sweep_points="ends", ppo_steps=256,
    training={"episodes": 6, "dagger_rounds": 0, "dagger_episodes": 1, "steps": 3, "validation": 1},
)  # fmt: skip
SCENES = ("left_turn",)


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return Plan(tmp_path / "run", TINY, SCENES, ("always-go", "command-only", "stgraph"))


def test_every_row_of_the_tables_is_asked_for() -> None:
    assert set(LEARNED) <= set(in_table())
    found = reproduce.plan_of(reproduce.ReproduceSettings(preset="full"))
    assert found.rows == in_table()
    assert {name for name, _ in units(found)} == set(found.rows)


def test_what_is_trained_comes_once_a_seed_and_what_is_not_once(plan: Plan) -> None:
    assert sorted(units(plan)) == [
        ("always-go", 0), ("command-only", 0), ("command-only", 1), ("stgraph", 0), ("stgraph", 1),
    ]  # fmt: skip
    assert not list(training(plan, ("always-go", 0)))


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_shards_share_out_everything_once(plan: Plan, count: int) -> None:
    parts = [units(plan, f"{number}/{count}") for number in range(1, count + 1)]
    assert sorted(unit for part in parts for unit in part) == sorted(units(plan))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_shards_cost_about_the_same(count: int) -> None:
    plan = reproduce.plan_of(reproduce.ReproduceSettings(preset="full"))
    loads = [
        sum(
            work_of(plan, task)
            for unit in units(plan, f"{number}/{count}")
            for task in (*training(plan, unit), *measuring(plan, unit))
        )
        for number in range(1, count + 1)
    ]
    assert max(loads) < 1.05 * sum(loads) / count


def test_sweeps_are_of_the_first_seed_and_of_the_rows_that_are_compared(plan: Plan) -> None:
    stages = {unit: {task.stage for task in measuring(plan, unit)} for unit in units(plan)}
    assert stages["stgraph", 0] == {"closed", "open", "sweep"}
    assert stages["stgraph", 1] == stages["command-only", 0] == {"closed", "open"}
    everything = replace(plan, preset=replace(TINY, sweep_points="every"))
    assert len(list(measuring(everything, ("stgraph", 0)))) > len(list(measuring(plan, ("stgraph", 0))))


def test_what_is_done_is_not_done_again_and_stands_side_by_side(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = replace(plan, rows=("always-go", "command-only"), preset=replace(TINY, seeds=(0,)))
    tasks = [task for unit in units(plan) for stage in (training, measuring) for task in stage(plan, unit)]
    told: list[float] = []
    for task in tasks:
        perform(plan, task, told.append)
    assert gather(plan) == 0
    records = read_records(plan.out / "closed" / "dsrc" / "0")
    assert [record.method for record in records] == ["always-go"] * 2 + ["command-only"] * 2
    before = {path: path.stat().st_mtime_ns for path in plan.out.glob("models/**/*.*")}
    before |= {path: path.stat().st_mtime_ns for path in plan.out.glob("open/*/*.json")}
    assert len(before) > 5
    monkeypatch.setattr("baselines.evaluation.run.drive_task", None)  # nothing drives any more
    for task in tasks:
        perform(plan, task, told.append)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert gather(plan) == 0
    assert read_records(plan.out / "closed" / "dsrc" / "0") == records
    text = write_results(plan.out).read_text()
    assert "command-only" in text


def test_an_episode_that_two_sweeps_meet_in_is_driven_once(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = replace(plan, rows=("stgraph",), preset=replace(TINY, seeds=(0,)))
    perform(plan, PaperTask("train", "stgraph", 0), lambda work: None)
    for what in ("dsrc", "sweeps/delay/0.5"):
        perform(plan, PaperTask("closed" if what == "dsrc" else "sweep", "stgraph", 0, what), lambda work: None)
    driven: list[str] = []

    def counted(settings: Settings, task: Episodes) -> Iterator[Record]:
        driven.append(str(settings.out))
        return drive_task(settings, task)

    monkeypatch.setattr("baselines.evaluation.run.drive_task", counted)
    for what in ("sweeps/delay/0.0", "sweeps/gnss/0.0", "sweeps/budget/25000", "sweeps/depth/15"):
        perform(plan, PaperTask("sweep", "stgraph", 0, what), lambda work: None)
    assert not driven
    records = [read_records(scoring(plan, PaperTask(*task)).out) for task in (
        ("closed", "stgraph", 0, "dsrc"), ("sweep", "stgraph", 0, "sweeps/delay/0.0"),
    )]  # fmt: skip
    assert records[1] == records[0][: TINY.swept]
    perform(plan, PaperTask("sweep", "stgraph", 0, "sweeps/gnss/1.0"), lambda work: None)
    assert len(driven) == 1


def test_the_noted_commands_are_of_the_same_episodes(plan: Plan) -> None:
    rows = ("always-go", "command-only", "stgraph")
    plan = replace(plan, rows=rows, preset=replace(TINY, seeds=(0,), swept=2))
    for row in rows:
        for task in training(plan, (row, 0)):
            perform(plan, task, lambda work: None)
    made = ["expert", "stgraph", "command-only", "compressed"]
    radios = {"compressed": "cv2x"}
    parts = [plan.settings(row, 0, plan.out / row, radio=radios.get(row, "dsrc"), episodes=2, loss=0.2) for row in made]
    lines = commands(parts).splitlines()
    assert len(lines) == 2
    found = [parsed(Settings, line.split()[2:]) for line in lines]
    assert [run.method for run in found] == [("expert", "stgraph", "command-only"), ("compressed",)]
    assert [run.radio for run in found] == ["dsrc", "cv2x"]
    for part in parts[:3]:
        assert not difference(identity(replace(found[0], method=part.method)), identity(part))
    assert found[1] == replace(parts[3], out=Settings.out, report=True)


def test_numbers_of_another_model_are_not_taken_for_those_of_this_one(plan: Plan) -> None:
    plan = replace(plan, rows=("command-only",), preset=replace(TINY, seeds=(0,), swept=0))
    tasks = [task for stage in (training, measuring) for task in stage(plan, ("command-only", 0))]
    for task in tasks:
        perform(plan, task, lambda work: None)
    assert gather(plan) == 0
    model = plan.models(0) / "command-only" / "config.json"
    model.write_text(json.dumps(json.loads(model.read_text()) | {"threshold": 0.0}))
    for task in tasks[1:]:
        with pytest.raises(ValueError, match="another model"):
            perform(plan, task, lambda work: None)
    with pytest.raises(ValueError, match="another model"):
        gather(plan)
    for path in plan.out.glob("open/*/*.json"):
        path.unlink()
    assert gather(plan) == 2


def test_what_is_not_finished_is_left_out_and_counted(plan: Plan) -> None:
    for task in measuring(plan, ("always-go", 0)):
        perform(plan, task, lambda work: None)
    assert gather(plan) > 0
    assert {record.method for record in read_records(plan.out / "closed/dsrc/0")} == {"always-go"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "quikc"], "preset must be one of quick, hour, full, got 'quikc'; did you mean quick?"),
        (["--method", "gta"], "; did you mean gat?"),
        (["--shard", "3/2"], "shard must be i/n"),
        (["--shard", "1/2", "--merge"], "leave out --shard"),
        (["--jobs", "0"], "jobs must be"),
    ],
)
def test_bad_input_is_one_clear_line(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reproduce.main([*arguments, "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
    assert not (tmp_path / "run").exists()


def test_a_folder_of_another_preset_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    claim(tmp_path / reproduce.NOTE, asdict(PRESETS["full"]), "use another folder")
    assert reproduce.main(["--preset", "quick", "--merge", "--out", str(tmp_path)]) == 2
    assert "holds a run with another seeds" in capsys.readouterr().err


def test_a_recording_that_fails_is_told_in_one_line_and_kept_apart_for_each_shard(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reproduce, "PRESETS", {"quick": replace(TINY, seeds=(0,), swept=0)})
    run = tmp_path / "run"
    run.mkdir()
    (run / "demonstrations").write_text("in the way")
    command = ["--method", "always-go", "--out", str(run), "--jobs", "1"]
    assert reproduce.main([*command, "--shard", "2/2"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len([line for line in lines if line.startswith("failed: record ")]) == 3
    assert not [line for line in lines if "Traceback" in line]
    assert "Traceback" in (run / "failures_2_of_2.txt").read_text()
    assert reproduce.main([*command, "--shard", "1/2"]) == 1
    assert {path.name for path in run.glob("*.txt")} == {"failures_1_of_2.txt", "failures_2_of_2.txt"}


def test_what_failed_is_told_and_kept_though_the_next_stage_is_interrupted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reproduce, "PRESETS", {"quick": replace(TINY, seeds=(0,), swept=0)})
    run = tmp_path / "run"
    note = run / "models/seed_0/command-only/training.json"
    note.parent.mkdir(parents=True)
    note.write_text("not JSON")

    def interrupted(told: Any) -> list[Any]:
        if (run / "failures.txt").exists():
            raise KeyboardInterrupt
        return heard(told)

    monkeypatch.setattr("baselines.workers.heard", interrupted)
    assert reproduce.main(["--method", "command-only", "always-go", "--out", str(run)]) == 130
    assert "failed: train command-only seed 0: FileError" in capsys.readouterr().err
    assert "Traceback" in (run / "failures.txt").read_text()


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_a_stopped_run_leaves_no_worker_and_says_how_to_resume(tmp_path: Path) -> None:
    ended, said = stopped_run("reproduce", ["--out", "run"], AT_FIRST_LOOK, "SIGTERM", True, tmp_path)
    assert (ended, last_words(said)) == (143, ["stopped; run the same command to resume"])
    assert not (tmp_path / "run" / reproduce.FAILURES).exists()


def test_a_reason_is_one_line_however_many_its_error_has() -> None:
    def load() -> None:
        raise RuntimeError("Error(s) in loading:\n\tMissing key\n\n")

    story = reproduce._attempt(load)
    assert reproduce._reason(story) == "RuntimeError: Error(s) in loading: Missing key"
    assert "Traceback" in story


@pytest.mark.skipif(os.name != "posix", reason="locales as POSIX has them")
def test_failures_are_noted_in_a_locale_without_their_letters(tmp_path: Path) -> None:
    code = "from baselines.paper.command import _note; from pathlib import Path; import sys; "
    code += r"found = [('train \u2264', 'loss \u2264 1\nTraceback \u8bad')]; _note(Path(sys.argv[1]), found, found)"
    plain = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-c", code, str(tmp_path / "failures.txt")]
    done = subprocess.run(command, env=plain, capture_output=True, check=True, cwd=Path(__file__).parents[3])
    assert (tmp_path / "failures.txt").read_text(encoding="utf-8") == "train ≤\nloss ≤ 1\nTraceback 训\n"
    assert done.stderr == b"failed: train \\u2264: loss \\u2264 1\n"


@pytest.mark.slow
def test_a_row_that_fails_is_named_and_does_not_stop_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reproduce, "PRESETS", {"quick": replace(TINY, seeds=(0,), swept=0)})
    broken = tmp_path / "run/models/seed_0/command-only"
    broken.mkdir(parents=True)
    (broken / "training.json").write_text("not JSON")
    arguments = ["--method", "command-only", "gat", "always-go", "--out", str(tmp_path / "run")]
    assert reproduce.main(arguments) == 1
    error = capsys.readouterr().err
    assert "failed: train command-only seed 0: FileError" in error
    records = read_records(tmp_path / "run/closed/dsrc/0")
    assert {record.method for record in records} == {"always-go", "gat"}
    assert "Traceback" in (tmp_path / "run/failures.txt").read_text()
    (broken / "training.json").unlink()
    assert reproduce.main(arguments) == 0
    found = json.loads((tmp_path / "run/results.json").read_text())
    assert "command-only" in json.dumps(found["closed"])
