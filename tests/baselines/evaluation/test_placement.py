"""The measurement of placement: rows of what was asked for, in words and numbers that agree."""

import json
from pathlib import Path

import pytest

from baselines.evaluation.placement import PlacementSettings, main, measured, placement_table, rows_of

SOME = ("--scenario", "left_turn", "--episodes", "2")


def test_a_run_writes_what_it_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SOME, "--pose", "exact", "standard", "--placing", "fixes", "registered", "--out", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "placement.json").read_text())["rows"]
    assert [(row["pose"], row["placing"]) for row in rows] == [
        ("exact", "registered"), ("standard", "fixes"), ("standard", "registered"),
    ]  # fmt: skip
    printed = capsys.readouterr().out
    assert printed.strip() in (tmp_path / "placement.md").read_text()
    assert rows[0]["said_rms"] is None
    assert rows[0]["merged_rms"] < 0.3
    assert rows[2]["said_rms"] < 0.5 < rows[1]["said_rms"]


def test_who_is_denied_is_placed_by_what_it_sees_or_not_at_all() -> None:
    by_fixes, registered = (measured("left_turn", "denied", placing, range(3)) for placing in ("fixes", "registered"))
    assert by_fixes.abstained == 1.0
    assert by_fixes.said_rms is None
    assert registered.abstained < 0.5
    assert registered.said_rms < 0.5
    assert "-" in placement_table([by_fixes])


def test_a_number_is_a_bias() -> None:
    settings = PlacementSettings(scenario=("left_turn",), pose=("3",), placing=("fixes",), episodes=3)
    (row,) = rows_of(settings)
    assert row.said_rms > 1.5


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--pose", "ubran"), "did you mean urban?"),
        (("--placing", "registred"), "did you mean registered?"),
        (("--episodes", "0"), "episodes must be a number from 1"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    words: tuple[str, ...], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(list(words)) == 2
    said = capsys.readouterr().err
    assert reason in said
    assert said.count("\n") == 1
