"""The best control is chosen by its collisions, among those that lose little time, on training seeds only."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from baselines.controls.names import CHOICE, GRID, best_control, read_choice
from baselines.evaluation import best_blind
from baselines.evaluation.best_blind import MOST_LOST, Choosing, chosen_control, main
from baselines.evaluation.settings import Settings
from cad_env.scenarios import SHIPPED
from cad_env.scoring.scorecard import Record, Scorecard, scorecards

BARE = Record("left_turn", "expert", 0, False, "success", 10.0, 0, None, None, 0, 0, 0, None, None, 3, 0.0)


def row(method: str, collisions: int, lost: float | None) -> Scorecard:
    """Of ten episodes."""
    return replace(scorecards([BARE])[0], method=method, collisions=collisions, episodes=10, time_lost=lost)


def test_the_fewest_collisions_win_among_those_that_lose_little() -> None:
    rows = [row("a", 4, 0.0), row("b", 1, 4.9), row("c", 0, 5.1), row("d", 1, 4.0), row("e", 0, None)]
    assert chosen_control(rows).method == "d"


def test_there_may_be_none() -> None:
    with pytest.raises(ValueError, match="no control of left_turn loses at most 5 s"):
        chosen_control([row("a", 0, 5.1), row("b", 10, None)])


def test_what_is_stored_is_the_best_of_what_was_measured_on_the_whole_grid() -> None:
    stored = read_choice()
    for scenario in SHIPPED:
        measured = stored[scenario]["measured"]
        assert tuple(measured) == GRID
        assert stored[scenario]["episodes"] >= 300
        rows = [row(name, each["collision_rate"], each["time_lost"]) for name, each in measured.items()]
        assert chosen_control(rows).method == stored[scenario]["chosen"] == best_control(scenario)
        assert measured[best_control(scenario)]["time_lost"] <= MOST_LOST


def test_seeds_of_evaluation_are_never_looked_at() -> None:
    most = Choosing(episodes=999_999).settings(Path("x")).seeds()
    assert most[-1] < Settings().first_seed
    with pytest.raises(ValueError, match="episodes must be a number from 1 to 999999"):
        Choosing(episodes=1_000_000)


def test_the_command_writes_its_choice_and_keeps_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(best_blind, "EVERY_CONTROL", "blind-1")
    out = tmp_path / "best.json"
    out.write_text(json.dumps({"moon": {"chosen": "slow-4"}}))
    before = CHOICE.read_bytes()
    some = ["--scenario", "left_turn", "--episodes", "2", "--jobs", "1", "--out", str(out)]
    assert main(some) == 0
    found = json.loads(out.read_text())
    assert found["moon"] == {"chosen": "slow-4"}
    assert found["left_turn"]["chosen"] == "blind-1"
    assert set(found["left_turn"]["measured"]["blind-1"]) == {"collision_rate", "time_lost"}
    assert CHOICE.read_bytes() == before
    assert "left_turn: blind-1" in capsys.readouterr().out


def test_a_scenario_that_does_not_exist_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--scenario", "moon", "--out", str(tmp_path / "best.json")]) == 2
    assert "unknown scenario 'moon'" in capsys.readouterr().err
    assert not (tmp_path / "best.json").exists()
