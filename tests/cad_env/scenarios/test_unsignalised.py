"""The junction without lights: who has to agree, what is hidden, and that nobody crashes who keeps to the rules."""

import numpy as np
import pytest
from scenes import started

from cad_env.envs.parallel import parallel_env
from cad_env.envs.single import CADEnv
from cad_env.scenarios.ranges import DENSITIES, Traffic
from cad_env.scenarios.scene import EGO, Scene, place
from cad_env.scenarios.unsignalised import LINE, UNSIGNALISED, exit_of
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, GO, MAX_STEPS
from cad_env.world.state import IDM, STANDING, STREAM, YIELDING
from cad_env.world.step import advance, note_contacts

MAP = UNSIGNALISED.map
PEERS = (2, 3, 4)


def scenes_of(density: str = "light", count: int = 60, **ranges) -> list[Scene]:
    return [UNSIGNALISED.scene(UNSIGNALISED.configured(ranges), Traffic(density), seed) for seed in range(count)]


def way_of(scene: Scene, row: int) -> tuple[str, str]:
    """The arm that a vehicle comes from, and left, through or right."""
    arm, _, way = MAP.plans[scene.placements[row].route].name.partition("_")
    return arm, way


def test_the_ego_and_its_peers_come_from_three_or_four_sides():
    counts = []
    for scene in scenes_of():
        arms = {way_of(scene, row)[0] for row in (EGO, *PEERS)}
        assert {"south", "north"} <= arms
        assert len(arms) == (3 if scene.hidden else 4)
        counts.append(len(arms))
    assert {*counts} == {3, 4}


def test_nobody_turns_onto_the_road_of_the_stream():
    for scene in scenes_of("dense"):
        if not scene.hidden:
            continue
        stream, _ = way_of(scene, scene.hidden[0])
        moving = [row for row, vehicle in enumerate(scene.placements) if vehicle.driver in (IDM, YIELDING)]
        before_line = [row for row in moving if scene.placements[row].progress < LINE]
        assert len(before_line) >= 4
        assert all(exit_of(*way_of(scene, row)) != exit_of(stream, "through") for row in before_line)
        assert all(way_of(scene, row)[0] != stream for row in before_line)


@pytest.mark.parametrize("density", DENSITIES)
def test_nobody_touches_anybody_at_the_start(density: str):
    for scene in scenes_of(density):
        world = place(scene.placements, MAP.routes)
        note_contacts(world)
        assert (world.struck < 0).all()


def test_drivers_are_as_stated():
    for scene in scenes_of("none"):
        drivers = [vehicle.driver for vehicle in scene.placements]
        assert drivers[EGO] == IDM
        assert [drivers[row] for row in PEERS] == [YIELDING] * 3
        assert {drivers[row] for row in scene.hidden} <= {STREAM}
        assert drivers.count(STANDING) == 8


def test_peers_are_connected_before_anybody_else():
    for scene in scenes_of("dense", collaborators=(2, 2)):
        assert scene.connected[0] == EGO
        assert len(scene.connected) == 3
        assert set(scene.connected[1:]) <= set(PEERS)
    for scene in scenes_of("dense", collaborators=(3, 3)):
        assert scene.connected == (EGO, *PEERS)


def test_whoever_decides_gives_way_by_itself_no_more():
    simulation = Simulation(setup_from({"scenario": "unsignalised"}))
    simulation.start(3, receivers=1)
    assert [simulation.world.driver[row] for row in PEERS] == [YIELDING] * 3
    env = parallel_env("CADUnsignalised-v0")
    env.reset(seed=3)
    assert [env.simulation.world.driver[row] for row in (EGO, *PEERS)] == [IDM] * 4


def test_at_least_three_agents_act():
    env = parallel_env("CADUnsignalised-v0", ranges={"collaborators": (2, 4)})
    for seed in range(40):
        env.reset(seed=seed)
        assert len(env.agents) >= 3


def test_vans_hide_at_the_start_whoever_comes_from_the_side():
    seen = []
    for seed in range(30):
        simulation = started(seed, scenario="unsignalised", traffic="none", ranges={"collaborators": (3, 3)})
        arms = [way_of(simulation.scene, row)[0] for row in (EGO, *PEERS)]
        beside = [k for k in range(1, 4) if arms[k] in ("east", "west")]
        seen += [simulation.fleet.visible[0, k + 1] for k in beside]
    assert len(seen) >= 30
    assert np.mean(seen) < 0.3


def test_if_all_go_most_episodes_end_in_a_collision():
    env, crashed = parallel_env("CADUnsignalised-v0", radio="none", traffic="none"), 0
    for seed in range(25):
        env.reset(seed=seed)
        while env.agents:
            env.step(dict.fromkeys(env.agents, GO))
        crashed += "collision" in env.outcomes.values()
    assert crashed >= 15


def contacts_on_rules(seed: int, density: str, ego: str) -> list[int]:
    """Rows but the ego's that have touched another than the ego, everybody else on rules, until the ego is touched."""
    scene = UNSIGNALISED.scene(UNSIGNALISED.configured({}), Traffic(density), seed)
    world, rng = place(scene.placements, MAP.routes), np.random.default_rng(seed)
    if ego == "on rules":
        world.driver[EGO] = YIELDING
    rows, action, scratch = np.array([EGO]), np.zeros(1, np.int64), np.zeros(len(world.speed))
    for _ in range(MAX_STEPS):
        action[0] = BRAKE if ego == "at random" and rng.random() < 0.4 else GO
        advance(world, MAP.routes, rows, action, scratch)
        if ego != "on rules" and world.struck[EGO] >= 0:
            break
    return [row for row in np.flatnonzero(world.struck >= 0).tolist() if EGO not in (row, world.struck[row])]


@pytest.mark.parametrize("ego", ["on rules", "goes", "at random"])
@pytest.mark.parametrize("density", DENSITIES)
def test_whoever_keeps_to_the_rules_touches_nobody(density: str, ego: str):
    assert {seed: rows for seed in range(12) if (rows := contacts_on_rules(seed, density, ego))} == {}


def test_the_single_ego_meets_hazards_and_arrives_without_them():
    env = CADEnv(scenario="unsignalised", traffic="none", radio="none")
    for hazard, outcome in ((True, "collision"), (False, "success")):
        _, info = env.reset(seed=5, options={"hazard": hazard})
        while info["outcome"] is None:
            *_, info = env.step(GO)
        assert info["outcome"] == outcome
