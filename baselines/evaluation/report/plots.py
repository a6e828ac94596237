"""Scores -> plots, every rate with its 95 % Wilson interval."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from baselines.evaluation.report.figures import as_svg, colour, knowledge_legend, look, method_legend, panels
from baselines.plot_style import styled
from cad_env.scoring.interval import wilson
from cad_env.scoring.scorecard import Record, Scorecard
from cad_env.types import Floats

BINS = 6  # of the hazard time
Knows = Mapping[str, str]  # method -> what it knows


@dataclass(frozen=True)
class Plot:
    """A picture with its title and caption."""

    title: str
    caption: str
    svg: bytes


def all_plots(rows: Sequence[Scorecard], records: Sequence[Record], knows: Knows) -> list[Plot]:
    """All plots that have something to show."""
    whole = [row for row in rows if row.hazard == "all"]
    timed = [record for record in records if record.hazard and record.hazard_time is not None]
    with styled():
        drawn = [collisions(whole, knows), successes(whole, knows)]
        if any(row.bytes_per_second for row in whole):
            drawn.append(radio(whole, knows))
        if timed:
            drawn.append(timing(timed, knows))
    return drawn


def collisions(rows: Sequence[Scorecard], knows: Knows) -> Plot:
    """Collision rate by scenario and method."""
    svg = _rates(rows, knows, lambda row: (row.collision_rate, row.collision_low, row.collision_high), "collisions")
    return Plot("Collisions", "Share of all episodes that end in a collision, with its 95 % Wilson interval.", svg)


def successes(rows: Sequence[Scorecard], knows: Knows) -> Plot:
    """Success rate by scenario and method."""
    svg = _rates(rows, knows, lambda row: (row.success_rate, row.success_low, row.success_high), "successes")
    caption = (
        "Share of all episodes in which the ego arrives, with its 95 % Wilson interval. Who neither arrives nor "
        "collides has waited until time was up."
    )
    return Plot("Successes", caption, svg)


def _rates(
    rows: Sequence[Scorecard], knows: Knows, rate_of: Callable[[Scorecard], tuple[float, float, float]], what: str
) -> bytes:
    names, scenarios = _names(rows), _scenarios(rows)
    figure, (row_of_panels,) = panels(scenarios, 1, 1.4 + 0.27 * len(names))
    for scenario, axes in row_of_panels.items():
        for row in rows:
            if row.scenario == scenario:
                place, (rate, *interval) = names.index(row.method), rate_of(row)
                axes.errorbar(
                    100 * rate, place, xerr=_arms(rate, *interval), clip_on=False, **look(row.method, knows)
                )  # fmt: skip
                axes.text(105, place, f"{100 * rate:.1f}", va="center", fontsize=8.5, color="#333333")
        axes.set(xlim=(0, 100), xlabel=f"{what}, % of episodes", ylim=(len(names) - 0.5, -0.5))
        axes.set_yticks(range(len(names)), names)
        axes.grid(axis="y", visible=False)
    knowledge_legend(figure, names, knows)
    return as_svg(figure)


def radio(rows: Sequence[Scorecard], knows: Knows) -> Plot:
    """Collision rate against the bytes per second of all senders; methods that send nothing are left of zero."""
    names, scenarios = _names(rows), _scenarios(rows)
    figure, (row_of_panels,) = panels(scenarios, 1, 3.4)
    most = max(row.bytes_per_second for row in rows) / 1000
    silent = [name for name in names if not any(row.bytes_per_second for row in rows if row.method == name)]
    zone = 0.07 * most * (len(silent) + 1)
    for scenario, axes in row_of_panels.items():
        for row in rows:
            if row.scenario == scenario:
                beside = -zone + 0.07 * most * (silent.index(row.method) + 1) if row.method in silent else 0.0
                interval = _arms(row.collision_rate, row.collision_low, row.collision_high)
                place = row.bytes_per_second / 1000 + beside
                axes.errorbar(place, 100 * row.collision_rate, yerr=interval, **look(row.method, knows))
        axes.axvspan(-zone, 0.0, color="#f2f2f2", linewidth=0.0, zorder=0)
        axes.text(-0.5 * zone, 97, "nothing sent", ha="center", va="top", fontsize=8.5, color="#555555")
        axes.set(xlabel="on the air, kB/s", xlim=(-zone, 1.15 * most), ylim=(-2, 102))
        axes.set_xticks([tick for tick in axes.get_xticks() if 0.0 <= tick <= 1.15 * most])
    row_of_panels[scenarios[0]].set_ylabel("collisions, % of episodes")
    method_legend(figure, names, knows)
    caption = (
        "Collisions against all bytes that the connected vehicles of a scene send in a second, together. Up is worse, "
        "right costs more. The expert knows the truth without a radio."
    )
    return Plot("Safety against bytes on the air", caption, as_svg(figure))


def timing(records: Sequence[Record], knows: Knows) -> Plot:
    """Collision rate of episodes with a hazard against its time: a row of panels for each method."""
    names, scenarios = _names(records), _scenarios(records)
    figure, grid = panels(scenarios, len(names), 0.9 + 0.75 * len(names), sharex="col")
    for name, row_of_panels in zip(names, grid, strict=True):
        for scenario, axes in row_of_panels.items():
            here = [record for record in records if record.scenario == scenario]
            times = np.array([record.hazard_time for record in here], float)
            edges = np.linspace(times.min(), max(times.max(), times.min() + 0.1), BINS + 1)
            _timing_line(axes, [record for record in here if record.method == name], knows, edges)
            axes.set(ylim=(-4, 104), yticks=(0, 50, 100))
        row_of_panels[scenarios[0]].set_ylabel(name, rotation=0, ha="right", va="center", color=colour(name, knows))
    for axes in grid[-1].values():
        axes.set_xlabel("hidden vehicle after an unbraked ego, s")
    caption = (
        f"Collisions, per cent of the episodes with a hazard, in {BINS} bins of its time: how much later than an ego "
        "that never brakes the hidden vehicle would be where they meet. Shaded: the 95 % Wilson interval."
    )
    return Plot("Collisions against hazard time", caption, as_svg(figure))


def _timing_line(axes: Axes, records: Sequence[Record], knows: Knows, edges: Floats) -> None:
    times = np.array([record.hazard_time for record in records], float)
    bins = np.clip(np.digitize(times, edges) - 1, 0, BINS - 1)
    crashed = np.array([record.outcome == "collision" for record in records])
    filled = np.unique(bins)
    rates = [100 * crashed[bins == k].mean() for k in filled]
    low, high = zip(*(wilson(int(crashed[bins == k].sum()), int((bins == k).sum())) for k in filled), strict=True)
    middle, name = (0.5 * (edges[:-1] + edges[1:]))[filled], records[0].method
    axes.fill_between(
        middle, 100 * np.array(low), 100 * np.array(high), color=colour(name, knows), alpha=0.2, linewidth=0.0
    )  # fmt: skip
    axes.plot(middle, rates, **look(name, knows) | {"linestyle": "-", "markersize": 4.5, "clip_on": False})


def _arms(rate: float, low: float, high: float) -> list[list[float]]:
    """The lengths of error bars for an interval, in per cent."""
    return [[100 * (rate - low)], [100 * (high - rate)]]


def _names(of: Sequence[Scorecard] | Sequence[Record]) -> list[str]:
    return list(dict.fromkeys(one.method for one in of))


def _scenarios(of: Sequence[Scorecard] | Sequence[Record]) -> list[str]:
    return list(dict.fromkeys(one.scenario for one in of))
