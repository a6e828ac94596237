"""A surface to draw on in metres of the world, north up; sizes of pens and letters are pixels of the final picture."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pygame
from highway_env.road.graphics import WorldSurface

from cad_env.types import Floats

Colour = tuple[int, int, int]
FINE = 2  # everything is drawn so many times larger than it is shown, which smooths its edges
ASIDE = (14.0, 22.0, 34.0)  # pixels from a place to a label beside it, as there is room
WHITE, BLACK, PANEL = (255, 255, 255), (0, 0, 0), (24, 28, 34)
PANEL_OPACITY = 0.92


class Tag(NamedTuple):
    """Words on a panel."""

    text: str
    ground: Colour = PANEL
    ink: Colour = WHITE
    size: int = 13  # pixels


class Canvas:
    """A fine surface and the place in the world that it shows."""

    def __init__(self, width: int, height: int) -> None:
        size = (FINE * width, FINE * height)
        self.surface = WorldSurface(size, 0, pygame.Surface(size))
        self.size = np.array([width, height])
        self._taken: list[pygame.Rect] = []
        self._veil = pygame.Surface(size, pygame.SRCALPHA)

    def look_at(self, focus: Floats, at: tuple[float, float], scaling: float) -> None:
        """Show `focus` (2,) m at the share `at` of the picture, from its top left, with `scaling` pixels a metre."""
        self._taken.clear()
        self.surface.scaling = FINE * scaling
        self.surface.origin = focus - np.array([at[0], 1.0 - at[1]]) * self.size / scaling

    def turn_north_up(self) -> None:
        """Turn what highway-env drew: its y axis points down."""
        self.surface.blit(pygame.transform.flip(self.surface, False, True), (0, 0))

    def shown(self) -> pygame.Surface:
        """The picture in its final size."""
        return pygame.transform.smoothscale(self.surface, self.size.tolist())

    def pixels(self, points: Floats) -> Floats:
        """Places (..., 2) m -> (..., 2) fine pixels."""
        scaling = self.surface.scaling
        placed = (np.asarray(points) - self.surface.origin) * scaling
        placed[..., 1] = FINE * self.size[1] - placed[..., 1]
        pixels: Floats = placed
        return pixels

    def metres(self, x: float, y: float) -> Floats:
        """The place (2,) m that a pixel of the final picture shows."""
        up = FINE * np.array([x, self.size[1] - y])
        place: Floats = up / self.surface.scaling + self.surface.origin
        return place

    def polygon(self, points: Floats, colour: Colour, pen: float = 0.0) -> None:
        """A filled polygon (n, 2) m, or its outline."""
        pygame.draw.polygon(self.surface, colour, self.pixels(points).tolist(), round(FINE * pen))

    def line(self, points: Floats, colour: Colour, pen: float) -> None:
        """A line through (n, 2) m, n at least 2."""
        pygame.draw.lines(self.surface, colour, False, self.pixels(points).tolist(), round(FINE * pen))

    def dashes(self, start: Floats, end: Floats, colour: Colour, pen: float, dash: float = 6.0) -> None:
        """A dashed line between two places (2,) m, each dash and each gap `dash` pixels long."""
        a, b = self.pixels(start), self.pixels(end)
        count = max(int(np.hypot(*(b - a)) / (FINE * dash)), 1)
        for k in range(0, count, 2):
            ends = (a + (b - a) * k / count).tolist(), (a + (b - a) * (k + 1) / count).tolist()
            pygame.draw.line(self.surface, colour, *ends, round(FINE * pen))

    def dot(self, place: Floats, colour: Colour, radius: float, pen: float = 0.0) -> None:
        """A disc around a place (2,) m, or a ring."""
        pygame.draw.circle(self.surface, colour, self.pixels(place).tolist(), FINE * radius, round(FINE * pen))

    def arc(self, place: Floats, radius: float, angle: Floats, colour: Colour, pen: float) -> None:
        """A part of a circle around a place (2,) m, given by its angles (n,) rad."""
        points = self.pixels(place) + FINE * radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        pygame.draw.lines(self.surface, colour, False, points.tolist(), round(FINE * pen))

    def veil(self, colour: Colour, opacity: float, holes: list[Floats]) -> None:
        """Cover the picture but for polygons (n, 2) m; opacity from 0 to 1."""
        self._veil.fill((*colour, round(255 * opacity)))
        for hole in holes:
            pygame.draw.polygon(self._veil, (0, 0, 0, 0), self.pixels(hole).tolist())
        self.surface.blit(self._veil, (0, 0))

    def reserve(self, points: Floats) -> None:
        """Keep labels to come off a polygon (n, 2) m, as far as that can be."""
        self._taken.append(_around(self.pixels(points)))

    def label(self, places: Sequence[Floats], tag: Tag) -> None:
        """A tag in the middle of the first of some places (2,) m where it covers nothing reserved."""
        half = self._extent(tag) / 2
        choices = [_around(self.pixels(place) + half * [[-1], [1]]) for place in places]
        whole = self.surface.get_rect()
        free = [choice for choice in choices if whole.contains(choice) and choice.collidelist(self._taken) < 0]
        self._put((free or choices)[0], tag)

    def label_beside(self, place: Floats, tag: Tag) -> None:
        """A tag to the left, to the right, above or below a place (2,) m: where there is room first."""
        around = np.array([[-1, 0], [1, 0], [0, 1], [0, -1], [-1, 1], [1, 1], [-1, -1], [1, -1]]) / self.surface.scaling
        halves = (self._extent(tag) / 2 + FINE * away * np.array([1.0, 0.6]) for away in ASIDE)
        self.label([place + shift for half in halves for shift in half * around], tag)

    def note(self, x: float, y: float, tag: Tag, share: float = 0.0) -> float:
        """A tag of which a share is left of pixel (x, y), in the middle of its height; answers where it ends."""
        extent = self._extent(tag)
        corner = FINE * np.array([x, y]) - extent * [share, 0.5]
        self._put(_around(np.stack([corner, corner + extent])), tag)
        return x + (1.0 - share) * float(extent[0]) / FINE

    def letters(self, x: float, y: float, text: str, colour: Colour, size: int = 12) -> None:
        """Letters without a panel whose left middle is at pixel (x, y)."""
        drawn = self._letters(text, colour, size)
        self.surface.blit(drawn, (FINE * x, FINE * y - drawn.get_height() / 2))

    def box(self, x: float, y: float, width: float, height: float, colour: Colour, opacity: float = 1.0,
            pen: float = 0.0, round_by: float = 0.0) -> None:  # fmt: skip
        """A rectangle given by its top left corner, or its outline; all in pixels."""
        place = pygame.Rect(*(round(FINE * part) for part in (x, y, width, height)))
        self._rectangle(place, (*colour, round(255 * opacity)), round(FINE * pen), round(FINE * round_by))

    def _put(self, place: pygame.Rect, tag: Tag) -> None:
        self._taken.append(place)
        shade = (*tag.ground, round(255 * PANEL_OPACITY))
        self._rectangle(place, shade, 0, round(0.35 * FINE * tag.size))
        letters = self._letters(tag.text, tag.ink, tag.size)
        self.surface.blit(letters, letters.get_rect(center=place.center))

    def _extent(self, tag: Tag) -> Floats:
        """(2,) fine pixels."""
        letters = self._letters(tag.text, tag.ink, tag.size)
        extent: Floats = np.array(letters.get_size()) + FINE * tag.size * np.array([0.9, 0.2])
        return extent

    def _rectangle(self, place: pygame.Rect, shade: tuple[int, int, int, int], pen: int, round_by: int) -> None:
        sheet = pygame.Surface(place.size, pygame.SRCALPHA)
        pygame.draw.rect(sheet, shade, sheet.get_rect(), pen, border_radius=round_by)
        self.surface.blit(sheet, place)

    def _letters(self, text: str, colour: Colour, size: int) -> pygame.Surface:
        pygame.font.init()  # made anew each time: any highway-env that is closed ends the fonts of all
        font = pygame.font.Font(None, round(1.35 * FINE * size))  # its sizes count lines, not capitals
        return font.render(text, True, colour)


def _around(pixels: Floats) -> pygame.Rect:
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return pygame.Rect(*np.round(low).astype(int).tolist(), *np.round(high - low).astype(int).tolist())
