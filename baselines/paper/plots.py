"""Safety against bytes, and robustness: PNG files. Only this module needs matplotlib, and only once it draws."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from baselines.paper.closed_metrics import ClosedRow
from baselines.paper.folder import TABLE_ORDER
from baselines.paper.sweeps import SWEEPS
from baselines.paper.tables import spoken
from baselines.plot_style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, SKY, VERMILION, styled
from cad_env.scoring.interval import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SweepRows = Mapping[str, Mapping[str, ClosedRow]]  # value -> method
_COLOURS = {
    "rules": INK, "constant": GREY, "own": VERMILION, "graph": BLUE, "points": GREEN, "features": PURPLE,
    "truth": ORANGE,
}  # fmt: skip
LOOKS = {  # row -> (what it shares, its shape)
    "always-go": ("constant", ">"), "always-brake": ("constant", "X"), "best-blind": ("constant", "v"),
    "command-only": ("constant", "o"),
    "planner-own": ("own", "s"), "cautious-own": ("own", "D"), "planner-shared": ("rules", "s"),
    "planner-coverage": ("rules", "D"),
    "expert": ("truth", "*"), "ppo": ("graph", "P"), "gat": ("own", "v"), "collab-gat": ("graph", "v"),
    "stgraph-own": ("own", "o"), "raw-points": ("points", "^"), "compressed": ("features", "^"),
    "stgraph-no-edges": ("graph", "d"), "stgraph-bc": ("graph", "h"), "stgraph": ("graph", "o"),
    "stgraph-velocity": ("graph", "<"), "stgraph-motion": ("graph", "p"), "stgraph-motion-own": ("own", "p"),
    "stgraph-coverage": ("graph", "8"),
}  # fmt: skip
COMPARED_COLOURS = {"stgraph": BLUE, "collab-gat": VERMILION, "compressed": GREEN}


def _figure(width: float, height: float, columns: int, **options: Any) -> "tuple[Figure, list[Axes]]":
    from matplotlib.figure import Figure

    figure = Figure((width, height), layout="constrained")
    return figure, list(figure.subplots(1, columns, squeeze=False, **options)[0])


def safety_plot(path: Path, rows: Mapping[str, Sequence[ClosedRow]], sweeps: Mapping[str, SweepRows]) -> None:
    """One scene: success and collisions against bytes on the air, radio -> rows, and the sweeps of the graph's size.

    Filled: the first radio; hollow: the others. Methods that send nothing are on the left, for the first radio only.
    """
    first, *others = rows
    sending = {radio: [row for row in rows[radio] if row.bytes_per_second] for radio in others}
    with styled():
        figure, axes = _figure(11.5, 5.4, 2)
        zone = _zone([*rows[first], *(row for some in sending.values() for row in some)], sweeps)
        for axis, what in zip(axes, ("success", "collision"), strict=True):
            for name, line in (("depth", "-"), ("budget", ":")):
                if name in sweeps:
                    _size_line(axis, sweeps[name], what, name, line, zone)
            _points(axis, rows[first], what, zone, "")
            for radio, some in sending.items():
                _points(axis, some, what, zone, radio)
            _bytes_axis(axis, zone, what)
        _legend(figure, axes[0], [radio for radio in others if sending[radio]])
        figure.suptitle(spoken(rows[first][0].scenario), x=0.01, ha="left", fontweight="bold")
        figure.savefig(path, dpi=130)


def _zone(rows: Sequence[ClosedRow], sweeps: Mapping[str, SweepRows]) -> float:
    """B/s: methods that send nothing are left of it."""
    swept = [row for rows in sweeps.values() for some in rows.values() for row in some.values()]
    return 0.4 * min([row.bytes_per_second for row in (*rows, *swept) if row.bytes_per_second] or [1000.0])


def _points(axis: "Axes", rows: Sequence[ClosedRow], what: str, zone: float, radio: str) -> None:
    """Hollow if the radio is named."""
    silent = [row.method for row in rows if not row.bytes_per_second]
    for row in rows:
        estimate = getattr(row, what)
        place = row.bytes_per_second or zone * 10 ** (-0.95 + 0.9 * (silent.index(row.method) + 0.5) / len(silent))
        kind, shape = LOOKS.get(row.method, ("constant", "."))
        axis.errorbar(
            place, 100 * estimate.value, yerr=_arms(estimate), marker=shape, linestyle="none", color=_COLOURS[kind],
            markerfacecolor="white" if radio else _COLOURS[kind], label=None if radio else row.method,
            elinewidth=1.0, clip_on=False, zorder=3, markersize=9 if row.method == "stgraph" else 7,
        )  # fmt: skip


def _size_line(axis: "Axes", values: SweepRows, what: str, name: str, line: str, zone: float) -> None:
    """A sweep of the graph's size: bytes per second against how it drives."""
    rows = [(value, some["stgraph"]) for value, some in values.items() if "stgraph" in some]
    if not rows:
        return
    places = [row.bytes_per_second or zone for _, row in rows]
    heights = [100 * getattr(row, what).value for _, row in rows]
    label, unit, above = {"depth": ("1 to 15 frames", "", 6), "budget": ("budget swept", " B", -12)}[name]
    axis.plot(
        places, heights, line, color=SKY, linewidth=1.8, marker=".", markersize=6, label=f"stgraph, {label}",
        zorder=2,
    )  # fmt: skip
    for at in (0, -1) if name == "depth" else (0,):  # its ends: between them they would hide each other
        axis.annotate(
            rows[at][0] + unit, (places[at], heights[at]), (0, above), textcoords="offset points", ha="center",
            fontsize=8, color="#2b7bb0",
        )  # fmt: skip


