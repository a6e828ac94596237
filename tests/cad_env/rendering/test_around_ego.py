"""With poses that are off, pictures show what the ego knows around its true body."""

import numpy as np
from scenes import started, steps

from cad_env.rendering.layers import around_ego


def test_what_the_ego_tracks_itself_is_drawn_where_it_is():
    simulation = started(3, pose="denied", radio="none", sensor={"noise": 0.0})
    for _ in steps(simulation, 20):
        pass
    graph = simulation.own_graph(0)
    drawn = around_ego(simulation, graph)
    others = simulation.world.position
    newest = drawn.position[:, -1, :2][drawn.mask[:, -1]]
    assert len(newest) > 1
    assert all(np.linalg.norm(others - place, axis=1).min() < 0.5 for place in newest)
    assert np.linalg.norm(graph.position[0, -1, :2] - drawn.position[0, -1, :2]) > 5.0
    exact = started(3)
    assert around_ego(exact, exact.own_graph(0)).position.tobytes() == exact.own_graph(0).position.tobytes()
