"""What time costs: collisions against time lost, and who has arrived by when."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from baselines.controls.names import is_control
from baselines.evaluation.report.figures import (
    Knows,
    Plot,
    arms,
    as_svg,
    colour,
    label_of,
    look,
    method_legend,
    names_in,
    panels,
    scenarios_in,
)
from baselines.methods import KNOWS_NOTHING
from cad_env.scoring.interval import wilson
from cad_env.scoring.scorecard import Record, Scorecard
from cad_env.types import SUCCESS

_LINES = ("-", "--", ":", "-.")  # of methods that know the same
_LINEAR = 2.0  # s lost, up to which the axis is linear
_TICKS = (-10.0, -5.0, -2.0, -1.0, 0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)


def tradeoff(rows: Sequence[Scorecard], knows: Knows) -> Plot:
    """Collision rate against time lost, with the frontier of the methods that know nothing."""
    known = [row for row in rows if row.time_lost is not None]
    figure, (row_of_panels,) = panels(scenarios_in(known), 1, 4.0)
    for scenario, axes in row_of_panels.items():
        here = [row for row in known if row.scenario == scenario]
        for row in here:
            _point(axes, row, knows)
        axes.set_xscale("symlog", linthresh=_LINEAR)
        low, high = _limits(here)
        axes.set(xlim=(low, high), ylim=(-2, 102), xlabel="time lost against the expert, s")
        axes.set_xticks([tick for tick in _TICKS if low <= tick <= high], minor=False)
        axes.set_xticklabels([f"{tick:g}" for tick in axes.get_xticks()])
        axes.minorticks_off()
        _draw_frontier(axes, blind_frontier(here, knows), high)
    row_of_panels[scenarios_in(known)[0]].set_ylabel("collisions, % of episodes")
    method_legend(figure, names_in(known), knows)
    caption = (
        "Collisions, per cent of all episodes with their 95 % Wilson interval, against the mean time lost with its "
        "own. Left and down is better. Line: the best that methods of this run reach with closed eyes; who is in the "
        "grey has not shown that it uses what it sees or is sent."
    )
    return Plot("Collisions against time lost", caption, as_svg(figure))


def _point(axes: Axes, row: Scorecard, knows: Knows) -> None:
    lost, low, high = (each or 0.0 for each in (row.time_lost, row.time_lost_low, row.time_lost_high))  # all known
    axes.errorbar(
        lost, 100 * row.collision_rate, xerr=arms(lost, low, high, 1.0),
        yerr=arms(row.collision_rate, row.collision_low, row.collision_high),
        elinewidth=0.6 if is_control(row.method) else 1.0, **look(row.method, knows),
    )  # fmt: skip


def _limits(rows: Sequence[Scorecard]) -> tuple[float, float]:
    """s, from where to where the axis of one scenario goes: all intervals and zero."""
    ends = [0.0, *(end for row in rows for end in (row.time_lost_low, row.time_lost_high) if end is not None)]
    return 1.15 * min(ends) - 0.3, 1.15 * max(ends) + 0.3


def blind_frontier(rows: Sequence[Scorecard], knows: Knows) -> list[tuple[float, float]]:
    """(time lost, s, collision rate) of the methods with closed eyes that no other beats in both, the fastest first.

    rows: of one scenario.
    """
    points = sorted(
        (row.time_lost, row.collision_rate)
        for row in rows
        if row.time_lost is not None and knows.get(row.method, KNOWS_NOTHING) == KNOWS_NOTHING
    )
    frontier: list[tuple[float, float]] = []
    for lost, rate in points:
        if not frontier or rate < frontier[-1][1]:
            frontier.append((lost, rate))
    return frontier


def _draw_frontier(axes: Axes, frontier: Sequence[tuple[float, float]], end: float) -> None:
    """A stair from the fastest to the safest; what is above and to the right of it is grey."""
    if not frontier:
        return
    times = [frontier[0][0], *(lost for lost, _ in frontier), end]
    rates = [102.0, *(100 * rate for _, rate in frontier), 100 * frontier[-1][1]]
    axes.step(times, rates, where="post", color="#555555", linewidth=1.0, zorder=1)
    axes.fill_between(times, rates, 102.0, step="post", color="#f2f2f2", linewidth=0.0, zorder=0)


def deadlines(records: Sequence[Record], knows: Knows) -> Plot:
    """Share of all episodes in which the ego has arrived by a time."""
    looks = _line_looks(names_in(records), knows)
    figure, (row_of_panels,) = panels(scenarios_in(records), 1, 3.6)
    for scenario, axes in row_of_panels.items():
        here = [record for record in records if record.scenario == scenario]
        end = max(record.time for record in here)
        for name in names_in(here):
            _arrivals(axes, [record for record in here if record.method == name], end, looks[name])
        axes.set(xlim=(0.0, end), ylim=(-2, 102), xlabel="deadline, s")
    row_of_panels[scenarios_in(records)[0]].set_ylabel("arrived, % of episodes")
    _line_legend(figure, looks)
    caption = (
        "Share of all episodes in which the ego has arrived by a time, with its 95 % Wilson interval; thin lines "
        "without it: controls. Up and left is better. Who collides never arrives."
    )
    return Plot("Success by a deadline", caption, as_svg(figure))


def arrived_by(records: Sequence[Record]) -> tuple[list[float], list[int]]:
    """(times, s, rising from 0, how many episodes have arrived by each): one method in one scenario."""
    times = sorted(record.time for record in records if record.outcome == SUCCESS)
    steps = sorted({0.0, *times})
    return steps, np.searchsorted(times, steps, side="right").tolist()


def _arrivals(axes: Axes, records: Sequence[Record], end: float, looks: Mapping[str, Any]) -> None:
    times, counts = arrived_by(records)
    times, counts = [*times, end], [*counts, counts[-1]]
    axes.step(times, [100 * count / len(records) for count in counts], where="post", **looks)
    if not is_control(records[0].method):  # so many bands would hide each other
        low, high = 100 * np.array([wilson(count, len(records)) for count in counts]).T
        axes.fill_between(times, low, high, step="post", color=looks["color"], alpha=0.1, linewidth=0.0)


def _line_looks(names: Sequence[str], knows: Knows) -> dict[str, dict[str, Any]]:
    """Colour by what a method knows, line by who of them it is; controls have a thin line."""
    lines = {colour(name, knows): cycle(_LINES) for name in names}
    return {
        name: {"color": colour(name, knows), "linestyle": "-", "linewidth": 0.5}
        if is_control(name)
        else {"color": colour(name, knows), "linestyle": next(lines[colour(name, knows)]), "linewidth": 1.5}
        for name in names
    }


def _line_legend(figure: Figure, looks: Mapping[str, Mapping[str, Any]]) -> None:
    keys = {label_of(name): look for name, look in looks.items()}
    handles = [Line2D([], [], label=label, **look) for label, look in keys.items()]
    figure.legend(handles=handles, loc="outside right center")