def _bytes_axis(axis: "Axes", zone: float, what: str) -> None:
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axis.set_xscale("log")
    low, high = zone / 10, 2.0 * axis.get_xlim()[1]
    axis.axvspan(low, zone, color="#f2f2f2", linewidth=0.0, zorder=0)
    axis.text(zone / 10**0.5, 104, "nothing on air", ha="center", fontsize=8.5, color="#555555")
    axis.set(
        xlim=(low, high), ylim=(-4, 109), yticks=range(0, 101, 20),
        xlabel="on the air, all connected vehicles together, bytes/s",
        ylabel={"success": "success, % of episodes", "collision": "collisions, % of episodes"}[what],
    )  # fmt: skip
    axis.xaxis.set_major_formatter(FuncFormatter(lambda rate, _: _rate_label(rate) if rate > zone else ""))
    axis.xaxis.set_minor_formatter(NullFormatter())


def _rate_label(rate: float) -> str:
    """
    >>> _rate_label(1000), _rate_label(2e6), _rate_label(100)
    ('1 k', '2 M', '100')
    """
    for scale, unit in ((1e6, " M"), (1e3, " k")):
        if rate >= scale:
            return f"{rate / scale:g}{unit}"
    return f"{rate:g}"


def _legend(figure: "Figure", axis: "Axes", hollow: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    handles, labels = axis.get_legend_handles_labels()
    places = {name: place for place, name in enumerate(TABLE_ORDER)}
    order = sorted(range(len(labels)), key=lambda k: places.get(labels[k], 99))
    keys = [handles[k] for k in order]
    named = [labels[k] for k in order]
    for radio in hollow:
        keys.append(Line2D([], [], linestyle="none", marker="o", color=GREY, markerfacecolor="white"))
        named.append(f"hollow: radio {radio}")
    figure.legend(keys, named, loc="outside right center", labelspacing=0.45)


def robustness_plot(path: Path, name: str, scenes: Mapping[str, SweepRows]) -> None:
    """A sweep, scene by scene: success of each method with its Wilson band, and collisions dashed."""
    with styled():
        figure, axes = _figure(1.4 + 3.4 * len(scenes), 3.6, len(scenes), sharey=True)
        for axis, (scene, values) in zip(axes, scenes.items(), strict=True):
            places = _places(list(values))
            methods = dict.fromkeys(method for rows in values.values() for method in rows)
            for method in methods:
                _curve(
                    axis,
                    method,
                    {places[value]: rows[method] for value, rows in values.items() if method in rows},
                )
            axis.set_title(spoken(scene), loc="left", fontweight="bold", fontsize=10.5)
            axis.set(ylim=(-2, 102))
            axis.set_xlabel(SWEEPS[name].label, fontsize=9)
            _ticks(axis, places)
        axes[0].set_ylabel("% of episodes")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
        figure.savefig(path, dpi=130)


def _curve(axis: "Axes", method: str, rows: Mapping[float, ClosedRow]) -> None:
    colour, shape = COMPARED_COLOURS.get(method, GREY), LOOKS.get(method, ("", "."))[1]
    places = list(rows)
    success = [row.success for row in rows.values()]
    axis.fill_between(
        places, [100 * each.low for each in success], [100 * each.high for each in success], color=colour, alpha=0.18,
        linewidth=0.0,
    )  # fmt: skip
    axis.plot(
        places, [100 * each.value for each in success], color=colour, marker=shape, markersize=6, clip_on=False,
        label=f"{method}: success",
    )  # fmt: skip
    collisions = [100 * row.collision.value for row in rows.values()]
    axis.plot(places, collisions, "--", color=colour, linewidth=1.2, clip_on=False, label=f"{method}: collisions")


def _places(values: Sequence[str]) -> dict[str, float]:
    """The place of each value on the axis: the number itself, or evenly spaced if they are far apart or no numbers."""
    try:
        numbers = [float(value) for value in values]
    except ValueError:
        return {value: float(place) for place, value in enumerate(values)}
    if len(numbers) > 1 and max(numbers) > 50:
        return {value: float(place) for place, value in enumerate(values)}
    return dict(zip(values, numbers, strict=True))


def _ticks(axis: "Axes", places: Mapping[str, float]) -> None:
    axis.set_xticks(list(places.values()), [_short(value) for value in places], fontsize=8.5)


def _short(value: str) -> str:
    return f"{float(value):g}" if value.replace(".", "", 1).isdecimal() else value


def _arms(estimate: Estimate) -> list[list[float]]:
    return [[100 * (estimate.value - estimate.low)], [100 * (estimate.high - estimate.value)]]
