"""A control is named with its number, and a wrong number is answered in one line."""

import json
from pathlib import Path

import pytest

from baselines.controls import names
from baselines.controls.names import GRID, best_control, has_best_control, is_control, parsed_control, read_choice
from baselines.methods import KNOWS_NOTHING, METHODS, method_named
from cad_env.scenarios import SHIPPED


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("blind-0", ("blind", 0.0)),
        ("blind-0.5", ("blind", 0.5)),
        ("stop-60", ("stop", 60.0)),
        ("slow-7", ("slow", 7.0)),
    ],
)
def test_a_name_holds_its_kind_and_number(name: str, parts: tuple[str, float]) -> None:
    assert is_control(name)
    assert parsed_control(name) == parts
    method = method_named(name)
    assert (method.name, method.knows, method.shares, method.model) == (name, KNOWS_NOTHING, False, None)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("blind-", "blind-D needs a number of seconds from 0 to 60, such as blind-0.5, got 'blind-'"),
        ("blind--1", "blind-D needs a number of seconds from 0 to 60"),
        ("blind-61", "got 'blind-61'"),
        ("stop-nan", "stop-D needs a number of seconds from 0 to 60, such as stop-0.5, got 'stop-nan'"),
        ("stop-1e1", "got 'stop-1e1'"),
        ("stop-inf", "got 'stop-inf'"),
        ("slow-0", "slow-V needs a speed in m/s from 1 to 50, such as slow-5, got 'slow-0'"),
        ("slow-7 ", "got 'slow-7 '"),
        ("slow-7\n", r"got 'slow-7\n'"),
        ("slow-٧", "slow-V needs a speed"),
    ],
)
def test_a_wrong_number_is_refused_in_one_line(name: str, reason: str) -> None:
    with pytest.raises(ValueError, match=r"^[a-z]+-[DV] needs ") as caught:
        method_named(name)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_control_is_none() -> None:
    assert not any(map(is_control, (*METHODS, "blind", "slow", "module:blind-1", "notslow-7")))
    with pytest.raises(ValueError, match=r"a control must be named blind-D, stop-D, slow-V, got 'expert'"):
        parsed_control("expert")
    with pytest.raises(ValueError, match=r"unknown method 'blinde': .*best-blind.*, blind-D, stop-D, slow-V or give"):
        method_named("blinde")


def test_the_grid_is_the_one_that_the_scenes_are_judged_by() -> None:
    assert (
        *(f"{kind}-{seconds}" for kind in ("blind", "stop") for seconds in ("0", "0.5", "1", "2", "4", "8", "12")),
        "slow-4", "slow-5", "slow-6", "slow-7", "slow-8",
    ) == GRID  # fmt: skip
    assert all(map(parsed_control, GRID))


def test_a_control_was_chosen_for_each_scenario_that_ships() -> None:
    assert has_best_control(SHIPPED)
    assert all(best_control(name) in GRID for name in SHIPPED)
    assert not has_best_control([*SHIPPED, "moon"])


def test_a_scenario_without_a_choice_is_told_how_to_make_one() -> None:
    with pytest.raises(ValueError, match=r"scenario 'moon': choose one with python -m .*\.best_blind --scenario, or"):
        best_control("moon")


@pytest.mark.parametrize("text", ["", "[]", "{", '{"left_turn": 3}', json.dumps({"left_turn": {"chosen": None}})])
def test_a_damaged_choice_is_refused_by_name(text: str, tmp_path: Path) -> None:
    (tmp_path / "best.json").write_text(text)
    with pytest.raises(ValueError, match="is damaged: delete it") as caught:
        read_choice(tmp_path / "best.json")
    assert str(tmp_path / "best.json") in str(caught.value)


def test_a_choice_that_is_no_control_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "best.json").write_text(json.dumps({"left_turn": {"chosen": "expert"}}))
    monkeypatch.setattr(names, "read_choice", lambda: read_choice(tmp_path / "best.json"))
    with pytest.raises(ValueError, match="a control must be named"):
        best_control("left_turn")
