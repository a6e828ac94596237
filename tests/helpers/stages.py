"""Single stages of the pipeline from Python: what one vehicle detects, and the edges that a graph implies."""

from dataclasses import dataclass

import numpy as np

from cad_env.config import SensorConfig
from cad_env.pipeline.sense import fix_pose, outline, sense, sensing
from cad_env.types import MAX_TRACKS, STEP, Floats, Graph, Ints
from cad_env.world.state import World


@dataclass(frozen=True)
class Detections:
    """What one vehicle's sensors report in one frame: no identity, no truth."""

    time: float  # s
    position: Floats  # (n, 3) m
    kind: Ints  # (n,) int8 CAR or TRUCK


def detect(world: World, observer: int, config: SensorConfig, key: Ints, step: int) -> Detections:
    """What one vehicle's sensors report in one frame."""
    pose = np.zeros(3)
    sensor = sensing(config)
    position, kind = np.zeros((MAX_TRACKS, 3)), np.zeros(MAX_TRACKS, np.int8)
    fix_pose(world, observer, sensor, key, step, pose)
    count = len(world.heading)
    visible, near, outlines = np.zeros(count, np.bool_), np.zeros(count, np.int64), np.zeros((count, 3))
    outline(world, outlines)
    found = sense(world, outlines, observer, sensor, key, step, pose, position, kind, visible, near)
    return Detections(step * STEP, position[:found].copy(), kind[:found].copy())


def nodes_and_edges(graph: Graph) -> tuple[Ints, Floats, Ints, Floats]:
    """The edges that the nodes imply: (E, 2) spatial pairs and (E,) distances m, (F, 2) temporal pairs and (F,) gaps s.

    Pairs index the nodes in the order of np.argwhere(graph.mask), source first; a gap is source minus target time.
    """
    node = np.argwhere(graph.mask)
    place = graph.position[graph.mask]
    different = ~np.eye(len(node), dtype=bool)
    spatial = np.argwhere((node[:, None, 1] == node[None, :, 1]) & different)
    temporal = np.argwhere((node[:, None, 0] == node[None, :, 0]) & different)
    distance = np.linalg.norm(place[spatial[:, 0]] - place[spatial[:, 1]], axis=-1)
    gap = STEP * (node[temporal[:, 0], 1] - node[temporal[:, 1], 1])
    return spatial, distance, temporal, gap
