"""The laws of the world: 6, it has no preferred place or direction, and 8, nobody sees what nobody sees."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scenes import started, steps

from cad_env.scenarios.scene import Actors
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import FRAMES, TRUCK
from cad_env.world.state import OFF, SCRIPTED
from tests.laws.test_laws import EVERYWHERE, differences, seeds

# --- 6. The world has no preferred place or direction ----------------------------------------------------------


def moved(simulation: Simulation, dx: float, dy: float, angle: float) -> None:
    """Turn the map of a simulation about its origin and shift it; the next start places everybody on it."""
    routes = simulation.map.routes
    cos, sin = math.cos(angle), math.sin(angle)
    point = routes.point @ np.array([[cos, sin], [-sin, cos]]) + [dx, dy]
    simulation.map = replace(simulation.map, routes=routes._replace(point=point, heading=routes.heading + angle))


def two_worlds(seed: int, dx: float, dy: float, angle: float, options: dict) -> Iterator[tuple[dict, dict]]:
    """What the ego sees in a world and in the same one elsewhere, step by step."""
    here, there = Simulation(setup_from(options)), Simulation(setup_from(options))
    moved(there, dx, dy, angle)
    here.start(seed)
    there.start(seed)
    for _ in zip(steps(here), steps(there), strict=True):
        yield here.observation(0), there.observation(0)
    assert here.outcome() == there.outcome() is not None


shifts, angles = st.floats(-2000.0, 2000.0), st.floats(-7.0, 7.0)


@EVERYWHERE
@settings(max_examples=2)
@given(seeds, shifts, shifts, angles)
def test_law_6_shifting_and_turning_the_world_changes_no_observation(where: dict, seed, dx, dy, angle):
    # Sensor noise is drawn along the axes of the world, so it is off; misses are not.
    for one, other in two_worlds(seed, dx, dy, angle, {**where, "sensor": {"noise": 0.0}, "radio": "none"}):
        for name in one:
            np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=3e-5, err_msg=name)  # float32 at 200 m


@EVERYWHERE
@settings(max_examples=2)
@given(seeds, shifts, shifts, angles)
def test_law_6_what_is_shared_moves_by_no_more_than_the_centimetre_of_a_message(where: dict, seed, dx, dy, angle):
    # Positions on the air are whole centimetres along the axes of the world, so ties between tracks that are equally
    # near, or fit equally well, may fall otherwise; but the same nodes are known.
    for one, other in two_worlds(seed, dx, dy, angle, {**where, "sensor": {"noise": 0.0}, "radio": "dsrc"}):
        for name in set(one) - {"tracks", "mask", "kind"}:
            np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=3e-5, err_msg=name)
        for t in range(FRAMES):
            here, there = (seen["tracks"][seen["mask"][:, t] == 1, t] for seen in (one, other))
            apart = np.linalg.norm(here[:, None] - there[None], axis=-1)
            assert len(here) == len(there) == 0 or max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 0.02


@EVERYWHERE
@settings(max_examples=2)
@given(seeds, st.integers(-1000, 1000), st.integers(-1000, 1000))
def test_law_6_shifting_the_world_changes_no_observation_with_all_its_noise(where: dict, seed, dx, dy):
    for one, other in two_worlds(seed, dx, dy, 0.0, {**where, "sensor": {"gnss_noise": 0.5}}):
        for name in one:
            np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=3e-5, err_msg=name)


@EVERYWHERE
@settings(max_examples=1)
@given(seeds, shifts, shifts, angles)
def test_law_6_holds_with_all_noise_where_nobody_knows_the_world(where: dict, seed, dx, dy, angle):
    for one, other in two_worlds(seed, dx, dy, angle, {**where, "pose": "denied"}):
        for name in one:
            np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=3e-5, err_msg=name)


@EVERYWHERE
@settings(max_examples=1)
@given(seeds, st.integers(-1000, 1000), st.integers(-1000, 1000))
def test_law_6_holds_where_fixes_are_off(where: dict, seed, dx, dy):
    # A fix on the air is in whole centimetres, of which one may fall to the other side where the world is elsewhere.
    for one, other in two_worlds(seed, dx, dy, 0.0, {**where, "pose": "urban"}):
        for name in set(one) - {"tracks", "mask", "kind"}:
            np.testing.assert_allclose(one[name], other[name], rtol=0.0, atol=3e-5, err_msg=name)
        assert abs(int(one["mask"].sum()) - int(other["mask"].sum())) <= FRAMES


# --- 8. No policy sees what nobody sees ------------------------------------------------------------------------


def hidden_rows(simulation: Simulation) -> list[int]:
    """Vehicles that no connected vehicle has a line of sight to now, and that are not connected themselves."""
    seen = simulation.fleet.visible.any(axis=0)
    seen[simulation.agents] = True
    return [int(row) for row in np.flatnonzero(~seen & (simulation.world.driver != OFF))]


# Where there is little traffic most changes come into view, and are not counted.
@EVERYWHERE
@settings(max_examples=5, suppress_health_check=[HealthCheck.filter_too_much])
@given(seeds, st.integers(0, 40), st.floats(-3.0, 3.0), st.floats(0.0, 25.0))
def test_law_8_changing_what_nobody_sees_changes_no_observation(
    where: dict, seed: int, when: int, shift: float, speed: float
):
    usual, changed = started(seed, hazard=True, **where), started(seed, hazard=True, **where)
    for _ in zip(steps(usual, when), steps(changed, when), strict=True):
        pass
    rows = hidden_rows(usual)
    assume(rows)
    assert rows == hidden_rows(changed)
    world = changed.world
    for row in rows:
        world.speed[row] = world.target_speed[row] = speed
        world.kind[row], world.driver[row] = TRUCK, SCRIPTED
        world.stop_at[row], world.acceleration[row] = 50.0, -3.0
        along = world.heading[row]
        world.position[row] += shift * math.cos(along), shift * math.sin(along)
    for simulation in (usual, changed):
        simulation._perceive()  # the same instant once more, and once more with the change
    assume((usual.fleet.visible == changed.fleet.visible).all())  # it has not come into view, nor before another
    for agent in range(len(usual.agents)):
        assert differences(usual.observation(agent), changed.observation(agent)) == []
        assert usual.own_graph(agent).position.tobytes() == changed.own_graph(agent).position.tobytes()


def test_law_8_has_something_to_hide():
    # Otherwise the law above would be about nothing: hidden vehicles are common, many of them of the stream.
    some = [started(seed, hazard=True) for seed in range(30)]
    hidden = [hidden_rows(simulation) for simulation in some]
    assert sum(len(rows) > 0 for rows in hidden) >= 15
    assert sum(bool({*simulation.scene.hidden} & {*rows}) for simulation, rows in zip(some, hidden, strict=True)) >= 10


def deserted(**options: Any) -> Simulation:
    """A simulation in whose episodes nobody is on the hidden lane; all else is drawn as it would be."""
    simulation = Simulation(setup_from(options))
    usual = simulation.scenario

    def actors(*given: Any) -> Actors:
        drawn = usual.actors(*given)
        here = [replace(one, driver=OFF) if k in drawn.hidden else one for k, one in enumerate(drawn.vehicles)]
        return replace(drawn, vehicles=tuple(here))

    simulation.scenario = replace(usual, actors=actors)
    return simulation


@EVERYWHERE
@settings(max_examples=2)
@given(seeds)
def test_law_8_whether_anybody_comes_does_not_show_before_somebody_is_seen(where: dict, seed: int):
    usual, empty = started(seed, radio="none", **where), deserted(radio="none", **where)
    empty.start(seed)
    rows = list(usual.scene.hidden)
    assume(usual.scene.hazard)
    for _ in zip(steps(usual), steps(empty), strict=False):
        if usual.fleet.visible[0].tobytes() != empty.fleet.visible[0].tobytes():
            break
        assert differences(usual.observation(0), empty.observation(0)) == []
    assert usual.fleet.visible[0, rows].any()  # only that ends it: in a hazard somebody is seen at last
