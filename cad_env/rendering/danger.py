"""A word beside the vehicle that is about to hit the ego: what the ego knows of it. For pictures that tell a story."""

import numpy as np

from cad_env.pipeline.merge import MERGE_GATE
from cad_env.rendering.canvas import BLACK, Canvas, Tag
from cad_env.rendering.layers import EGO_SEES, OTHERS_SEE, SEEN_COLOURS, STOP_COLOUR, around_ego, who_sees
from cad_env.simulation.simulation import Simulation
from cad_env.types import STEP, Graph
from cad_env.world.state import OFF

RECENT = 5  # newest frames, one of which must have a node for a track to be of now


def ends_at(simulation: Simulation, graph: Graph, row: int) -> bool:
    """True if a track of a graph ends, within the last frames, at a vehicle."""
    place = simulation.world.position[row]
    reach = (
        MERGE_GATE + STEP * simulation.world.speed[row] * np.arange(RECENT)[::-1]
    )  # how far it went since that frame
    away = np.hypot(*np.moveaxis(graph.position[:, -RECENT:, :2] - place, -1, 0))
    return bool((graph.mask[:, -RECENT:] & (away < reach)).any())


def only_told(simulation: Simulation, row: int) -> bool:
    """True if the ego knows of a vehicle, and only from others."""
    own, merged = (around_ego(simulation, graph) for graph in (simulation.own_graph(0), simulation.merged_graph(0)))
    return ends_at(simulation, merged, row) and not ends_at(simulation, own, row)


def danger(simulation: Simulation, canvas: Canvas) -> None:
    """Say beside the vehicle that would hit the ego, while it cannot see it, whether it knows of it all the same."""
    row, world = simulation.scene.hazard_row, simulation.world
    if row < 0 or world.driver[row] == OFF or who_sees(simulation)[row] == EGO_SEES:
        return
    tag = Tag("hidden, and the ego does not know", STOP_COLOUR)
    if only_told(simulation, row):
        tag = Tag("hidden, but the ego is told", SEEN_COLOURS[OTHERS_SEE], BLACK)
    elif ends_at(simulation, around_ego(simulation, simulation.own_graph(0)), row):
        tag = Tag("hidden again", SEEN_COLOURS[EGO_SEES], BLACK)
    canvas.label_beside(world.position[row], tag)
