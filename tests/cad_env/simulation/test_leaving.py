"""Who has left the map is silent and unseen, and bytes count what is on the road: by every way to share."""

from typing import Any

import numpy as np
import pytest
from scenes import started, steps

from cad_env.envs.parallel import parallel_env
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.pipeline.radio import NOT_SENT, REACHES, SILENT
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, GO, Graph
from cad_env.world.state import IDM, OFF

SEED = 7000001  # of overtaking with four collaborators, the last of whom drives
LEAVING = {"scenario": "overtaking", "radio": "ideal", "ranges": {"collaborators": (4, 4)}}


def everything(graph: Graph) -> Graph:
    """Shares all that is known, by way of Python."""
    return graph


WAYS: dict[str, dict[str, Any]] = {
    "compiled": {}, "python": {"share": everything}, "clouds": {"cloud": {"azimuths": 64, "beams": 4}},
}  # fmt: skip
EVERY_WAY = pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)


def gone(simulation: Simulation) -> list[int]:
    """The connected vehicles that have left the map."""
    return np.flatnonzero(simulation.world.driver[simulation.agents] == OFF).tolist()


def near_its_end(simulation: Simulation) -> Simulation:
    """The same with the last of the connected vehicles put 40 m before the end of its road."""
    world, routes, row = simulation.world, simulation.map.routes, simulation.agents[-1]
    assert world.driver[row] == IDM
    assert world.speed[row] > 5.0
    sample = int((routes.length[world.route[row]] - 40.0) / routes.spacing)
    world.position[row], world.progress[row] = routes.point[world.route[row], sample], sample * routes.spacing
    return simulation


def check_silence(simulation: Simulation) -> int:
    """Those that are gone neither sense nor send nor receive; answers how many they are."""
    fleet, left = simulation.fleet, gone(simulation)
    for v in left:
        assert (fleet.report.refusal[v], fleet.report.sent_bytes[v]) == (SILENT, 0)
        assert not fleet.visible[v].any()
        assert not simulation.own_graph(v).mask[:, -1].any()
        assert not fleet.visible[:, simulation.agents[v]].any()
        assert simulation.arrival(v, 0)[0] == NOT_SENT
        if v < len(fleet.report.lost):
            assert fleet.report.received_bytes[v] == fleet.report.lost[v] == 0
    return len(left)


@EVERY_WAY
def test_the_messages_of_a_step_are_those_of_the_vehicles_on_the_map(way: dict[str, Any]):
    simulation, seen = near_its_end(started(SEED, **LEAVING, **way)), set()
    for _ in steps(simulation, 200, action=lambda agent: BRAKE if agent == 0 else GO):
        left, info = check_silence(simulation), simulation.info()
        assert info["messages_sent"] == len(simulation.agents) - left
        assert info["bytes_sent"] == simulation.fleet.report.sent_bytes.sum()
        assert info["bytes_received"] == info["bytes_sent"] - simulation.fleet.report.sent_bytes[0]
        assert info["refused"] is None
        seen.add(left)
    assert seen >= {0, 1}


@EVERY_WAY
def test_nobody_holds_a_newest_node_where_a_vehicle_left(way: dict[str, Any]):
    simulation, checked = near_its_end(started(SEED, **LEAVING, **way, sensor={"noise": 0.0, "miss": 0.0})), 0
    for _ in steps(simulation, 200, action=lambda agent: BRAKE if agent == 0 else GO):
        for v in gone(simulation):
            place = simulation.world.position[simulation.agents[v]]
            for agent in range(len(simulation.agents)):
                for graph in (simulation.own_graph(agent), simulation.merged_graph(agent)):
                    newest = graph.position[:, -1, :2][graph.mask[:, -1]]
                    assert (np.linalg.norm(newest - place, axis=1) > 3.0).all()
                    checked += 1
    assert checked > 50


def test_a_message_on_its_way_when_its_sender_leaves_still_arrives_and_none_after_it():
    slow = {**LEAVING, "radio": {"delay": 0.3, "loss": 0.0, "range": 1e6}}
    simulation, after = near_its_end(started(SEED, **slow)), {}
    for step in steps(simulation, 200, action=lambda agent: BRAKE if agent == 0 else GO):
        for v in gone(simulation):
            after.setdefault(v, step)
            assert (simulation.arrival(v, 0)[0] == REACHES) is (step < after[v] + 3)
    assert after


def test_a_vehicle_that_is_gone_receives_nothing():
    for way in (WAYS["compiled"], WAYS["python"]):
        simulation, checked = near_its_end(started(SEED, **LEAVING, **way)), 0
        for _ in steps(simulation, 200, action=lambda agent: BRAKE if agent == 0 else GO):
            for v in gone(simulation):
                assert simulation.fleet.report.received_bytes[v] == 0
                assert all(simulation.arrival(sender, v)[0] == NOT_SENT for sender in range(len(simulation.agents)))
                checked += 1
        assert checked > 10


@EVERY_WAY
def test_one_environment_and_many_side_by_side_count_alike(way: dict[str, Any]):
    single, many, fewest = CADEnv(**LEAVING, **way), CADVectorEnv(2, **LEAVING, **way), 5
    single.reset(seed=SEED)
    many.reset(seed=SEED)
    for simulation in (single.simulation, many.batch.simulations[0]):
        near_its_end(simulation)
    for _ in range(200):
        seen, *_, info = single.step(BRAKE)
        together, *_, infos = many.step(np.full(2, BRAKE))
        assert all(np.array_equal(part, together[name][0]) for name, part in seen.items())
        assert [info[name] for name in ("messages_sent", "bytes_sent", "bytes_received")] == [
            infos[name][0] for name in ("messages_sent", "bytes_sent", "bytes_received")
        ]
        fewest = min(fewest, info["messages_sent"])
    assert fewest < 5


def test_in_a_dense_road_of_connected_vehicles_no_message_comes_from_beyond_it():
    env, left = parallel_env("CADOvertaking-v0", penetration=1.0, traffic="dense"), 0
    env.reset(seed=3)
    while env.agents:
        env.step(dict.fromkeys(env.agents, GO) | {"cav_0": BRAKE})
        left += check_silence(env.simulation)
        assert not any(env.agents.count(f"cav_{v}") for v in gone(env.simulation))
    assert left > 100
