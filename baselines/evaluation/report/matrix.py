"""Conditions x methods: collisions, success and calm time, a picture for each scenario, its worst cells marked."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle

from baselines.evaluation.report.figures import Knows, Plot, as_svg, names_in, scenarios_in
from baselines.methods import KNOWS_NOTHING
from baselines.plot_style import INK, VERMILION
from cad_env.scoring.scorecard import Scorecard

SAFE_RATE = 0.01  # collision rate up to which a method counts as safe
_SHADES = LinearSegmentedColormap.from_list("worse", ["#ffffff", VERMILION])
_CELL = 0.52, 0.26  # inches

Cell = tuple[str | None, str]  # condition, method


@dataclass(frozen=True)
class Measure:
    """A number of every cell."""

    title: str
    value: Callable[[Scorecard], float | None]
    hazard: str  # the episodes it is of, as in Scorecard
    more_is_worse: bool
    least_span: float  # between white and the darkest shade


MEASURES = (
    Measure("collisions, %", lambda row: 100 * row.collision_rate, "all", True, 5.0),
    Measure("success, %", lambda row: 100 * row.success_rate, "all", False, 5.0),
    Measure("calm time, s", lambda row: row.mean_time_success, "no", True, 1.0),
)


def matrices(rows: Sequence[Scorecard], knows: Knows) -> list[Plot]:
    """A picture for each scenario. rows: of all kinds of episodes and several conditions."""
    return [
        _matrix(scenario, [row for row in rows if row.scenario == scenario], knows) for scenario in scenarios_in(rows)
    ]


def _matrix(scenario: str, rows: Sequence[Scorecard], knows: Knows) -> Plot:
    conditions, methods = list(dict.fromkeys(row.condition for row in rows)), names_in(rows)
    size = 1.8 + 3 * (0.3 + _CELL[0] * len(methods)), 1.6 + _CELL[1] * len(conditions)
    figure = Figure(size, layout=ConstrainedLayoutEngine(wspace=0.04))
    grid = figure.subplots(1, len(MEASURES), sharey=True, squeeze=False)[0]
    unsafe = {(row.condition, row.method) for row in rows if row.hazard == "all" and row.collision_rate > SAFE_RATE}
    for axes, measure in zip(grid, MEASURES, strict=True):
        values = values_of(rows, measure)
        _cells(axes, values, measure, [(each, name) for each in conditions for name in methods], unsafe)
        for condition, name in worst_of(values, measure, knows):
            place = methods.index(name) - 0.5, conditions.index(condition) - 0.5
            axes.add_patch(Rectangle(place, 1, 1, fill=False, edgecolor=INK, linewidth=2.2, clip_on=False, zorder=3))
        axes.set_title(measure.title, fontsize=10.5, loc="left", fontweight="bold")
        axes.set(xlim=(-0.5, len(methods) - 0.5), ylim=(len(conditions) - 0.5, -0.5))
        axes.set_xticks(range(len(methods)), methods, rotation=40, ha="right", rotation_mode="anchor", fontsize=9)
        axes.set_yticks(range(len(conditions)), [str(each) for each in conditions], fontsize=9)
        axes.tick_params(length=0)
        axes.grid(visible=False)
    return Plot(f"{scenario.replace('_', ' ').capitalize()}: every condition", _caption(rows, knows), as_svg(figure))


def values_of(rows: Sequence[Scorecard], measure: Measure) -> dict[Cell, float]:
    """The number of each cell that has one. rows: of one scenario."""
    found = {(row.condition, row.method): measure.value(row) for row in rows if row.hazard == measure.hazard}
    return {cell: value for cell, value in found.items() if value is not None}


def worst_of(values: Mapping[Cell, float], measure: Measure, knows: Knows) -> list[Cell]:
    """The worst cells of the methods that know anything, or of all if none does; none if all cells are alike."""
    sighted = {cell: value for cell, value in values.items() if knows.get(cell[1], KNOWS_NOTHING) != KNOWS_NOTHING}
    judged = sighted or values
    if not judged or min(judged.values()) == max(judged.values()):
        return []
    worst = (max if measure.more_is_worse else min)(judged.values())
    return [cell for cell, value in judged.items() if value == worst]


def _cells(
    axes: Axes, values: Mapping[Cell, float], measure: Measure, cells: Sequence[Cell], unsafe: set[Cell]
) -> None:
    """A shade and a number for each cell."""
    methods = list(dict.fromkeys(name for _, name in cells))
    low, high = min(values.values(), default=0.0), max(values.values(), default=1.0)
    span = max(high - low, measure.least_span)
    for index, cell in enumerate(cells):
        place = index % len(methods), index // len(methods)
        if cell not in values:
            axes.text(*place, "–", **_TEXT)
            continue
        value = values[cell]
        badness = ((value - low) if measure.more_is_worse else (high - value)) / span
        corner = place[0] - 0.5, place[1] - 0.5
        axes.add_patch(Rectangle(corner, 1, 1, facecolor=_SHADES(badness), edgecolor="#ffffff", linewidth=0.8))
        bracketed = cell in unsafe and measure is not MEASURES[0]
        axes.text(*place, f"({value:.1f})" if bracketed else f"{value:.1f}", **_TEXT)


_TEXT: Mapping[str, Any] = {"ha": "center", "va": "center", "fontsize": 8.5, "color": INK}


def _caption(rows: Sequence[Scorecard], knows: Knows) -> str:
    worst = worst_of(values_of(rows, MEASURES[0]), MEASURES[0], knows)
    most = {(row.condition, row.method): row for row in rows if row.hazard == "all"}
    named = "".join(
        f" Most collisions: {name} under {condition}, {100 * most[condition, name].collision_rate:.1f} % "
        f"[{100 * most[condition, name].collision_low:.1f}, {100 * most[condition, name].collision_high:.1f}]."
        for condition, name in worst[:1]
    )
    return (
        "The darker, the worse. Framed: the worst of each part, methods that know nothing not counted."
        f"{named} In brackets: of a method that collides in more than {100 * SAFE_RATE:g} % of these episodes, which "
        "its success and time must not make up for. Calm time: mean time of the episodes without a hazard in which the "
        "ego arrives; a dash: it never does."
    )
