"""Points in place of graphs: over the same radio, to the ego, alone and side by side, and never what nobody sees."""

import copy
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scenes import Twitchy, digest, started, steps, whole_episode

from cad_env.config import RadioConfig
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.lidar.config import CloudConfig
from cad_env.lidar.envelope import ENVELOPE_SIZE
from cad_env.lidar.points import RawPoints
from cad_env.pipeline.radio import LOST, NOT_SENT, REACHES
from cad_env.scenarios import SHIPPED
from cad_env.scoring.rollout import rollout, rollouts
from cad_env.simulation.simulation import Simulation
from cad_env.types import GO
from tests.cad_env.envs.test_vector import driven, same, twitch
from tests.laws.test_laws import differences
from tests.laws.test_laws_seed import facts
from tests.laws.test_laws_world import hidden_rows, two_worlds

CLOUD = {"azimuths": 128, "beams": 4, "merged": 200}
EVERYWHERE = pytest.mark.parametrize("scenario", list(SHIPPED))
EXACT = {"noise": 0.0, "miss": 0.0}


def shown(observation: dict[str, np.ndarray]) -> np.ndarray:
    return observation["cloud"][observation["cloud_mask"] == 1]


def in_the_world(simulation: Simulation, points: np.ndarray) -> np.ndarray:
    """(n, 2) m of points in the ego's frame."""
    x, y, heading = simulation.fleet.trail[0, -1]
    cos, sin = math.cos(heading), math.sin(heading)
    return points[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + [x, y]


def off_the_bodies(simulation: Simulation, places: np.ndarray) -> np.ndarray:
    """(n,) m from each place to the outline of the nearest vehicle."""
    world, nearest = simulation.world, np.full(len(places), np.inf)
    for k in range(len(world.speed)):
        cos, sin = math.cos(world.heading[k]), math.sin(world.heading[k])
        gap = (places - world.position[k]) @ np.array([[cos, -sin], [sin, cos]])
        over = np.abs(gap) - world.size[k] / 2
        nearest = np.minimum(nearest, np.abs(np.where((over > 0).any(1), np.hypot(*over.clip(0).T), over.max(1))))
    return nearest


@EVERYWHERE
def test_every_point_that_the_ego_is_shown_is_on_a_vehicle(scenario: str):
    simulation = started(5, scenario=scenario, cloud=CLOUD, radio="ideal", sensor=EXACT)
    others = 0
    for _ in steps(simulation, 20):
        places = in_the_world(simulation, shown(simulation.observation(0)))
        assert off_the_bodies(simulation, places).max() < 0.03
        assert simulation.fleet.report.received_bytes[0] > 0
        others += len(places) - len(simulation.sharing.config.codec.decode(own_message(simulation)))
    assert others > 100


def own_message(simulation: Simulation) -> bytes:
    return RawPoints().encode([simulation.sharing.cloud(0)])[0]


def test_points_that_took_their_time_are_where_the_vehicles_were():
    late, prompt = (
        started(1, cloud=CLOUD, radio=RadioConfig(rate=1e9, loss=0.0, delay=delay, range=1e6), sensor=EXACT)
        for delay in (0.5, 0.0)
    )
    history = []
    for step, _ in zip(steps(prompt, 30), steps(late, 30), strict=True):
        own = len(late.sharing.config.codec.decode(own_message(late)))
        seen = [one.observation(0) for one in (late, prompt)]
        assert shown(seen[0])[:own].tobytes() == shown(seen[1])[:own].tobytes()  # its own are of now
        heard = [in_the_world(one, shown(what)[own:]) for one, what in zip((late, prompt), seen, strict=True)]
        history.append(heard[1])
        if step < 5:
            assert len(heard[0]) == 0
        elif len(history[-6]) + own <= CLOUD["merged"]:
            np.testing.assert_allclose(heard[0], history[-6], atol=1e-4)


def test_the_ego_s_own_points_come_first_and_of_too_many_every_so_many_is_shown():
    many, few = (started(3, cloud={**CLOUD, "merged": merged}, radio="ideal") for merged in (5000, 10))
    every, some = (shown(one.observation(0)) for one in (many, few))
    own = many.sharing.config.codec.decode(own_message(many))
    np.testing.assert_allclose(every[: len(own)], own, atol=1e-5)
    assert len(some) == 10
    assert some.tolist() == every[np.arange(10) * len(every) // 10].tolist()


def test_training_data_are_what_each_vehicle_sees_by_itself_with_where_it_takes_itself_to_be():
    simulation = started(2, cloud=CLOUD, radio="none", sensor={"gnss_noise": 1.0})
    for _ in steps(simulation, 3):
        clouds = simulation.clouds
        assert len(clouds) == len(simulation.agents)
        np.testing.assert_allclose(clouds[0].thinned, shown(simulation.observation(0)), atol=0.006)
        assert [one.pose.tolist() for one in clouds] == simulation.fleet.trail[:, -1].tolist()
        assert all((one.thinned[:, 2] > 0.2).all() for one in clouds)
    assert started(2).clouds is None


# --- The radio ---------------------------------------------------------------------------------------------------


def told(simulation: Simulation, count: int = 10) -> list[dict[str, Any]]:
    return [simulation.info() for _ in steps(simulation, count)]


def test_raw_clouds_are_over_the_budget_of_dsrc_and_are_refused_and_over_an_ideal_radio_they_arrive():
    refused, arrived = (told(started(3, cloud={}, radio=radio), 2) for radio in ("dsrc", "ideal"))
    for info in refused:
        assert info["refused"] == "over the byte budget of its slot"
        assert info["bytes_sent"] == info["bytes_received"] == info["messages_sent"] == info["messages_lost"] == 0
    for info in arrived:
        assert info["refused"] is None
        assert 300_000 < info["largest_message"] <= ENVELOPE_SIZE + 4 + 6 * 64 * 1024
        assert info["bytes_sent"] > info["bytes_received"] > 300_000


def test_what_is_counted_is_what_is_written():
    simulation = started(4, cloud=CLOUD, radio="ideal")
    for _ in steps(simulation, 5):
        clouds = [simulation.sharing.cloud(v) for v in range(len(simulation.agents))]
        sizes = [ENVELOPE_SIZE + len(payload) for payload in RawPoints().encode(clouds)]
        info = simulation.info()
        assert info["bytes_sent"] == sum(sizes)
        assert info["largest_message"] == max(sizes)
        assert info["bytes_received"] == sum(sizes[1:])
        assert [simulation.arrival(v, 0) for v in range(1, len(sizes))] == [(REACHES, size) for size in sizes[1:]]


@EVERYWHERE
def test_the_same_messages_are_lost_of_points_as_of_graphs(scenario: str):
    radio = RadioConfig(rate=1e9, loss=0.5, delay=0.2, range=100.0)
    points, graphs = (started(6, scenario=scenario, cloud=cloud, radio=radio) for cloud in (CLOUD, None))
    ends = set()
    for _ in zip(steps(points, 40), steps(graphs, 40), strict=True):
        for sender in range(len(points.agents)):
            assert points.arrival(sender, 0)[0] == graphs.arrival(sender, 0)[0]
            ends.add(points.arrival(sender, 0)[0])
        assert points.info()["messages_lost"] == graphs.info()["messages_lost"]
    assert ends >= {NOT_SENT, REACHES, LOST}


@EVERYWHERE
def test_law_1_a_budget_of_zero_is_sharing_nothing_to_the_last_bit(scenario: str):
    nothing = RadioConfig(rate=0.0, loss=0.3, delay=0.5, range=1e6)
    zero, rest = whole_episode(8, scenario=scenario, cloud=CLOUD, radio=nothing)
    without, same = whole_episode(8, scenario=scenario, cloud=CLOUD, radio="none")
    assert differences(zero, without) == []
    assert [r[:2] for r in rest] == [r[:2] for r in same]
    assert all(r[2]["bytes_received"] == r[2]["bytes_sent"] == r[2]["messages_sent"] == 0 for r in rest)
    assert zero["cloud_mask"].sum() > 0


def test_no_graph_is_on_the_air_beside_the_points():
    points, alone = started(7, cloud=CLOUD, radio="ideal"), started(7, radio="none")
    for _ in zip(steps(points, 30), steps(alone, 30), strict=True):
        seen = points.observation(0)
        assert differences({name: seen[name] for name in alone.observation(0)}, alone.observation(0)) == []


def test_episodes_count_the_bytes_of_the_points():
    env = CADEnv(cloud=CLOUD, radio="cv2x")
    counted: list[int] = []
    episode = rollout(env, Twitchy(), 5, watch=lambda env, *_: counted.append(env.simulation.info()["bytes_sent"]))
    assert episode.bytes_sent[:-1].tolist() == counted[1:]
    assert episode.bytes_per_message > 500


# --- The laws of an episode --------------------------------------------------------------------------------------


def test_law_9_a_vector_is_as_single_environments_and_rollouts_as_a_rollout():
    options = {"cloud": CloudConfig(**CLOUD), "radio": RadioConfig(rate=1e9, delay=0.1), "traffic": "dense"}
    vector = CADVectorEnv(8, scenario=list(SHIPPED), **options)
    history = list(driven(vector, 12, 50))
    for place in range(8):
        env = CADEnv(scenario=list(SHIPPED)[place % 3], **options)
        seen, info = env.reset(seed=50 + place)
        for step, together in enumerate(history):
            assert seen.keys() == together[0].keys()
            assert all(same(part, together[0][name][place]) for name, part in seen.items())
            assert all(same(value, together[-1][name][place]) for name, value in info.items())
            seen, *_, info = env.step(int(twitch(step, together[0], 8)[place]))
    together = sorted(rollouts(CADVectorEnv(4, **options), Twitchy(), range(3)), key=lambda e: e.seed)
    assert [facts(e) for e in together] == [facts(rollout(CADEnv(**options), Twitchy(), seed)) for seed in range(3)]


def test_law_9_the_same_seed_is_the_same_episode_and_a_copy_of_it_goes_on_alike():
    assert digest(1, cloud=CLOUD) == digest(1, cloud=CLOUD) != digest(2, cloud=CLOUD)
    env = CADEnv(cloud=CLOUD, radio="cv2x")
    env.reset(seed=4)
    env.step(GO)
    twin = copy.deepcopy(env)
    for _ in range(3):
        one, other = env.step(GO), twin.step(GO)
        assert differences(one[0], other[0]) == []
        assert one[1:] == other[1:]


@pytest.mark.parametrize(("seed", "dx", "dy", "angle"), [(1, 500.0, -300.0, 1.0), (2, -40.25, 3.5, -2.5)])
def test_law_6_shifting_and_turning_the_world_changes_no_observation(seed: int, dx: float, dy: float, angle: float):
    # Poses on the air are whole centimetres along the axes of the world.
    for one, other in two_worlds(seed, dx, dy, angle, {"cloud": CLOUD, "sensor": EXACT, "radio": "ideal"}):
        np.testing.assert_allclose(one["cloud"], other["cloud"], atol=0.03)
        assert one["cloud_mask"].tobytes() == other["cloud_mask"].tobytes()


@EVERYWHERE
def test_law_7_clouds_move_neither_the_traffic_nor_what_the_sensors_report(scenario: str):
    usual, other = started(9, scenario=scenario), started(9, scenario=scenario, cloud=CLOUD)
    assert usual.scene == other.scene
    for _ in zip(steps(usual, 20), steps(other, 20), strict=True):
        for one, two in zip(usual.world, other.world, strict=True):
            assert one.tobytes() == two.tobytes()
        for agent in range(len(usual.agents)):
            assert usual.own_graph(agent).position.tobytes() == other.own_graph(agent).position.tobytes()


def test_law_8_moving_what_nobody_sees_changes_no_observation():
    changed = 0
    for seed in range(12):
        usual, other = (started(seed, hazard=True, cloud=CLOUD, radio="ideal") for _ in range(2))
        struck = hidden_rows(usual)
        before = [other.sharing.cloud(v).tobytes() for v in range(len(other.agents))]
        for row in struck:
            other.world.position[row] += 0.5 * np.array([math.cos(row), math.sin(row)])
            other.world.speed[row] += 3.0
        for simulation in (usual, other):
            simulation._perceive()
        if (usual.fleet.visible != other.fleet.visible).any() or not struck:
            continue
        changed += 1
        assert differences(usual.observation(0), other.observation(0)) == []
        assert before == [other.sharing.cloud(v).tobytes() for v in range(len(other.agents))]
    assert changed >= 5


class Labelled(RawPoints):
    """Raw points, each with its place among those of its message, and with the number of clouds of its batch."""

    width = 2
    calls = 0

    def encode(self, clouds: Sequence[np.ndarray]) -> list[bytes]:
        type(self).calls += 1
        return [bytes([len(clouds)]) + payload for payload in super().encode(clouds)]

    def decode(self, payload: bytes) -> np.ndarray:
        points = super().decode(payload[1:])
        return np.column_stack([points, np.arange(len(points)), np.full(len(points), payload[0])])


def test_features_go_with_their_points_and_the_clouds_of_all_scenes_are_encoded_at_once():
    config = CloudConfig(128, 4, Labelled(), 200)
    vector, plain = (CADVectorEnv(3, cloud=cloud, radio="ideal") for cloud in (config, CloudConfig(**CLOUD)))
    seen, same = vector.reset(seed=0)[0], plain.reset(seed=0)[0]
    assert vector.single_observation_space["cloud"].shape == (200, 5)
    Labelled.calls = 0
    for _ in range(2):
        seen, same = vector.step(np.zeros(3, int))[0], plain.step(np.zeros(3, int))[0]
        assert seen["cloud"][..., :3].tobytes() == same["cloud"].tobytes()
    assert Labelled.calls == 2
    together = sum(len(simulation.agents) for simulation in vector.batch.simulations)
    for k, simulation in enumerate(vector.batch.simulations):
        features = shown({name: seen[name][k] for name in ("cloud", "cloud_mask")})[:, 3:]
        assert set(features[:, 1]) == {together}
        firsts = (features[:, 0] == 0).sum()
        assert 1 <= firsts <= len(simulation.agents)
        assert (np.diff(features[:, 0])[features[1:, 0] > 0] == 1).all()
