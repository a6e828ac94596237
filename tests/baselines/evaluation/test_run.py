"""The scoring command's results: the same seeds for all, and a stopped run is completed to what it would have been."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from stopped_runs import AT_FIRST_EPISODE, last_words, stopped_run

import evaluate
from baselines.controls import names
from baselines.controls.names import GRID, best_control, read_choice
from baselines.evaluation import run as scoring
from baselines.evaluation.run import score
from baselines.evaluation.settings import Settings, comparable
from baselines.methods import SHIPPED_METHODS
from cad_env.scenarios import SHIPPED
from cad_env.scoring.rollout import Episode
from cad_env.scoring.scorecard import Record, parse_record, record_of
from cad_env.scoring.time_lost import time_lost

SOME = ["--scenario", "left_turn", "--method", "always-go", "planner-shared", "--episodes", "3"]
LONG = ["--scenario", "left_turn", "--method", "always-brake", "--episodes", "75"]

LINE = (
    '{"scenario": "left_turn", "method": "always-go", "seed": 7, "hazard": true, "outcome": "success", "time": %s, '
    '"brakes": 0, "bytes_per_message_mean": null, "bytes_per_message_max": null, "messages_sent": 0, '
    '"messages_lost": 0, "bytes_total": 0, "min_ttc": null, "hazard_time": null, "connected": 4, "hardest_brake": 0,'
    ' "struck_from_behind": false}'
    "\n"
)

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


def test_every_method_meets_the_same_seeds_in_order(done: Path) -> None:
    assert [(record.method, record.seed) for record in records(done)] == [
        (name, 1_000_000 + k) for name in ("always-go", "planner-shared", "expert") for k in range(3)
    ]
    by_seed: dict[int, set[bool]] = {}
    for record in records(done):
        by_seed.setdefault(record.seed, set()).add(record.hazard)
    assert all(len(kinds) == 1 for kinds in by_seed.values())


def test_records_hold_the_bytes_that_were_sent(done: Path) -> None:
    for record in records(done):
        if record.method != "planner-shared":
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
    assert {row["method"] for row in rows} == {"always-go", "planner-shared", "expert"}
    assert {"collision_rate", "collision_low", "collision_high", "success_low", "timeouts"} <= rows[0].keys()
    assert {"time_lost", "time_lost_low", "time_lost_p90", "time_lost_p90_high"} <= rows[0].keys()
    assert "planner-shared" in capsys.readouterr().out


def test_the_expert_is_added_once_for_the_others_to_be_compared_with(tmp_path: Path) -> None:
    usual = Settings(scenario=("left_turn",), method=("always-go",))
    assert comparable(usual).method == ("always-go", "expert")
    assert comparable(comparable(usual)) == comparable(usual)
    assert comparable(Settings()) == Settings()
    assert run(tmp_path, "--scenario", "left_turn", "--method", "blind-1", "--episodes", "4") == 0
    rows = {row["method"]: row for row in json.loads((tmp_path / "scores.json").read_text()) if row["hazard"] == "all"}
    lost = time_lost(records(tmp_path)[:4], records(tmp_path)[4:])
    assert lost is not None
    assert rows["blind-1"]["time_lost"] == lost.mean.value
    assert rows["expert"]["time_lost"] == 0.0


def test_one_word_stands_for_all_controls() -> None:
    assert Settings(method=("expert", "controls", "stgraph")).method == ("expert", *GRID, "stgraph")
    with pytest.raises(ValueError, match="each once"):
        Settings(method=("blind-0.5", "controls"))


def test_another_choice_of_the_best_control_is_another_run(
    refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    some = ["--scenario", "left_turn", "--episodes", "2", "--method"]
    assert run(tmp_path / "out", *some, "best-blind") == 0
    note = json.loads((tmp_path / "out" / "settings.json").read_text())
    assert note["choice of best-blind"] == {"left_turn": best_control("left_turn")}
    (tmp_path / "best.json").write_text(json.dumps({"left_turn": {"chosen": "slow-8"}}))
    monkeypatch.setattr(names, "read_choice", lambda: read_choice(tmp_path / "best.json"))
    assert "another code of best-blind (" in refused(tmp_path / "out", *some, "best-blind")
    assert run(tmp_path / "new", *some, "best-blind") == 0
    assert run(tmp_path / "same", *some, "slow-8") == 0
    one, other = (records(tmp_path / folder) for folder in ("new", "same"))
    assert [vars(record) | {"method": ""} for record in one] == [vars(record) | {"method": ""} for record in other]


def test_a_scenario_without_a_choice_is_scored_without_the_best_control(
    refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(names, "read_choice", dict)
    some = Settings(scenario=("left_turn",))
    assert comparable(some).method == tuple(name for name in SHIPPED_METHODS if name != "best-blind")
    asked = ["--scenario", "left_turn", "--method", "best-blind"]
    assert "no best-blind is chosen for scenario 'left_turn'" in refused(tmp_path / "out", *asked)


def test_another_program_gets_the_same_rows(done: Path, tmp_path: Path) -> None:
    methods = ("always-go", "planner-shared", "expert")
    rows = score(Settings(scenario=("left_turn",), method=methods, episodes=3, out=tmp_path))
    assert [vars(row) for row in rows] == json.loads((done / "scores.json").read_text())


@pytest.mark.parametrize(("kind", "hazard"), [("yes", True), ("no", False)])
def test_a_hazard_can_be_forced(kind: str, hazard: bool, tmp_path: Path) -> None:
    assert run(tmp_path, "--scenario", "left_turn", "--method", "always-go", "--episodes", "6", "--hazard", kind) == 0
    assert {record.hazard for record in records(tmp_path)} == {hazard}
    assert {row["hazard"] for row in json.loads((tmp_path / "scores.json").read_text())} == {"all", kind}


def test_sharing_over_a_dead_radio_is_sharing_nothing(tmp_path: Path) -> None:
    assert (
        run(
            tmp_path,
            "--scenario",
            "left_turn",
            "--method",
            "planner-own",
            "planner-shared",
            "--episodes",
            "4",
            "--radio",
            "none",
        )
        == 0
    )
    own, shared = records(tmp_path)[:4], records(tmp_path)[4:8]
    assert [vars(record) | {"method": ""} for record in own] == [vars(record) | {"method": ""} for record in shared]


def test_overrides_reach_the_environment(done: Path, tmp_path: Path) -> None:
    assert (
        run(
            tmp_path,
            "--scenario",
            "left_turn",
            "--method",
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
    before = [record for record in records(done) if record.method == "planner-shared"]
    after = [record for record in records(tmp_path) if record.method == "planner-shared"]
    for few, many in zip(before, after, strict=True):
        assert few.messages_lost < many.messages_lost
        assert many.bytes_per_message_mean < few.bytes_per_message_mean  # type: ignore[operator]


def test_every_scenario_meets_every_method_on_the_same_seeds_in_a_table_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, "--method", "always-go", "planner-own", "--episodes", "2") == 0
    assert [(record.scenario, record.method, record.seed) for record in records(tmp_path)] == [
        (scene, name, 1_000_000 + k)
        for scene in SHIPPED
        for name in ("always-go", "planner-own", "expert")
        for k in range(2)
    ]
    tables = capsys.readouterr().out.split("\n\n")
    assert [part.splitlines()[2].split()[0] for part in tables] == list(SHIPPED)


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


def test_an_interruption_loses_no_episode_that_has_ended(
    tmp_path: Path, done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = 0

    def record(episode: Episode, condition: str | None) -> Record:
        nonlocal ended
        ended += 1
        if ended > 2:
            raise KeyboardInterrupt
        return record_of(episode, condition)

    monkeypatch.setattr(scoring, "record_of", record)
    assert run(tmp_path, *SOME) == 130
    assert len(records(tmp_path)) == 2
    monkeypatch.undo()
    assert run(tmp_path, *SOME) == 0
    assert files(tmp_path) == files(done)


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize(
    ("how", "everywhere", "jobs", "code"),
    [
        ("SIGINT", True, 2, 130), ("SIGTERM", True, 2, 143), ("SIGTERM", False, 2, 143), ("SIGTERM", False, 1, 143),
        ("SIGKILL", False, 2, -9),
    ],
)  # fmt: skip
def test_a_stopped_run_leaves_no_worker_and_goes_on(
    how: str, everywhere: bool, jobs: int, code: int, long_run: dict[str, bytes], tmp_path: Path
) -> None:
    command = [*LONG, "--jobs", str(jobs), "--no-report", "--out", str(tmp_path / "out")]
    ended, said = stopped_run("evaluate", command, AT_FIRST_EPISODE, how, everywhere, tmp_path)
    assert ended == code
    if how != "SIGKILL":
        assert last_words(said) == ["stopped after 1 of 150 episodes; run the same command to resume"]
    assert len(records(tmp_path / "out")) == 1
    assert run(tmp_path / "out", *LONG) == 0
    assert files(tmp_path / "out") == long_run


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (["--episodes", "4"], "episodes"), (["--first-seed", "5"], "first_seed"), (["--radio", "cv2x"], "radio"),
        (["--loss", "0.2"], "radio"), (["--hazard", "yes"], "hazard"), (["--depth", "2"], "depth"),
        (["--sensor-noise", "0.3"], "sensor_noise"), (["--traffic", "none"], "traffic"),
        (["--penetration", "0.5"], "penetration"), (["--method", "expert"], "method"),
    ],
)  # fmt: skip
def test_other_settings_in_the_same_folder_are_refused_by_name(
    change: list[str], name: str, refused: Refused, copy: Path, done: Path
) -> None:
    assert f"another {name} (" in refused(copy, *SOME, *change)
    assert files(copy) == files(done)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("settings.json", "{", "settings.json: not JSON"),
        ("settings.json", "[]", "settings.json: must hold a JSON object, got list"),
        ("settings.json", "[" * 5000, "settings.json: not JSON of at most 64 levels"),
        ("settings.json", '{"scenario": 1, "scenario": 2}', "settings.json: not JSON with every key once: 'scenario'"),
        ("episodes.jsonl", LINE % ("5" + "0" * 400), "episodes.jsonl: line 1: an episode's record cannot have time 5"),
        ("episodes.jsonl", LINE % "1e300", "line 1: an episode's record cannot have time 1e+300"),
        ("episodes.jsonl", LINE % ("5" * 5000), "episodes.jsonl: line 1: time must have at most 4300 digits"),
        ("episodes.jsonl", '{"seed": 1}\n', "episodes.jsonl: line 1: an episode's record must have the keys"),
        ("episodes.jsonl", "\x00\x00\n", "episodes.jsonl: line 1: not JSON"),
    ],
)
def test_damaged_results_are_refused_and_kept(name: str, text: str, reason: str, refused: Refused, copy: Path) -> None:
    (copy / name).write_text(text)
    assert reason in refused(copy, *SOME)
    assert (copy / name).read_text() == text


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are of POSIX")
@pytest.mark.parametrize("name", ["settings.json", "episodes.jsonl"])
def test_a_pipe_in_place_of_results_is_refused_and_not_waited_for(name: str, refused: Refused, copy: Path) -> None:
    (copy / name).unlink()
    os.mkfifo(copy / name)
    assert f"{copy / name}: must be a regular file, is a named pipe" in refused(copy, *SOME)


def test_episodes_of_unknown_settings_are_refused(refused: Refused, copy: Path) -> None:
    (copy / "settings.json").unlink()
    assert "has episodes but no settings.json" in refused(copy, *SOME)
