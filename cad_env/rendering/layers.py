"""What may be drawn over the roads, a function each: LAYERS has them by name, in the order in which they are drawn."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from cad_env.checks import ConfigError, did_you_mean
from cad_env.pipeline.merge import MERGE_GATE
from cad_env.pipeline.radio import LOST, REACHES
from cad_env.rendering.bodies import crossed, draw_body, draw_burst
from cad_env.rendering.canvas import BLACK, PANEL, WHITE, Canvas, Colour, Tag
from cad_env.rendering.sight import corners, in_sight
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, COLLISION, SUCCESS, TIMEOUT, Bools, Graph, Ints
from cad_env.world.state import OFF

# Who sees a vehicle. Okabe and Ito's colours (2008), told apart by all kinds of colour vision.
EGO_SEES, OTHERS_SEE, NOBODY_SEES = 0, 1, 2
SEEN_COLOURS: tuple[Colour, ...] = ((86, 180, 233), (240, 160, 0), (52, 52, 56))
EGO_COLOUR, LOST_COLOUR, STOP_COLOUR = (0, 200, 140), (225, 75, 30), (225, 75, 30)
LINK_COLOUR = (250, 150, 225)
BYTES_AT = np.arange(0.25, 0.9, 0.1)  # of the way from sender to ego, where the bytes may be written
WAY_DOTS = 2.5  # m between the dots of the ego's way
SHADE, OPACITY = (10, 14, 30), 0.5

Layer = Callable[[Simulation, Canvas], None]


def who_sees(simulation: Simulation) -> Ints:
    """(N,) EGO_SEES, OTHERS_SEE or NOBODY_SEES. A connected vehicle counts as seen by others: it knows of itself."""
    visible = simulation.fleet.visible
    others: Bools = np.any(visible[1:], axis=0)
    others[simulation.agents] = True
    seen: Ints = np.where(visible[0], EGO_SEES, np.where(others, OTHERS_SEE, NOBODY_SEES))
    seen[simulation.agents[0]] = EGO_SEES
    return seen


def sight(simulation: Simulation, canvas: Canvas) -> None:
    """Shade the ground that the ego cannot see."""
    world, ego = simulation.world, int(simulation.agents[0])
    seen = in_sight(world, ego, simulation.setup.sensor.range)
    bodies = [corners(world, row) for row in range(len(world.speed)) if world.driver[row] != OFF]
    canvas.veil(SHADE, OPACITY, [seen, *bodies])


def known(simulation: Simulation, canvas: Canvas) -> None:
    """Every vehicle in the colour of who sees it, the ego in its own; connected ones carry the sign of a radio."""
    world, seen = simulation.world, who_sees(simulation)
    for row in range(len(world.speed)):
        if world.driver[row] == OFF:
            continue
        ego = row == simulation.agents[0]
        colour = EGO_COLOUR if ego else SEEN_COLOURS[seen[row]]
        rim = WHITE if ego or seen[row] == NOBODY_SEES else BLACK
        draw_body(canvas, world, row, colour, rim, row in simulation.agents)
    canvas.label_beside(world.position[simulation.agents[0]], Tag("EGO"))


def links(simulation: Simulation, canvas: Canvas) -> None:
    """A line from each sender to the ego with the bytes of the message that arrives now, broken if it is lost."""
    position = simulation.world.position
    ego = position[simulation.agents[0]]
    for agent in range(1, len(simulation.agents)):
        fate, size = simulation.arrival(agent, 0)
        sender = position[simulation.agents[agent]]
        if fate == REACHES:
            canvas.line(np.stack([sender, ego]), LINK_COLOUR, 2.0)
        elif fate == LOST:
            canvas.dashes(sender, ego, LOST_COLOUR, 2.0)
        if fate in (REACHES, LOST):
            tag = Tag(f"{size} B", size=11) if fate == REACHES else Tag("lost", LOST_COLOUR, size=11)
            canvas.label([sender + share * (ego - sender) for share in BYTES_AT], tag)


def around_ego(simulation: Simulation, graph: Graph) -> Graph:
    """A graph of the ego as it lies around the ego's true body: with `pose` it is in the ego's own frame."""
    if simulation.setup.pose.exact:
        return graph
    world, row = simulation.world, simulation.agents[0]
    x, y, heading = simulation.fleet.trail[0, -1].tolist()
    angle = world.heading[row].item() - heading
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    position = graph.position.copy()
    position[..., :2] = (graph.position[..., :2] - (x, y)) @ turn + world.position[row]
    return replace(graph, position=position)


def tracks(simulation: Simulation, canvas: Canvas) -> None:
    """The tracks that the ego holds, each a trail of its last 15 frames: its own, and those it only has from others."""
    graph = around_ego(simulation, simulation.merged_graph(0))
    own = _seen_itself(graph, around_ego(simulation, simulation.own_graph(0)))
    for k in range(len(graph.track)):
        colour = SEEN_COLOURS[EGO_SEES if own[k] else OTHERS_SEE]
        trail = graph.position[k, graph.mask[k], :2]
        for node in trail[:-1]:
            canvas.dot(node, colour, 2.0)
        canvas.dot(trail[-1], BLACK, 4.0)
        canvas.dot(trail[-1], colour, 3.0)


def _seen_itself(merged: Graph, own: Graph) -> Bools:
    """(K,) whether a track of the merged graph is one of the ego's own, for it lies within the gate of one."""
    mine = np.zeros(len(merged.track), np.bool_)
    for k in range(len(merged.track)):
        both = merged.mask[k] & own.mask[1:]
        away = np.hypot(*np.moveaxis(merged.position[k] - own.position[1:], -1, 0)[:2])
        mine[k] = bool((both & (away < MERGE_GATE)).any())
    return mine


