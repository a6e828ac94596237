"""The report of several conditions: matrices with their worst cells, and what sharing is worth."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from baselines.evaluation.report import matrix, penetration, write_report
from baselines.evaluation.report.matrix import MEASURES, matrices, values_of, worst_of
from baselines.evaluation.report.penetration import WITNESSED, penetration_steps, worth_of_sharing
from baselines.methods import METHODS
from cad_env.conditions import CONDITIONS, Condition
from cad_env.scoring.scorecard import Record, Scorecard, scorecards
from tests.baselines.evaluation.test_report import SETTINGS, Page, some_records

KNOWS = {name: METHODS[name].knows for name in ("always-brake", "stgraph", "planner-shared")}
NAMES = ("nominal", "alone", "penetration-10", "dense")
BARE = Record("left_turn", "stgraph", 1, False, "success", 10.0, 0, None, None, 0, 0, 0, None, None, 1, 0.0)
COLLISIONS, SUCCESS, CALM_TIME = MEASURES


def episodes(condition: str, method: str, outcomes: str, time: float = 10.0) -> list[Record]:
    """An episode for each letter: s(uccess), c(ollision) or t(imeout), none with a hazard."""
    names = {"s": "success", "c": "collision", "t": "timeout"}
    some = replace(BARE, condition=condition, method=method, time=time)
    return [replace(some, seed=seed, outcome=names[letter]) for seed, letter in enumerate(outcomes)]


@pytest.fixture
def rows() -> list[Scorecard]:
    """The network collides when it is alone; the rules wait."""
    return scorecards(
        [
            *episodes("nominal", "stgraph", "ssss"), *episodes("nominal", "planner-shared", "ssss", 9.0),
            *episodes("nominal", "always-brake", "tttt"),
            *episodes("alone", "stgraph", "sscc", 12.0), *episodes("alone", "planner-shared", "tttt"),
            *episodes("alone", "always-brake", "tttt"),
        ]
    )  # fmt: skip


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are drawn."""
    figures: list[Figure] = []
    for module in (matrix, penetration):
        monkeypatch.setattr(module, "as_svg", lambda figure: figures.append(figure) or b"")
    return figures


def test_the_worst_is_of_those_that_know_something(rows: Sequence[Scorecard]) -> None:
    assert worst_of(values_of(rows, COLLISIONS), COLLISIONS, KNOWS) == [("alone", "stgraph")]
    assert worst_of(values_of(rows, SUCCESS), SUCCESS, KNOWS) == [("alone", "planner-shared")]
    assert worst_of(values_of(rows, CALM_TIME), CALM_TIME, KNOWS) == [("alone", "stgraph")]
    assert ("alone", "always-brake") in worst_of(values_of(rows, SUCCESS), SUCCESS, {})


def test_equal_cells_have_no_worst_and_equally_bad_ones_are_all_marked() -> None:
    same = scorecards([*episodes("nominal", "stgraph", "ss"), *episodes("alone", "stgraph", "ss")])
    assert worst_of(values_of(same, COLLISIONS), COLLISIONS, KNOWS) == []
    three = scorecards(
        [each for name in NAMES for each in episodes(name, "stgraph", "sc" if name != "dense" else "ss")]
    )
    assert [name for name, _ in worst_of(values_of(three, COLLISIONS), COLLISIONS, KNOWS)] == list(NAMES[:3])
    assert worst_of({}, COLLISIONS, KNOWS) == []


def framed(axes: Axes) -> list[tuple[float, float]]:
    """Column and row of each frame."""
    frames = [patch for patch in axes.patches if isinstance(patch, Rectangle) and not patch.get_fill()]
    return [(frame.get_x() + 0.5, frame.get_y() + 0.5) for frame in frames]


def test_the_matrix_shows_every_cell_and_frames_the_worst(rows: Sequence[Scorecard], drawn: list[Figure]) -> None:
    (plot,) = matrices(rows, KNOWS)
    collisions, success, calm = drawn[0].axes
    assert plot.title == "Left turn: every condition"
    assert "Most collisions: stgraph under alone, 50.0 % [15.0, 85.0]." in plot.caption
    assert [text.get_text() for text in collisions.texts] == ["0.0", "0.0", "0.0", "50.0", "0.0", "0.0"]
    assert [text.get_text() for text in success.texts] == ["100.0", "100.0", "0.0", "(50.0)", "0.0", "0.0"]
    assert [text.get_text() for text in calm.texts] == ["10.0", "9.0", "–", "(12.0)", "–", "–"]
    assert [framed(axes) for axes in (collisions, success, calm)] == [[(0, 1)], [(1, 1)], [(0, 1)]]


