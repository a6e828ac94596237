"""The look that all plots share.

The colours are Okabe and Ito's, which people with any common colour blindness tell apart ("Color Universal Design",
2008). Plots give each method a shape too, so that they can be read without colours.
"""

from contextlib import AbstractContextManager

INK, GREY, ORANGE, SKY, GREEN = "#000000", "#777777", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
PLOT_STYLE = {
    "font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True,
    "grid.color": "#e4e4e4", "axes.edgecolor": "#888888", "legend.frameon": False, "legend.fontsize": 9,
    "errorbar.capsize": 2.5, "lines.markersize": 7, "svg.hashsalt": "cad-env",
}  # fmt: skip


def styled() -> "AbstractContextManager[None]":
    """Inside, figures have this look."""
    import matplotlib  # here, so that only what draws waits for it

    return matplotlib.rc_context(PLOT_STYLE)  # type: ignore[arg-type]  # its stubs list the keys one by one
