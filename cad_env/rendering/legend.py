"""What the colours and lines of a picture mean, in a corner of it."""

from collections.abc import Sequence

import numpy as np

from cad_env.rendering.bodies import WAVE
from cad_env.rendering.canvas import BLACK, PANEL, WHITE, Canvas, Colour
from cad_env.rendering.layers import LINK_COLOUR, LOST_COLOUR, SEEN_COLOURS, SHADE

ROW, _SIZE, WIDTH = 16.0, 11, 150.0  # pixels
_HIGHEST = 0.34  # of the picture's height; more marks stand in a further column

Entry = tuple[str, str, Colour]  # kind of mark, words, colour
ENTRIES: dict[str, tuple[Entry, ...]] = {
    "known": (
        ("box", "the ego sees it", SEEN_COLOURS[0]),
        ("box", "only others see it", SEEN_COLOURS[1]),
        ("box", "nobody sees it", SEEN_COLOURS[2]),
        ("waves", "connected", WHITE),
    ),
    "sight": (("box", "hidden from the ego", SHADE),),
    "tracks": (("track", "the ego knows of it", SEEN_COLOURS[1]),),
    "links": (("line", "message arrives", LINK_COLOUR), ("broken", "message is lost", LOST_COLOUR)),
}


def draw_legend(canvas: Canvas, layers: Sequence[str]) -> None:
    """A line for each mark of the layers that are drawn."""
    entries = [entry for name, some in ENTRIES.items() if name in layers for entry in some]
    if not entries:
        return
    rows = min(len(entries), int(canvas.size[1] * _HIGHEST / ROW))
    columns = -(-len(entries) // rows)
    width, height = columns * WIDTH, ROW * rows + 8
    left, top = 8.0, canvas.size[1] - height - 8
    canvas.box(left, top, width, height, PANEL, 0.8, round_by=5)
    for k, (kind, words, colour) in enumerate(entries):
        x, y = left + 8 + WIDTH * (k // rows), top + 4 + ROW * (k % rows + 0.5)
        _draw_mark(canvas, kind, x, y, colour)
        canvas.letters(x + 26, y, words, WHITE, _SIZE)


def _draw_mark(canvas: Canvas, kind: str, x: float, y: float, colour: Colour) -> None:
    """A mark 18 pixels wide around the height y."""
    if kind == "box":
        canvas.box(x, y - 4.5, 18, 9, colour)
        canvas.box(x, y - 4.5, 18, 9, WHITE, pen=0.75)
    elif kind == "line":
        canvas.box(x, y - 0.75, 18, 1.5, colour)
    elif kind == "broken":
        for shift in (0, 7, 14):
            canvas.box(x + shift, y - 1, 4, 2, colour)
    elif kind == "track":
        for shift in (0, 4, 8):
            canvas.box(x + shift, y - 2, 4, 4, colour, round_by=2)
        canvas.box(x + 11, y - 4, 8, 8, BLACK, round_by=4)
        canvas.box(x + 12, y - 3, 6, 6, colour, round_by=3)
    else:
        for radius in (5.0, 8.5):
            for side in (0.0, np.pi):
                canvas.arc(canvas.metres(x + 9, y), radius, side + WAVE, colour, 1.5)