def test_the_worst_cell_is_the_darkest(rows: Sequence[Scorecard], drawn: list[Figure]) -> None:
    matrices(rows, KNOWS)
    shades = [sum(patch.get_facecolor()[:3]) for patch in drawn[0].axes[0].patches if patch.get_fill()]
    assert shades.index(min(shades)) == 3
    assert max(shades) == 3.0  # white: no collision at all


def test_the_axis_goes_from_nobody_to_everybody_then_to_the_witness() -> None:
    assert penetration_steps(CONDITIONS) == {
        "alone": "0", "penetration-05": "5", "penetration-10": "10", "penetration-25": "25",
        "penetration-50": "50", "penetration-100": "100", "nominal": WITNESSED,
    }  # fmt: skip
    mine = {
        "mine": Condition("mine", "a test", penetration=0.4),
        "lossy": Condition("l", "t", penetration=0.3, loss=0.1),
    }
    assert penetration_steps(mine) == {"mine": "40"}


def test_points_with_collisions_are_hollow_and_their_lines_dotted(drawn: list[Figure]) -> None:
    some = [each for name in NAMES for each in episodes(name, "planner-shared", "ss")]
    some += [*episodes("nominal", "stgraph", "ss"), *episodes("penetration-10", "stgraph", "ss")]
    some += [*episodes("alone", "stgraph", "cs"), *episodes("nominal", "always-brake", "tt")]
    steps = penetration_steps({name: CONDITIONS[name] for name in NAMES})
    worth_of_sharing(scorecards(some), KNOWS, steps)
    success = drawn[0].axes[0]
    lines = [
        line.get_linestyle() for line in success.lines if len(line.get_xdata()) == 2 and line.get_marker() == "None"
    ]
    assert lines.count("-") == lines.count(":") + 1  # one of each method, and the rule before the witness
    hollow = [line for line in success.lines if line.get_markerfacecolor() == "#ffffff"]
    assert [line.get_ydata()[0] for line in hollow] == [50.0]
    assert [text.get_text() for text in drawn[0].legends[0].get_texts()] == [
        "planner-shared", "stgraph", "≤ 1 % collisions", "more collisions",
    ]  # fmt: skip


def with_conditions(names: Sequence[str], folder: Path) -> Page:
    """The page of a run under some conditions."""
    records = [replace(each, condition=name) for name in names for each in some_records(["left_turn"])]
    said = {name: CONDITIONS[name].settings for name in names}
    (folder / "settings.json").write_text(json.dumps({**SETTINGS, "condition": said}))
    (folder / "episodes.jsonl").write_text("".join(record.line() + "\n" for record in records))
    return Page(write_report(folder))


def test_the_page_shows_conditions_side_by_side_and_who_is_connected(tmp_path: Path) -> None:
    page = with_conditions(NAMES, tmp_path)
    assert list(page.images) == [
        "Left turn: every condition", "Success and calm time against penetration, at equal safety"
    ]  # fmt: skip
    for name in NAMES:
        assert f"{name}: {CONDITIONS[name].words}." in page.text
        assert f"{name}: Left turn" in page.text
    assert "under 4 conditions" in page.text
    assert "time of successes s" in page.text


def test_one_condition_has_all_plots_of_a_run_and_no_matrix(tmp_path: Path) -> None:
    images = with_conditions(["alone"], tmp_path).images
    assert "Collisions" in images
    assert "Left turn: every condition" not in images


def test_without_steps_of_penetration_there_is_no_plot_of_them(tmp_path: Path) -> None:
    assert list(with_conditions(["loss-40", "dense"], tmp_path).images) == ["Left turn: every condition"]


def test_a_page_without_conditions_says_that_a_witness_is_connected(tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_text(json.dumps(SETTINGS))
    (tmp_path / "episodes.jsonl").write_text("".join(record.line() + "\n" for record in some_records()))
    assert "In every episode: light traffic; a witness is always connected." in Page(write_report(tmp_path)).text
