"""Several training seeds: each is scored by itself, the rules once, and the table says how far the seeds spread."""

from dataclasses import replace
from pathlib import Path

import pytest

import evaluate
from baselines.evaluation.settings import Settings
from baselines.evaluation.store import read_records
from baselines.evaluation.training_seeds import Spread, runs_of, spread_table, spreads
from cad_env.scoring.scorecard import Record, scorecards
from policies.model_folder import SavedModel, save_model
from policies.stgraph.network import StGraphNet


def some(method: str, outcomes: str) -> list[Record]:
    names = {"s": "success", "c": "collision", "t": "timeout"}
    return [
        Record(
            "left_turn", method, seed, seed % 2 == 0, names[outcome], 9.0, 0, None, None, 0, 0, 0, None, None, 3, 0.0
        )
        for seed, outcome in enumerate(outcomes)
    ]


def test_the_table_has_the_mean_and_the_range_of_the_seeds() -> None:
    runs = [some("expert", "ssss"), some("stgraph", "sssc"), some("stgraph", "sscc")]
    rows = spreads([scorecards(records) for records in runs])
    assert [(row.method, row.seeds, row.episodes) for row in rows] == [("expert", 1, 4), ("stgraph", 2, 4)]
    assert rows[1].collision == (0.375, 0.25, 0.5)
    assert rows[1].success == (0.625, 0.5, 0.75)
    text = spread_table(rows)
    assert "37.5 [25.0, 50.0]" in text
    assert text.splitlines()[2].split() == ["left_turn", "expert", "1", "4", "0.0", "0.0", "100.0"]
    assert isinstance(rows[0], Spread)


def test_time_lost_is_against_the_expert_of_the_same_run_whose_row_comes_once() -> None:
    late = [replace(record, time=time) for record, time in zip(some("stgraph", "ssss"), (9, 10, 11, 12), strict=True)]
    runs = [
        some("expert", "ssss"),
        [*late, *some("expert", "ssss")],
        [*some("stgraph", "sscc"), *some("expert", "ssss")],
    ]
    expert, ours = spreads([scorecards(records) for records in runs])
    assert (expert.method, expert.seeds, expert.time_lost) == ("expert", 1, (0.0, 0.0, 0.0))
    assert (ours.seeds, ours.time_lost) == (2, (0.75, 0.0, 1.5))
    without = spreads([scorecards(some("stgraph", "ss"))])
    assert without[0].time_lost is None
    assert spread_table(without).splitlines()[2].split()[5] == "-"


def test_every_seed_is_scored_by_itself_and_the_rules_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    models = [tmp_path / f"seed_{seed}" for seed in (3, 4)]
    for seed, folder in enumerate(models):
        save_model(folder / "stgraph", SavedModel(StGraphNet(seed=seed), float(seed)))  # one always brakes, one goes
    arguments = ["--models", *map(str, models), "--method", "always-go", "stgraph", "--scenario", "left_turn"]
    out = tmp_path / "out"
    assert evaluate.main([*arguments, "--episodes", "3", "--out", str(out), "--no-report"]) == 0
    assert sorted(folder.name for folder in out.iterdir()) == ["rules", "seed_3", "seed_4"]
    assert {record.method for record in read_records(out / "rules")} == {"always-go", "expert"}
    ours = [record for record in read_records(out / "seed_3") if record.method == "stgraph"]
    assert {record.outcome for record in ours} == {"timeout"}
    assert {record.method for record in read_records(out / "seed_4")} == {"stgraph", "expert"}
    last = capsys.readouterr().out.split("seeds  episodes")[-1]
    assert ["stgraph", "2", "3"] in [line.split()[1:4] for line in last.splitlines()]


def test_folders_of_the_same_name_are_refused() -> None:
    with pytest.raises(ValueError, match="models folders must have different names, got a/x b/x"):
        Settings(models=(Path("a/x"), Path("b/x")))


def test_without_anything_learned_there_is_one_run() -> None:
    settings = Settings(models=(Path("a"), Path("b")), method=("expert",))
    assert list(runs_of(settings)) == ["rules"]
