"""Scores -> plots, rates with their 95 % Wilson interval."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from baselines.controls.names import is_control
from baselines.evaluation.report.figures import (
    Knows,
    Plot,
    arms,
    as_svg,
    knowledge_legend,
    look,
    method_legend,
    names_in,
    panels,
    scenarios_in,
)
from baselines.evaluation.report.matrix import matrices
from baselines.evaluation.report.penetration import penetration_steps, worth_of_sharing
from baselines.evaluation.report.time_plots import deadlines, tradeoff
from baselines.plot_style import styled
from cad_env.conditions import Condition
from cad_env.scoring.scorecard import Record, Scorecard


def all_plots(
    rows: Sequence[Scorecard],
    records: Sequence[Record],
    knows: Knows,
    conditions: Mapping[str | None, Condition] = MappingProxyType({}),
) -> list[Plot]:
    """All plots that have something to show: of one condition in detail, of several side by side."""
    if len({row.condition for row in rows}) > 1:
        steps = penetration_steps(conditions)
        with styled():
            return [*matrices(rows, knows), *([worth_of_sharing(rows, knows, steps)] if len(steps) > 1 else [])]
    whole = [row for row in rows if row.hazard == "all"]
    with styled():
        drawn = [collisions(whole, knows), successes(whole, knows)]
        if any(row.time_lost is not None for row in whole):
            drawn.append(tradeoff(whole, knows))
        drawn.append(deadlines(records, knows))
        if any(row.bytes_per_second for row in whole):
            drawn.append(radio([row for row in whole if not is_control(row.method)], knows))
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
    names, scenarios = names_in(rows), scenarios_in(rows)
    figure, (row_of_panels,) = panels(scenarios, 1, 1.4 + 0.27 * len(names))
    for scenario, axes in row_of_panels.items():
        for row in rows:
            if row.scenario == scenario:
                place, (rate, *interval) = names.index(row.method), rate_of(row)
                axes.errorbar(
                    100 * rate, place, xerr=arms(rate, *interval), clip_on=False, **look(row.method, knows)
                )  # fmt: skip
                axes.text(105, place, f"{100 * rate:.1f}", va="center", fontsize=8.5, color="#333333")
        axes.set(xlim=(0, 100), xlabel=f"{what}, % of episodes", ylim=(len(names) - 0.5, -0.5))
        axes.set_yticks(range(len(names)), names)
        axes.grid(axis="y", visible=False)
    knowledge_legend(figure, names, knows)
    return as_svg(figure)


def radio(rows: Sequence[Scorecard], knows: Knows) -> Plot:
    """Collision rate against the bytes per second of all senders; methods that send nothing are left of zero."""
    names, scenarios = names_in(rows), scenarios_in(rows)
    figure, (row_of_panels,) = panels(scenarios, 1, 3.4)
    most = max(row.bytes_per_second for row in rows) / 1000
    silent = [name for name in names if not any(row.bytes_per_second for row in rows if row.method == name)]
    zone = 0.07 * most * (len(silent) + 1)
    for scenario, axes in row_of_panels.items():
        for row in rows:
            if row.scenario == scenario:
                beside = -zone + 0.07 * most * (silent.index(row.method) + 1) if row.method in silent else 0.0
                interval = arms(row.collision_rate, row.collision_low, row.collision_high)
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
