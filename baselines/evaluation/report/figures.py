"""How the plots of a report look. Colour says what a method knows, shape who decides; a panel is a scenario."""

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from baselines.controls.names import BEST_BLIND, CONTROL_KINDS, is_control, parsed_control
from baselines.methods import KNOWLEDGE, KNOWS_NOTHING, KNOWS_SEEN, KNOWS_SENT, KNOWS_TRUTH, METHODS
from baselines.plot_style import BLUE, GREEN, GREY, VERMILION
from cad_env.scoring.scorecard import Record, Scorecard

Knows = Mapping[str, str]  # method -> what it knows

KNOWLEDGE_COLOURS = {KNOWS_NOTHING: GREY, KNOWS_SEEN: VERMILION, KNOWS_SENT: BLUE, KNOWS_TRUTH: GREEN}
SHAPES = {
    "always-go": ">", "always-brake": "X", BEST_BLIND: "P", "planner-own": "s", "planner-shared": "s", "expert": "D",
}  # fmt: skip
_SHAPE_OF_KIND = {"blind": "<", "stop": "v", "slow": "^"}
_FORM_OF_KIND = {kind.name: kind.form for kind in CONTROL_KINDS}
_WIDTHS = {1: 6.0, 2: 4.6}  # inches of a panel, by the number of panels beside each other
_WIDTH = 3.6  # of one in more


@dataclass(frozen=True)
class Plot:
    """A picture with its title and caption."""

    title: str
    caption: str
    svg: bytes


def names_in(of: Sequence[Scorecard] | Sequence[Record]) -> list[str]:
    """The methods, in order."""
    return list(dict.fromkeys(one.method for one in of))


def scenarios_in(of: Sequence[Scorecard] | Sequence[Record]) -> list[str]:
    """The scenarios, in order."""
    return list(dict.fromkeys(one.scenario for one in of))


def arms(value: float, low: float, high: float, scale: float = 100.0) -> list[list[float]]:
    """The lengths of error bars for an interval, of a rate in per cent."""
    return [[scale * (value - low)], [scale * (high - value)]]


def panels(scenarios: Sequence[str], rows: int, height: float, **options: Any) -> tuple[Figure, list[dict[str, Axes]]]:
    """A figure of some height (inches) with so many rows of panels, each by scenario; titles over the first.

    options: of `Figure.subplots`; unless they say otherwise, all panels share the vertical axis.
    """
    width = 1.6 + _WIDTHS.get(len(scenarios), _WIDTH) * len(scenarios)
    figure = Figure((width, height), layout=ConstrainedLayoutEngine(wspace=0.06))
    grid = figure.subplots(rows, len(scenarios), squeeze=False, **{"sharey": True, **options})
    for scenario, axes in zip(scenarios, grid[0], strict=True):
        axes.set_title(scenario.replace("_", " "), fontsize=10.5, loc="left", fontweight="bold")
    return figure, [dict(zip(scenarios, row, strict=True)) for row in grid]


def knowledge_of(settings: Mapping[str, Any]) -> dict[str, str]:
    """What each method of a run knows; for methods from outside it is in settings.json."""
    return {
        name: METHODS[name].knows if name in METHODS else settings.get(f"knowledge of {name}", KNOWS_NOTHING)
        for name in settings.get("method", METHODS)
    }


def look(method: str, knows: Mapping[str, str]) -> dict[str, Any]:
    """Colour and shape of a method's points; those of controls are small."""
    if is_control(method):
        shape = {"marker": _SHAPE_OF_KIND[parsed_control(method)[0]], "markersize": 4.0}
    else:
        shape = {"marker": SHAPES.get(method, "o")}
    return {"color": colour(method, knows), "linestyle": "none", **shape}


def colour(method: str, knows: Mapping[str, str]) -> str:
    """By what it knows."""
    return KNOWLEDGE_COLOURS[knows.get(method, KNOWS_NOTHING)]


def knowledge_legend(figure: Figure, methods: Iterable[str], knows: Mapping[str, str]) -> None:
    """The legend of the colours of these methods, below the panels."""
    used = {knows.get(name, KNOWS_NOTHING) for name in methods}
    keys = [Line2D([], [], color=KNOWLEDGE_COLOURS[k], linewidth=3.0, label=k) for k in KNOWLEDGE if k in used]
    figure.legend(handles=keys, loc="outside lower left", ncols=len(keys), title="knows", alignment="left")


def method_legend(figure: Figure, methods: Iterable[str], knows: Mapping[str, str]) -> None:
    """The legend of the methods, beside the panels; one line for all controls of a kind."""
    keys = {label_of(name): look(name, knows) for name in methods}
    handles = [Line2D([], [], label=label, **looks) for label, looks in keys.items()]
    figure.legend(handles=handles, loc="outside right center")


def label_of(method: str) -> str:
    """The method in a legend: of a control its kind.

    >>> label_of("stop-2"), label_of("expert")
    ('stop-D', 'expert')
    """
    return _FORM_OF_KIND[parsed_control(method)[0]] if is_control(method) else method


def as_svg(figure: Figure) -> bytes:
    """The same for the same figure, whenever it is made."""
    data = io.BytesIO()
    figure.savefig(data, format="svg", metadata={"Date": None})
    return data.getvalue()
