"""How plots look. Colour says what a method knows, shape who decides; a panel is a scenario.

The colours are Okabe and Ito's, which people with any common colour blindness tell apart ("Color Universal Design",
2008); without them the shapes still tell the methods apart.
"""

import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from baselines.methods import KNOWLEDGE, METHODS, NOTHING, SEEN, SENT, TRUTH

COLOURS = {NOTHING: "#555555", SEEN: "#D55E00", SENT: "#0072B2", TRUTH: "#009E73"}
SHAPES = {"always-go": ">", "always-brake": "X", "planner-own": "s", "planner-shared": "s", "expert": "D"}
WIDTHS = {1: 6.0, 2: 4.6}  # inches of a panel, by the number of panels beside each other
WIDTH = 3.6  # of one in more
STYLE = {
    "font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True,
    "grid.color": "#e4e4e4", "axes.edgecolor": "#888888", "xtick.color": "#333333", "ytick.color": "#333333",
    "svg.hashsalt": "cad-env", "errorbar.capsize": 3.0, "lines.markersize": 6.5, "legend.frameon": False,
}  # fmt: skip


@contextmanager
def styled() -> Iterator[None]:
    """Inside, figures look as they do in a report."""
    with matplotlib.rc_context(STYLE):  # type: ignore[arg-type]  # its stubs list the keys one by one
        yield


def panels(scenarios: Sequence[str], rows: int, height: float, **options: Any) -> tuple[Figure, list[dict[str, Axes]]]:
    """A figure of some height (inches) with so many rows of panels, each by scenario; titles over the first."""
    width = 1.6 + WIDTHS.get(len(scenarios), WIDTH) * len(scenarios)
    figure = Figure((width, height), layout=ConstrainedLayoutEngine(wspace=0.06))
    grid = figure.subplots(rows, len(scenarios), sharey=True, squeeze=False, **options)
    for scenario, axes in zip(scenarios, grid[0], strict=True):
        axes.set_title(scenario.replace("_", " "), fontsize=10.5, loc="left", fontweight="bold")
    return figure, [dict(zip(scenarios, row, strict=True)) for row in grid]


def look(method: str) -> dict[str, Any]:
    """Colour and shape of a method's points."""
    return {"color": colour(method), "marker": SHAPES.get(method, "o"), "linestyle": "none"}


def colour(method: str) -> str:
    """By what it knows."""
    known = METHODS.get(method)
    return COLOURS[known.knows if known else NOTHING]


def knowledge_legend(figure: Figure, methods: Iterable[str]) -> None:
    """What the colours of these methods say, below the panels."""
    used = {colour(name) for name in methods}
    keys = [Line2D([], [], color=COLOURS[knows], linewidth=3.0, label=knows) for knows in KNOWLEDGE]
    keys = [key for key in keys if key.get_color() in used]
    figure.legend(handles=keys, loc="outside lower left", ncols=len(keys), title="knows", alignment="left")


def method_legend(figure: Figure, methods: Iterable[str]) -> None:
    """Which point is whose, beside the panels."""
    keys = [Line2D([], [], label=name, **look(name)) for name in methods]
    figure.legend(handles=keys, loc="outside right center")


def as_svg(figure: Figure) -> bytes:
    """The same for the same figure, whenever it is made."""
    data = io.BytesIO()
    figure.savefig(data, format="svg", metadata={"Date": None})
    return data.getvalue()
