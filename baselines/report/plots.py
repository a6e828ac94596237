"""Scores -> plots: a row of panels, one a scenario. Colour says what a contender knows, shape who decides.

The colours are Okabe and Ito's, which people with any common colour blindness tell apart ("Color Universal Design",
2008); the shapes tell the contenders apart without them.
"""

import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.contenders import CONTENDERS, NOTHING, SEEN, SENT, TRUTH
from cad_env.score import Record, Scorecard, wilson

COLOURS = {NOTHING: "#666666", SEEN: "#D55E00", SENT: "#0072B2", TRUTH: "#009E73"}
SHAPES = {"always-go": ">", "always-brake": "X", "planner-own": "s", "planner-shared": "s", "expert": "D"}
BINS = 6  # of the hazard timing
PANEL = 3.4  # inches, the width of one
STYLE = {
    "font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True,
    "grid.color": "#e4e4e4", "axes.edgecolor": "#888888", "xtick.color": "#333333", "ytick.color": "#333333",
    "svg.hashsalt": "cad-env", "errorbar.capsize": 3.0, "lines.markersize": 6.0,
}  # fmt: skip


@dataclass(frozen=True)
class Plot:
    """A picture with what to say about it."""

    title: str
    caption: str
    svg: bytes


def plots(rows: Sequence[Scorecard], records: Sequence[Record]) -> list[Plot]:
    """All plots there is something to show in."""
    whole = [row for row in rows if row.hazard == "all"]
    timed = [record for record in records if record.hazard and record.hazard_timing is not None]
    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type]  # its stubs list the keys one by one
        drawn = [_collisions(whole), _successes(whole), _radio(whole)]
        return [*drawn, _timing(timed)] if timed else drawn


def _collisions(rows: Sequence[Scorecard]) -> Plot:
    svg = _rates(rows, lambda row: (row.collision_rate, row.collision_low, row.collision_high), "collisions")
    return Plot("Collisions", "Share of all episodes that end in a collision, with its 95 % Wilson interval.", svg)


def _successes(rows: Sequence[Scorecard]) -> Plot:
    svg = _rates(rows, lambda row: (row.success_rate, row.success_low, row.success_high), "successes")
    caption = (
        "Share of all episodes in which the ego arrives, with its 95 % Wilson interval. Who neither arrives nor "
        "collides has waited until time was up."
    )
    return Plot("Successes", caption, svg)


def _rates(rows: Sequence[Scorecard], rate_of: Callable[[Scorecard], tuple[float, float, float]], what: str) -> bytes:
    names = list(dict.fromkeys(row.contender for row in rows))
    figure, panels = _panels(rows, 0.9 + 0.27 * len(names))
    for scenario, axes in panels.items():
        for row in rows:
            if row.scenario == scenario:
                rate, low, high = rate_of(row)
                place = names.index(row.contender)
                spread = [[100 * (rate - low)], [100 * (high - rate)]]
                axes.errorbar(100 * rate, place, xerr=spread, clip_on=False, **_look(row.contender))
                axes.text(104, place, f"{100 * rate:.1f}", va="center", fontsize=8.5, color="#333333")
        axes.set(xlim=(0, 100), xlabel=f"{what}, % of episodes", ylim=(len(names) - 0.5, -0.5))
        axes.set_yticks(range(len(names)), names)
        axes.grid(axis="y", visible=False)
    return _svg(figure)


