"""How a vehicle is drawn: its true box, which end is the front, whether it is connected, and where it was hit."""

import numpy as np

from cad_env.rendering.canvas import BLACK, WHITE, Canvas, Colour
from cad_env.rendering.sight import corners
from cad_env.types import TRUCK, Floats
from cad_env.world.state import World

WINDSCREEN = (0.12, 0.26)  # of a car's length, ahead of its centre
CAB = 2.2  # m of a truck's length
WAVE = np.radians(np.arange(-50.0, 51.0, 10.0))
BRAKING = -1.0  # m/s2, below which the lights at the rear are on
BRAKE_LIGHT, BURST = (255, 40, 30), (255, 220, 60)


def draw_body(canvas: Canvas, world: World, row: int, colour: Colour, rim: Colour, connected: bool) -> None:
    """A vehicle's box with a windscreen towards its front, and radio waves if it is connected."""
    box = corners(world, row)
    canvas.reserve(box)
    canvas.polygon(box, colour)
    dark = int(0.45 * colour[0]), int(0.45 * colour[1]), int(0.45 * colour[2])
    if world.kind[row] == TRUCK:
        cab = 0.5 - CAB / world.size[row, 0]
        canvas.polygon(_band(box, cab - 0.02, cab + 0.02, 1.0), dark)
        canvas.polygon(_band(box, 0.5 - 0.6 / world.size[row, 0], 0.5, 0.8), dark)
    else:
        canvas.polygon(_band(box, *WINDSCREEN, 0.8), dark)
    canvas.polygon(box, rim, 1.0)
    if world.acceleration[row] < BRAKING:
        canvas.line(box[2:], BRAKE_LIGHT, 2.5)
    if connected:
        _draw_waves(canvas, world.position[row])


def _band(box: Floats, rear: float, front: float, width: float) -> Floats:
    """(4, 2) m: the part of a box (4, 2) between two shares of its length from the centre, and a share of its width."""
    centre, along, across = box.mean(axis=0), box[0] - box[3], box[0] - box[1]
    places = ((front, 0.5), (front, -0.5), (rear, -0.5), (rear, 0.5))
    return np.array([centre + part * along + width * side * across for part, side in places])


def _draw_waves(canvas: Canvas, place: Floats) -> None:
    """The sign of a radio: arcs to both sides."""
    for colour, pen in ((BLACK, 3.5), (WHITE, 1.5)):
        for radius in (5.0, 8.5):
            for side in (0.0, np.pi):
                canvas.arc(place, radius, side + WAVE, colour, pen)


def crossed(world: World, row: int, other: int) -> Floats:
    """(2,) m: the corner of either box that is deepest in the other, about where two vehicles touched."""
    places = np.concatenate([corners(world, row), corners(world, other)])
    reach = [np.hypot(*(places - world.position[k]).T) for k in (row, other)]
    deepest: Floats = places[int(np.argmin(np.maximum(*reach)))]
    return deepest


def draw_burst(canvas: Canvas, place: Floats) -> None:
    """A star where it crashed."""
    angle = np.arange(20) * np.pi / 10
    star = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * np.where(np.arange(20) % 2, 1.7, 4.0)[:, None]
    canvas.polygon(place + star, BURST)
    canvas.polygon(place + star, BLACK, 1.0)
