"""The plots of time show what was measured: who has arrived by when, and what closed eyes reach."""

from dataclasses import replace
from unittest import mock

from matplotlib.figure import Figure

from baselines.controls.names import GRID
from baselines.evaluation.report import time_plots
from baselines.evaluation.report.figures import label_of, look
from baselines.evaluation.report.time_plots import arrived_by, blind_frontier, deadlines, tradeoff
from baselines.methods import KNOWS_NOTHING, KNOWS_SEEN, KNOWS_TRUTH
from cad_env.scoring.scorecard import Record, Scorecard, scorecards

BARE = Record("left_turn", "expert", 0, False, "success", 10.0, 0, None, None, 0, 0, 0, None, None, 3, 0.0)
KNOWS = {"expert": KNOWS_TRUTH, "seer": KNOWS_SEEN, "blind-1": KNOWS_NOTHING}


def row(method: str, lost: float | None, rate: float) -> Scorecard:
    some = scorecards([BARE], expert=[BARE])[0]
    parts = {"time_lost": lost, "time_lost_low": lost, "time_lost_high": lost}
    return replace(some, method=method, collision_rate=rate, collision_low=rate, collision_high=rate, **parts)


def drawn(plot: object, *arguments: object) -> Figure:
    """The figure, before it becomes SVG."""
    with mock.patch.object(time_plots, "as_svg") as shown:
        plot(*arguments)  # type: ignore[operator]
    figure = shown.call_args.args[0]
    assert isinstance(figure, Figure)
    return figure


def test_the_frontier_is_what_no_other_blind_method_beats_in_both() -> None:
    rows = [
        row("stop-8", 6.0, 0.0), row("blind-1", 1.0, 0.2), row("blind-2", 2.0, 0.3), row("blind-4", 4.0, 0.2),
        row("always-go", 0.0, 0.5), row("slow-4", None, 0.0), row("seer", 0.0, 0.0), row("expert", 0.0, 0.0),
    ]  # fmt: skip
    assert blind_frontier(rows, KNOWS) == [(0.0, 0.5), (1.0, 0.2), (6.0, 0.0)]
    assert blind_frontier(rows[-2:], KNOWS) == []


def test_of_equally_fast_ones_the_safest_counts() -> None:
    assert blind_frontier([row("blind-1", 1.0, 0.4), row("stop-1", 1.0, 0.1)], KNOWS) == [(1.0, 0.1)]


def test_the_frontier_is_drawn_down_to_the_end_of_the_axis() -> None:
    rows = [row("expert", 0.0, 0.0), row("always-go", -0.5, 0.5), row("blind-1", 1.0, 0.2)]
    (axes,) = drawn(tradeoff, rows, KNOWS).axes
    stair = max(axes.lines, key=lambda line: len(line.get_xdata()))
    end = axes.get_xlim()[1]
    assert end > 1.0
    assert [tuple(point) for point in stair.get_xydata()] == [(-0.5, 102.0), (-0.5, 50.0), (1.0, 20.0), (end, 20.0)]


def test_arrivals_count_successes_only() -> None:
    records = [
        replace(BARE, seed=k, time=time, outcome=outcome)
        for k, (time, outcome) in enumerate(
            [(9.0, "success"), (5.0, "collision"), (7.0, "success"), (9.0, "success"), (40.0, "timeout")]
        )
    ]
    assert arrived_by(records) == ([0.0, 7.0, 9.0], [0, 1, 3])
    assert arrived_by(records[1:2]) == ([0.0], [0])


def test_a_curve_ends_at_the_success_rate_when_time_is_up() -> None:
    records = [replace(BARE, seed=k, time=8.0 + k) for k in range(4)]
    records += [replace(record, method="seer", outcome="collision" if record.seed else "success") for record in records]
    records.append(replace(BARE, method="blind-1", time=40.0, outcome="timeout"))
    (axes,) = drawn(deadlines, records, KNOWS).axes
    ends = [line.get_xydata()[-1].tolist() for line in axes.lines]
    assert ends == [[40.0, 100.0], [40.0, 25.0], [40.0, 0.0]]
    assert len(axes.collections) == 2  # a band each for all but the control


def test_controls_of_a_kind_share_a_line_of_the_legend() -> None:
    assert list(dict.fromkeys(map(label_of, GRID))) == ["blind-D", "stop-D", "slow-V"]
    assert look("stop-1", KNOWS) == look("stop-12", KNOWS) != look("slow-4", KNOWS)
    assert label_of("best-blind") == "best-blind"
