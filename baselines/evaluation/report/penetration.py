"""What sharing is worth: success and calm time against penetration, at equal safety."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from baselines.evaluation.report.figures import Knows, Plot, arms, as_svg, look, names_in, panels, scenarios_in
from baselines.evaluation.report.matrix import SAFE_RATE
from baselines.methods import KNOWS_NOTHING
from baselines.plot_style import INK
from cad_env.conditions import CONDITIONS, Condition
from cad_env.scoring.scorecard import Scorecard

_SPREAD = 0.36  # of a step, over which methods stand beside each other
WITNESSED = "witness\nalways"  # the label of the guaranteed one
CAPTION = (
    f"Full points and lines: at most {100 * SAFE_RATE:g} % collisions, so that they may be compared. Hollow points and "
    "dotted lines: more collisions than that; such a success or time is bought with safety. Bars: 95 % intervals. Calm "
    "time: mean time of the episodes without a hazard in which the ego arrives. Each vehicle but the hidden ones is "
    "connected by itself with that probability; at 0 the ego is alone. Steps are not to scale."
)
_USUAL = CONDITIONS["nominal"]


def penetration_steps(conditions: Mapping[str | None, Condition]) -> dict[str | None, str]:
    """condition -> label of its place on the axis, from nobody to everybody; last the guaranteed witness.

    Conditions that change anything else are not among them; of several with the same penetration only the first is.
    """
    alike: dict[float, str | None] = {}
    for name, each in conditions.items():
        if each.penetration is not None and each.settings == replace(_USUAL, penetration=each.penetration).settings:
            alike.setdefault(each.penetration, name)
    steps = {alike[share]: f"{100 * share:g}" for share in sorted(alike)}
    witnessed = [name for name, each in conditions.items() if each.settings == _USUAL.settings]
    return steps | dict.fromkeys(witnessed[:1], WITNESSED)


def worth_of_sharing(rows: Sequence[Scorecard], knows: Knows, steps: Mapping[str | None, str]) -> Plot:
    """Rows of all kinds of episodes; methods that know nothing are left out."""
    seen = [row for row in rows if row.condition in steps and knows.get(row.method, KNOWS_NOTHING) != KNOWS_NOTHING]
    names, scenarios = names_in(seen), scenarios_in(seen)
    figure, (successes, times) = panels(scenarios, 2, 5.6, sharex=True, sharey="row")
    for scenario in scenarios:
        for number, name in enumerate(names):
            mine = [row for row in seen if (row.scenario, row.method) == (scenario, name)]
            safe = {row.condition for row in mine if row.hazard == "all" and row.collision_rate <= SAFE_RATE}
            beside = _SPREAD * (number / max(len(names) - 1, 1) - 0.5)
            for axes, points in ((successes[scenario], _success(mine)), (times[scenario], _calm_time(mine))):
                _draw(axes, points, steps, beside, safe, look(name, knows))
        for axes in (successes[scenario], times[scenario]):
            if WITNESSED in steps.values():
                axes.axvline(len(steps) - 1.5, color="#888888", linewidth=0.8)
        successes[scenario].set_ylim(-3, 103)
        times[scenario].set_xticks(range(len(steps)), list(steps.values()), fontsize=8.5)
        times[scenario].set_xlabel("vehicles connected, %")
    successes[scenarios[0]].set_ylabel("success, %")
    times[scenarios[0]].set_ylabel("calm time, s")
    figure.legend(handles=_legend(names, knows), loc="outside right center")
    return Plot("Success and calm time against penetration, at equal safety", CAPTION, as_svg(figure))


_Points = Mapping[str | None, tuple[float, float, float]]  # condition -> value, low, high


def _success(rows: Sequence[Scorecard]) -> _Points:
    """rows: of one method in one scenario."""
    return {
        row.condition: (100 * row.success_rate, 100 * row.success_low, 100 * row.success_high)
        for row in rows
        if row.hazard == "all"
    }


def _calm_time(rows: Sequence[Scorecard]) -> _Points:
    return {
        row.condition: (row.mean_time_success, row.mean_time_success_low or 0.0, row.mean_time_success_high or 0.0)
        for row in rows
        if row.hazard == "no" and row.mean_time_success is not None  # then the interval is known too
    }


def _draw(
    axes: Axes, points: _Points, steps: Mapping[str | None, str], beside: float, safe: set[str | None], looks: Any
) -> None:
    """The points of one method, joined from step to step of the penetration."""
    places = {each: place + beside for place, each in enumerate(steps) if each in points}
    for one, other in pairwise(each for each in places if steps[each] != WITNESSED):
        ends = [places[one], places[other]], [points[one][0], points[other][0]]
        axes.plot(*ends, color=looks["color"], linestyle="-" if {one, other} <= safe else ":", linewidth=1.3)
    for each, place in places.items():
        face = {} if each in safe else {"markerfacecolor": "#ffffff"}
        here = {**looks, "markersize": 5.5, **face}
        axes.errorbar(place, points[each][0], yerr=arms(*points[each], scale=1.0), elinewidth=0.8, **here)


def _legend(names: Sequence[str], knows: Knows) -> list[Line2D]:
    """The methods, then what full and hollow say."""
    plain: dict[str, Any] = {"color": INK, "marker": "o"}
    return [
        *(Line2D([], [], label=name, **look(name, knows)) for name in names),
        Line2D([], [], linestyle="-", label=f"≤ {100 * SAFE_RATE:g} % collisions", **plain),
        Line2D([], [], linestyle=":", label="more collisions", markerfacecolor="#ffffff", **plain),
    ]