def _radio(rows: Sequence[Scorecard]) -> Plot:
    figure, panels = _panels(rows, 3.2)
    widest = max(row.bytes_per_second for row in rows) / 1000
    for scenario, axes in panels.items():
        for row in rows:
            if row.scenario == scenario:
                rate, low, high = (100 * value for value in (row.collision_rate, row.collision_low, row.collision_high))
                look = _look(row.contender) | {"label": row.contender}
                axes.errorbar(row.bytes_per_second / 1000, rate, yerr=[[rate - low], [high - rate]], **look)
        axes.set(xlabel="on the air, kB/s", xlim=(-0.05 * (widest or 1), 1.1 * (widest or 1)), ylim=(-2, 102))
    _finish(figure, list(panels.values()), "collisions, % of episodes")
    caption = (
        "Collisions against all bytes that the connected vehicles of a scene send in a second, together. The expert "
        "is told the truth without a radio."
    )
    return Plot("Safety against bytes on the air", caption, _svg(figure))


def _timing(records: Sequence[Record]) -> Plot:
    figure, panels = _panels(records, 3.2)
    for scenario, axes in panels.items():
        chosen = [record for record in records if record.scenario == scenario]
        times = [record.hazard_timing or 0.0 for record in chosen]
        edges = np.linspace(min(times), max(max(times), min(times) + 0.1), BINS + 1)
        names = list(dict.fromkeys(record.contender for record in chosen))
        for k, name in enumerate(names):
            own = [record for record in chosen if record.contender == name]
            beside = (k - 0.5 * (len(names) - 1)) * 0.07 * (edges[1] - edges[0])  # so that intervals stand side by side
            _timing_line(axes, own, edges, beside, name)
        axes.set(xlabel="hidden vehicle after an unbraked ego, s", ylim=(-2, 102))
    _finish(figure, list(panels.values()), "collisions, % of hazards")
    caption = (
        f"Collisions in episodes with a hazard, in {BINS} bins of its timing: how much later than the ego, if the ego "
        "never braked, the hidden vehicle would be where they meet. 95 % Wilson intervals."
    )
    return Plot("Collisions against hazard timing", caption, _svg(figure))


def _timing_line(axes: Axes, records: Sequence[Record], edges: np.ndarray[Any, Any], beside: float, name: str) -> None:
    bins = np.clip(np.digitize([record.hazard_timing or 0.0 for record in records], edges) - 1, 0, BINS - 1)
    crashed = np.array([record.outcome == "collision" for record in records])
    places, rates, below, above = [], [], [], []
    for k in np.unique(bins):
        count, of = int(crashed[bins == k].sum()), int((bins == k).sum())
        low, high = wilson(count, of)
        places.append(0.5 * (edges[k] + edges[k + 1]) + beside)
        rates.append(100 * count / of)
        below.append(100 * (count / of - low))
        above.append(100 * (high - count / of))
    look = _look(name) | {"linestyle": "-", "linewidth": 1.0, "elinewidth": 0.8, "capsize": 1.5, "markersize": 4.0}
    axes.errorbar(places, rates, yerr=[below, above], label=name, **look)


def _look(contender: str) -> dict[str, Any]:
    known = CONTENDERS.get(contender)
    colour = COLOURS[known.knows if known else NOTHING]
    return {"color": colour, "marker": SHAPES.get(contender, "o"), "linestyle": "none", "markeredgecolor": "white"}


def _panels(of: Iterable[Scorecard | Record], height: float) -> tuple[Figure, dict[str, Axes]]:
    """A figure with a titled panel for every scenario, in their order."""
    scenarios = list(dict.fromkeys(one.scenario for one in of))
    figure = Figure((1.4 + PANEL * len(scenarios), height), layout="constrained")
    row = figure.subplots(1, len(scenarios), sharey=True, squeeze=False)[0]
    for scenario, axes in zip(scenarios, row, strict=True):
        axes.set_title(scenario.replace("_", " "), fontsize=10.5, loc="left")
    return figure, dict(zip(scenarios, row, strict=True))


def _finish(figure: Figure, panels: Sequence[Axes], label: str) -> None:
    """The label of the shared axis, and one legend for all panels."""
    panels[0].set_ylabel(label)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", frameon=False)


def _svg(figure: Figure) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, format="svg", metadata={"Date": None})  # the same scores, the same file
    return data.getvalue()
