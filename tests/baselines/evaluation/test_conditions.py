"""evaluate.py --condition: every method under every condition on the same seeds, in one folder."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

import evaluate
from baselines.evaluation.gifs import first_of_each
from baselines.evaluation.grid import Task
from baselines.evaluation.matrix_text import matrix_text
from baselines.evaluation.noted_conditions import met_in_words
from baselines.evaluation.run import completed, drive_task, identity, opened_store
from baselines.evaluation.settings import Settings
from baselines.evaluation.store import gif_name, read_records
from baselines.evaluation.training_seeds import spread_table, spreads
from cad_env.conditions import CONDITIONS
from cad_env.scoring.scorecard import Record, scorecards
from tests.baselines.evaluation.test_run import Refused, files, run

NAMES = ("nominal", "alone", "dense")
METHODS = ("planner-own", "planner-shared", "expert")
SOME = ["--scenario", "left_turn", "--method", *METHODS, "--episodes", "3", "--condition", *NAMES]
OWN = """from cad_env.conditions import Condition
FOG = Condition("fog", "a test", loss=0.9, collaborators=1)
NONE = 3
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of SOME."""
    folder = tmp_path_factory.mktemp("conditions")
    assert run(folder, *SOME) == 0
    return folder


def by_condition(folder: Path, method: str) -> dict[str | None, list[Record]]:
    """The records of a method, all under no name, so that conditions can be compared."""
    found: dict[str | None, list[Record]] = {}
    for record in read_records(folder):
        if record.method == method:
            found.setdefault(record.condition, []).append(replace(record, condition=None))
    return found


def test_every_condition_meets_every_method_on_the_same_seeds_in_order(done: Path) -> None:
    assert [(record.condition, record.method, record.seed) for record in read_records(done)] == [
        (name, method, 1_000_000 + k) for name in NAMES for method in METHODS for k in range(3)
    ]


def test_rows_carry_their_condition_and_lose_time_against_its_expert(done: Path) -> None:
    rows = json.loads((done / "scores.json").read_text())
    assert list(dict.fromkeys(row["condition"] for row in rows)) == list(NAMES)
    assert all(row["time_lost"] == 0.0 for row in rows if row["method"] == "expert")
    assert {"mean_time_success_low", "mean_time_success_high"} <= rows[0].keys()


def test_a_named_condition_is_what_its_settings_would_be(done: Path, tmp_path: Path) -> None:
    assert run(tmp_path, *SOME[:-4], "--penetration", "0") == 0
    assert by_condition(tmp_path, "planner-shared")[None] == by_condition(done, "planner-shared")["alone"]
    found = by_condition(done, "planner-shared")
    assert {record.connected for record in found["alone"]} == {1}
    assert all(record.connected > 2 for record in found["nominal"])
    assert sum(r.bytes_total for r in found["dense"]) > sum(r.bytes_total for r in found["nominal"]) > 0


@pytest.mark.parametrize("method", ["planner-own", "stgraph-own", "expert"])
def test_who_shares_nothing_does_the_same_whoever_is_connected(method: str) -> None:
    usual = Settings(scenario=("left_turn",), method=(method,), episodes=4)
    alone, everybody = (
        [replace(record, connected=0) for task in settings.tasks() for record in drive_task(settings, task)]
        for settings in (replace(usual, penetration=0.0), replace(usual, penetration=1.0, delay=0.5))
    )
    assert alone == everybody


def test_who_shares_nothing_drives_once_for_each_traffic(done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = by_condition(done, "planner-own")
    assert found["nominal"] == found["alone"] != found["dense"]
    settings = Settings(scenario=("left_turn",), method=("planner-own",), episodes=3, condition=NAMES)
    asked: list[str | None] = []

    def driven(settings: Settings, task: Task) -> Iterator[Record]:
        asked.append(task.condition)
        return drive_task(settings, task)

    monkeypatch.setattr("baselines.evaluation.run.drive_task", driven)
    store = opened_store(replace(settings, out=done / "once"))
    completed(replace(settings, out=done / "once"), store, lambda episodes: None)
    assert asked == ["nominal", "dense"]
    assert by_condition(done / "once", "planner-own") == found


def test_a_stopped_run_goes_on_to_the_same_files(done: Path, tmp_path: Path) -> None:
    for name, data in files(done).items():
        (tmp_path / name).write_bytes(data)
    kept = (tmp_path / "episodes.jsonl").read_text().splitlines(keepends=True)[4:6]
    (tmp_path / "episodes.jsonl").write_text("".join(kept))
    (tmp_path / "scores.json").unlink()
    assert run(tmp_path, *SOME, "--jobs", "2") == 0
    assert files(tmp_path) == files(done)


def test_merged_shards_are_the_files_of_the_whole_run(done: Path, tmp_path: Path) -> None:
    shards = [tmp_path / f"shard_{k}_of_2" for k in (1, 2)]
    for k in (1, 2):
        assert run(tmp_path, *SOME, "--shard", f"{k}/2") == 0
    assert evaluate.main(["--merge", *map(str, shards), "--no-report", "--out", str(tmp_path / "merged")]) == 0
    assert files(tmp_path / "merged") == files(done)


def test_the_table_groups_by_condition_and_says_who_is_connected(
    done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert run(done, *SOME) == 0
    said = capsys.readouterr().out.splitlines()
    assert [line for line in said if line.startswith("condition: ")] == [f"condition: {name}" for name in NAMES]
    assert "nominal: light traffic; a witness is always connected." in said
    assert "alone: light traffic; nobody but the ego is connected." in said
    assert said[-1] == f"Conditions side by side: {done / 'matrix.md'}."


def test_without_a_condition_files_are_as_they_were_and_the_table_names_the_witness(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    some = ["--scenario", "left_turn", "--method", "always-go", "--episodes", "1"]
    assert run(tmp_path / "usual", *some) == 0
    assert "In every episode: light traffic; a witness is always connected." in capsys.readouterr().out.splitlines()
    assert "condition" not in json.loads((tmp_path / "usual" / "episodes.jsonl").read_text().splitlines()[0])
    settings = json.loads((tmp_path / "usual" / "settings.json").read_text())
    assert "condition" not in settings
    assert (settings["traffic"], settings["penetration"], settings["collaborators"]) == ("light", None, None)
    assert {row["condition"] for row in json.loads((tmp_path / "usual" / "scores.json").read_text())} == {None}
    assert not (tmp_path / "usual" / "matrix.md").exists()
    assert run(tmp_path / "few", *some, "--penetration", "0.2") == 0
    said = capsys.readouterr().out
    assert "each vehicle connected by itself with probability 0.2" in said
    assert "witness" not in said


def test_all_is_every_condition_that_ships() -> None:
    assert Settings(condition=("all",)).condition == tuple(CONDITIONS)
    assert Settings(condition=("all",)).tasks()[0].condition == "nominal"


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["alnoe"], "unknown condition 'alnoe': choose among nominal, "),
        (["penetration-5"], "; did you mean penetration-50?"),
        (["alone", "alone"], "condition must name each once"),
        (["all", "dense"], "condition must name each once"),
        (["alone", "--penetration", "0.5"], "condition alone sets penetration to 0.0, and --penetration 0.5 is given"),
        (["dense", "--traffic", "light"], "condition dense sets traffic to dense, and --traffic light is given too"),
        (["nominal", "--penetration", "0"], "condition nominal sets penetration to its default, and --penetration 0.0"),
        (
            ["alone", "--loss", "0.5"],
            "condition alone sets loss to its default, and --loss 0.5 is given too: leave out",
        ),
        (["loss-40", "--collaborators", "1"], "sets collaborators to its default"),
        (["loss-40", "--burst", "5"], "sets burst to its default"),
        (["delay-300", "--delay", "0.5"], "sets delay to 0.3, and --delay 0.5 is given too"),
        (["json:loads"], "json:loads must be a Condition of cad_env.conditions"),
        (["nowhere:FOG"], "'nowhere:FOG': No module named 'nowhere'"),
    ],
)
def test_a_wrong_condition_is_refused_in_one_line(
    arguments: list[str], reason: str, refused: Refused, tmp_path: Path
) -> None:
    assert reason in refused(tmp_path / "out", "--condition", *arguments)
    assert not (tmp_path / "out").exists()


def test_other_conditions_in_the_same_folder_are_refused_by_name(refused: Refused, done: Path) -> None:
    assert "another condition (" in refused(done, *SOME[:-1])


def test_a_radio_and_its_budget_can_be_chosen_beside_a_condition() -> None:
    settings = Settings(condition=("loss-40",), radio="cv2x", budget=500.0)
    radio = settings.environment("left_turn", "loss-40")["radio"]
    assert (radio.loss, radio.budget) == (0.4, 500.0)
    assert identity(replace(settings, method=("expert",)))["condition"]["loss-40"]["loss"] == 0.4


def test_a_condition_from_outside_has_its_reference_as_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "my_conditions.py").write_text(OWN)
    some = ["--scenario", "left_turn", "--method", "planner-shared", "--episodes", "1", "--condition"]
    assert run(tmp_path / "out", *some, "my_conditions:FOG") == 0
    assert {record.condition for record in read_records(tmp_path / "out")} == {"my_conditions:FOG"}
    assert {record.connected for record in by_condition(tmp_path / "out", "planner-shared")["my_conditions:FOG"]} == {2}
    assert "must be a Condition" in refused(tmp_path / "new", *some, "my_conditions:NONE")


@pytest.mark.parametrize("value", [[], {}, "alone", {"alone": 3}, {"alone": {"penetration": 7}}, {"alone": {"x": 1}}])
def test_damaged_conditions_of_a_run_are_refused(value: object, done: Path, tmp_path: Path) -> None:
    for name, data in files(done).items():
        (tmp_path / name).write_bytes(data)
    settings = json.loads((done / "settings.json").read_text()) | {"condition": value}
    (tmp_path / "settings.json").write_text(json.dumps(settings))
    assert evaluate.main(["--merge", str(tmp_path), "--out", str(tmp_path / "out")]) == 2


def test_help_lists_the_conditions(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        evaluate.main(["--help"])
    assert f"Conditions: {', '.join(CONDITIONS)}." in " ".join(capsys.readouterr().out.split())


def some_records() -> list[Record]:
    """Two conditions: under the second the network collides."""
    bare = Record("left_turn", "expert", 1, False, "success", 10.0, 0, None, None, 0, 0, 0, None, None, 1, 0.0)
    crash = replace(bare, method="stgraph", condition="alone", outcome="collision")
    return [
        *(replace(bare, method=method, condition="nominal") for method in ("expert", "stgraph")),
        replace(bare, condition="alone"),
        crash,
    ]


def test_the_matrix_has_a_line_for_each_condition_and_marks_the_worst() -> None:
    lines = matrix_text(scorecards(some_records())).splitlines()
    assert lines[0] == "| left turn | expert | stgraph |"
    assert lines[2] == "| nominal | 0.0 [ 0.0, 79.3] · 100.0 · 10.0 | 0.0 [ 0.0, 79.3] · 100.0 · 10.0 |"
    assert lines[3] == "| alone | 0.0 [ 0.0, 79.3] · 100.0 · 10.0 | **100.0 [20.7,100.0]** · 0.0 · - |"


def test_animations_tell_conditions_apart() -> None:
    chosen = first_of_each(some_records(), 1)
    assert len({gif_name(record) for record in chosen}) == len(chosen) == 4
    assert gif_name(some_records()[2]) == "alone_left_turn_expert_success_1.gif"


def test_training_seeds_are_put_together_by_condition() -> None:
    rows = spreads([scorecards(some_records()), scorecards(some_records())])
    assert [(row.condition, row.method, row.seeds) for row in rows] == [
        ("nominal", "expert", 1), ("nominal", "stgraph", 2), ("alone", "expert", 1), ("alone", "stgraph", 2),
    ]  # fmt: skip
    assert spread_table(rows).splitlines()[-1].split()[:3] == ["alone", "left_turn", "stgraph"]


def test_what_was_met_is_read_from_the_settings_of_a_run() -> None:
    assert met_in_words({}) == ["In every episode: light traffic; a witness is always connected."]
    assert met_in_words({"collaborators": 0, "traffic": "none"}) == [
        "In every episode: no traffic; nobody but the ego is connected."
    ]
    assert met_in_words({"condition": {"alone": CONDITIONS["alone"].settings}}) == [
        "alone: light traffic; nobody but the ego is connected."
    ]
