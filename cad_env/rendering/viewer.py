"""highway-env's viewer with layers over it: what `render()` of every environment shows."""

import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
from highway_env.envs.common.graphics import EnvViewer
from highway_env.road.graphics import LaneGraphics, RoadGraphics
from highway_env.road.lane import AbstractLane

from cad_env.rendering.canvas import Canvas, Colour
from cad_env.rendering.framing import focus
from cad_env.rendering.layers import LAYERS, Layer
from cad_env.rendering.legend import draw_legend
from cad_env.types import Floats, Image

GRASS, TARMAC = (128, 140, 112), (98, 98, 102)


class SceneViewer(EnvViewer):
    """Draws the `simulation`, `road` and `vehicle` of an environment by the display settings of its `config`.

    `layers` in the config names what is drawn over highway-env's own picture, which is turned north up.
    """

    def __init__(self, env: Any, window_lost: bool = False) -> None:
        self.window_lost = window_lost  # closed by the user, or gone with another one's: it does not come back
        self.screen_settings = _screen_settings(env.config)
        _open_display()
        super().__init__(env, {**env.config, "offscreen_rendering": True} if window_lost else None)
        # The stock viewer's keys would shift the setting itself.
        self.sim_surface.centering_position = list(self.sim_surface.centering_position)
        self.canvas = Canvas(*self.sim_surface.get_size())
        self._ground: tuple[Any, pygame.Surface] | None = None

    def display(self, extra: Sequence[Layer] = ()) -> None:
        """Draw one frame; `extra` layers come last."""
        if self.window_lost:
            return
        canvas, simulation = self.canvas, self.env.simulation
        scaling = self.sim_surface.scaling  # the stock viewer's keys zoom and shift its surface
        canvas.look_at(focus(simulation, canvas.size / scaling), self.sim_surface.centering_position, scaling)
        self._draw_ground()
        RoadGraphics.display_traffic(self.env.road, canvas.surface, offscreen=True)
        canvas.turn_north_up()
        for name, draw in LAYERS.items():
            if name in self.env.config["layers"]:
                draw(simulation, canvas)
        for draw in extra:
            draw(simulation, canvas)
        draw_legend(canvas, self.env.config["layers"])
        self.sim_surface.blit(canvas.shown(), (0, 0))
        if not self.offscreen:
            self._show()

    def _show(self) -> None:
        """Bring the picture to the window."""
        try:
            self.screen.blit(self.sim_surface, (0, 0))
            if self.env.config["real_time_rendering"]:
                self.clock.tick(self.env.config["policy_frequency"])
            pygame.display.flip()
        except pygame.error:  # whoever closes a highway-env closes the windows of all
            self._lose_window()

    def handle_events(self) -> None:
        """Keys zoom and shift the picture. The episode goes on if the window is closed; it does not come back."""
        for event in [] if self.offscreen else pygame.event.get():
            if event.type == pygame.QUIT:
                self._lose_window()
                pygame.display.quit()
                return
            self.sim_surface.handle_event(event)

    def _lose_window(self) -> None:
        gym.logger.warn("the window was closed: the episode goes on without it")
        self.window_lost = self.offscreen = True

    def _draw_ground(self) -> None:
        """The roads, drawn anew only when the picture looks elsewhere."""
        surface, network = self.canvas.surface, self.env.road.network
        place = (id(network), *surface.origin, surface.scaling)
        if self._ground is None or self._ground[0] != place:
            surface.fill(GRASS)
            for lane in network.lanes_list():
                _pave(self.canvas, lane, TARMAC)
            for lane in network.lanes_list():
                LaneGraphics.display(lane, surface)
            self._ground = place, surface.copy()
        surface.blit(self._ground[1], (0, 0))


def viewer_of(env: Any) -> SceneViewer:
    """The `viewer` of an environment, or another one if it has none yet or its screen has changed."""
    viewer: SceneViewer | None = env.viewer
    if viewer is None or viewer.screen_settings != _screen_settings(env.config):
        viewer = SceneViewer(env, viewer is not None and viewer.window_lost)
    return viewer


def _open_display() -> None:
    """Start pygame's display. Where there is none, SDL is not left to look for one: it complains on standard error."""
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    if named or sys.platform in ("win32", "darwin"):
        pygame.display.init()
        return
    os.environ["SDL_VIDEODRIVER"] = "dummy"
    try:
        pygame.display.init()
    finally:
        del os.environ["SDL_VIDEODRIVER"]  # a display may be started later


def picture(env: Any, extra: Sequence[Layer] = ()) -> Image:
    """What `env.render()` shows in mode rgb_array, (H, W, 3) uint8, with `extra` layers; in any mode but human."""
    env.viewer = viewer_of(env)
    env.viewer.display(extra)
    image: Image = env.viewer.get_image()
    return image


def _screen_settings(config: Mapping[str, Any]) -> tuple[Any, ...]:
    """What the window and its surfaces are made for."""
    names = ("screen_width", "screen_height", "scaling", "offscreen_rendering")
    return *(config[name] for name in names), *config["centering_position"]


def _pave(canvas: Canvas, lane: AbstractLane, colour: Colour) -> None:
    arcs = np.linspace(0.0, lane.length, max(int(lane.length / 2.0), 2))
    sides = [np.array([lane.position(s, side * 0.5 * lane.width_at(s)) for s in arcs]) for side in (-1, 1)]
    outline: Floats = np.concatenate([sides[0], sides[1][::-1]])
    pygame.draw.polygon(canvas.surface, colour, [canvas.surface.vec2pix(point) for point in outline])