DECISIONS: tuple[tuple[str, Colour], ...] = (("GO", (0, 120, 85)), ("BRAKE", STOP_COLOUR))
ENDS: Mapping[str, tuple[str, Colour]] = MappingProxyType(
    {SUCCESS: ("ARRIVED", (0, 120, 85)), COLLISION: ("COLLISION", STOP_COLOUR), TIMEOUT: ("OUT OF TIME", PANEL)}
)


def outcome(simulation: Simulation, canvas: Canvas) -> None:
    """What the ego decided, its speed, the time, what its route asks and where it leads; and in the end the outcome."""
    world, ego = simulation.world, int(simulation.agents[0])
    _dot_way(simulation, canvas, ego)
    decision, colour = DECISIONS[int(world.command[ego, -1] == BRAKE)]
    x = canvas.note(10, 20, Tag(decision, colour, size=18))
    number = int(np.argmax(simulation.fleet.views.command[0]))
    command = simulation.scenario.command_names[number].replace("_", " ")
    for text in (f"{world.speed[ego]:.1f} m/s", f"{simulation.time:.1f} s", command):
        x = canvas.note(x + 6, 20, Tag(text, size=14))
    end = simulation.outcome()
    if end == COLLISION:
        draw_burst(canvas, crossed(world, ego, int(world.struck[ego])))
    if end is not None:
        text, colour = ENDS[end]
        middle, below = canvas.size * [0.5, 0.12]
        canvas.note(middle, below, Tag(text, colour, size=30), share=0.5)


def _dot_way(simulation: Simulation, canvas: Canvas, ego: int) -> None:
    """The way of the ego's route up to its goal."""
    world, routes = simulation.world, simulation.map.routes
    front = world.progress[ego] + 0.5 * world.size[ego, 0]
    apart = int(WAY_DOTS / routes.spacing)
    first, last = (int(arc / routes.spacing) for arc in (front + WAY_DOTS, simulation.scene.goal))
    for place in routes.point[world.route[ego], first - first % apart + apart : last + 1 : apart]:
        canvas.dot(place, EGO_COLOUR, 2.0)


LAYERS: Mapping[str, Layer] = MappingProxyType(
    {"sight": sight, "known": known, "links": links, "tracks": tracks, "outcome": outcome}
)


def checked_layers(layers: Any) -> tuple[str, ...]:
    """The names of layers to draw; a one-line ValueError for what is none.

    >>> checked_layers(["sight", "x-ray"])
    Traceback (most recent call last):
    ...
    cad_env.checks.ConfigError: unknown layer 'x-ray': choose among sight, known, links, tracks, outcome
    """
    if isinstance(layers, str) or not isinstance(layers, tuple | list):
        raise ValueError(f"layers must be a tuple of names among {', '.join(LAYERS)}, got {layers!r}")
    for name in layers:
        if not isinstance(name, str) or name not in LAYERS:
            choices = f"choose among {', '.join(LAYERS)}{did_you_mean(name, LAYERS)}"
            raise ConfigError(f"unknown layer {name!r}: {choices}")
    return tuple(layers)
