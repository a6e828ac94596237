"""highway-env's face of the single-agent environment: its road, its vehicles, its pictures."""

import copy
import math
import re
from collections.abc import Callable
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.objects import Obstacle

from cad_env.envs.highway_vehicles import RowVehicle, WorldRoad
from cad_env.envs.single import CADEnv
from cad_env.scenarios import SCENARIOS
from cad_env.types import BRAKE, GO, STEP
from cad_env.world.dynamics import drive
from cad_env.world.state import OFF


def test_it_is_a_highway_env_environment():
    env = gym.make("CADLeftTurn-v0").unwrapped
    assert isinstance(env, AbstractEnv)
    env.reset(seed=0)
    assert env.config["policy_frequency"] == 10
    assert isinstance(env.road.network, RoadNetwork)
    assert env.vehicle is env.road.vehicles[0]
    assert len(env.road.vehicles) == len(env.simulation.world.speed)
    assert env.vehicle.lane_index == ("south_far", "south_line", 0)
    assert env.vehicle.on_road
    env.close()


def test_vehicles_are_live_views_on_the_world():
    env = CADEnv()
    env.reset(seed=0)
    world, vehicle = env.simulation.world, env.road.vehicles[2]
    vehicle.speed, vehicle.heading, vehicle.target_speed, vehicle.position = 3.5, 0.25, 4.5, (7.0, 8.0)
    assert (world.speed[2], world.heading[2], world.target_speed[2]) == (3.5, 0.25, 4.5)
    assert world.position[2].tolist() == [7.0, 8.0]
    world.speed[2] = 1.25
    assert vehicle.speed == 1.25
    assert vehicle.velocity.tolist() == pytest.approx([1.25 * math.cos(0.25), 1.25 * math.sin(0.25)])
    assert tuple(world.size[2]) == (vehicle.LENGTH, vehicle.WIDTH)
    assert not vehicle.crashed
    world.struck[2] = 0
    assert vehicle.crashed
    world.driver[2] = OFF
    assert vehicle not in env.road.vehicles


def test_slowing_the_ego_by_hand_slows_the_ego():
    env = CADEnv()
    env.reset(seed=0)
    before = env.vehicle.position.copy()
    env.vehicle.speed = 0.0
    env.step(BRAKE)
    assert np.linalg.norm(env.vehicle.position - before) < 0.05


def replace(road: WorldRoad, _: RowVehicle) -> None:
    road.vehicles = road.vehicles[:2]


def add_by_operator(road: WorldRoad, vehicle: RowVehicle) -> None:
    road.vehicles += [vehicle]


def put(road: WorldRoad, vehicle: RowVehicle) -> None:
    road.vehicles[1] = vehicle


def delete(road: WorldRoad, _: RowVehicle) -> None:
    del road.vehicles[1]


@pytest.mark.parametrize(
    "change",
    [
        replace, add_by_operator, put, delete,
        lambda road, vehicle: road.vehicles.append(vehicle),
        lambda road, vehicle: road.vehicles.extend([vehicle]),
        lambda road, vehicle: road.vehicles.insert(0, vehicle),
        lambda road, vehicle: road.vehicles.remove(vehicle),
        lambda road, vehicle: road.vehicles.pop(),
        lambda road, vehicle: road.vehicles.clear(),
        lambda road, vehicle: road.objects.append(Obstacle(road, [0.0, 0.0])),
    ],
)  # fmt: skip
def test_vehicles_of_a_scene_cannot_be_replaced(change: Callable[[WorldRoad, RowVehicle], object]):
    env = CADEnv()
    env.reset(seed=0)
    before = list(env.road.vehicles)
    with pytest.raises(ValueError, match="the vehicles of a scene are drawn by its scenario at reset and cannot be"):
        change(env.road, before[1])
    assert env.road.vehicles == before
    assert env.road.objects == []


def test_highway_env_finds_its_way_among_the_vehicles():
    env = CADEnv(traffic="dense")
    env.reset(seed=0)
    road, ego = env.road, env.vehicle
    near = road.close_vehicles_to(ego, 50.0)
    gaps = {vehicle: np.linalg.norm(vehicle.position - ego.position) for vehicle in road.vehicles}
    assert set(near) == {vehicle for vehicle, gap in gaps.items() if 0 < gap < 50.0}
    assert near
    ahead, behind = road.neighbour_vehicles(ego)
    assert ego not in (ahead, behind)
    assert ego.to_dict()["x"] == ego.position[0]
    assert not ego.hit
    twin = copy.deepcopy(road)
    assert [vehicle.position.tolist() for vehicle in twin.vehicles] == [v.position.tolist() for v in road.vehicles]
    assert twin.objects == []


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_prediction_at_constant_speed_is_the_way_of_a_vehicle_that_keeps_it(name: str):
    env, times, compared = CADEnv(scenario=name, traffic="none"), np.arange(1, 41) / 20, 0
    for seed in range(3):
        env.reset(seed=seed)
        world, routes = env.simulation.world, env.simulation.map.routes
        for vehicle in env.road.vehicles:
            positions, headings = vehicle.predict_trajectory_constant_speed(times)
            assert (len(positions), len(headings)) == (len(times), len(times))
            for position, heading in zip(positions, headings, strict=True):
                drive(world, routes, vehicle.row, 0.0, 0.05)
                assert np.linalg.norm(position - vehicle.position) < 0.6
                assert abs(math.remainder(heading - vehicle.heading, math.tau)) < 0.15
                compared += vehicle.speed > 5.0
    assert compared > 100


def test_whoever_stands_is_predicted_to_stay():
    env = CADEnv(traffic="dense")
    env.reset(seed=1)
    standing = [vehicle for vehicle in env.road.vehicles if vehicle.speed == 0.0]
    assert standing
    for vehicle in standing:
        positions, headings = vehicle.predict_trajectory_constant_speed([0.5, 3.0])
        np.testing.assert_allclose(positions, [vehicle.position] * 2, atol=1e-9)
        assert headings == pytest.approx([vehicle.heading] * 2)


def test_both_actions_are_always_available():
    env = gym.make("CADLeftTurn-v0")
    assert env.unwrapped.get_available_actions() == [GO, BRAKE]
    for action in env.unwrapped.get_available_actions():
        assert env.action_space.contains(action)


def test_a_simplified_copy_is_without_whoever_is_far_from_the_ego():
    env, removed = CADEnv(scenario="overtaking", traffic="dense"), 0
    for seed in range(5):
        env.reset(seed=seed)
        before = [vehicle.row for vehicle in env.road.vehicles]
        simple = env.simplify()
        gap = np.linalg.norm(env.simulation.world.position - env.vehicle.position, axis=1)
        assert [vehicle.row for vehicle in simple.road.vehicles] == [row for row in before if gap[row] < 200.0]
        assert [vehicle.row for vehicle in env.road.vehicles] == before
        removed += len(before) - len(simple.road.vehicles)
        speed = env.vehicle.speed
        simple.step(GO)
        assert env.vehicle.speed == speed
        assert simple.vehicle is simple.road.rows[0]
    assert removed > 0


def test_a_field_is_set_in_a_copy_for_all_but_the_ego():
    env = CADEnv()
    env.reset(seed=0)
    before = env.simulation.world.speed.copy()
    changed = env.set_vehicle_field(("speed", 3.25)).simulation.world.speed
    assert changed.tolist() == [before[0]] + [3.25] * (len(before) - 1)
    assert env.simulation.world.speed.tolist() == before.tolist()
    with pytest.raises(
        ValueError, match="unknown vehicle field DELTA=4: choose among heading, position, speed, target"
    ):
        env.set_vehicle_field(("DELTA", 4))


def crash(vehicle: RowVehicle) -> None:
    vehicle.crashed = True


def take_over(env: CADEnv) -> None:
    env.vehicle = env.road.vehicles[1]


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda env: env.change_vehicles("highway_env.vehicle.behavior.IDMVehicle"), "change_vehicles()"),
        (lambda env: env.randomize_behavior(), "randomize_behavior()"),
        (lambda env: env.set_preferred_lane(1), "set_preferred_lane()"),
        (lambda env: env.set_route_at_intersection("random"), "set_route_at_intersection()"),
        (lambda env: env.call_vehicle_method(("act", ())), "call_vehicle_method()"),
        (lambda env: env.to_finite_mdp(), "to_finite_mdp()"),
        (take_over, "vehicle cannot be set"),
        (lambda env: crash(env.vehicle), "crashed cannot be set"),
        (lambda env: env.vehicle.act({"acceleration": 1.0}), "act()"),
        (lambda env: env.vehicle.step(0.1), "step()"),
        (lambda env: env.vehicle.predict_trajectory([], 1.0, 0.1, 0.1), "predict_trajectory()"),
        (lambda env: env.vehicle.clip_actions(), "clip_actions()"),
        (lambda env: env.vehicle.on_state_update(), "on_state_update()"),
        (lambda env: env.vehicle.handle_collisions(env.road.vehicles[1], 0.1), "handle_collisions()"),
        (lambda env: RowVehicle.create_from(env.vehicle), "create_from()"),
        (lambda env: RowVehicle.create_random(env.road), "create_random()"),
        (lambda env: RowVehicle.make_on_lane(env.road, env.vehicle.lane_index, 0.0), "make_on_lane()"),
    ],
)
def test_what_highway_env_offers_and_a_compiled_world_does_not_is_refused_in_one_line(call, what: str):
    env = CADEnv()
    env.reset(seed=0)
    world = [part.copy() for part in env.simulation.world]
    with pytest.raises(NotImplementedError, match=re.escape(what)) as refusal:
        call(env)
    assert "\n" not in str(refusal.value)
    assert all((part == now).all() for part, now in zip(world, env.simulation.world, strict=True))


def test_films_hold_a_frame_a_decision_in_this_environment_and_leave_others_alone():
    # A RecordVideo wrapper, as highway-env's FAQ hands it over; the wrapper itself needs moviepy.
    env, other, wrapper = CADEnv(render_mode="rgb_array"), CADEnv(), SimpleNamespace(frames_per_sec=30)
    env.set_record_video_wrapper(wrapper)
    env.reset(seed=0)
    assert wrapper.frames_per_sec == env.metadata["render_fps"] == round(1 / STEP)
    assert env.config["simulation_frequency"] == 2 * env.metadata["render_fps"]
    env.update_metadata(video_real_time_ratio=2)
    assert env.metadata["render_fps"] == round(2 / STEP)
    assert CADEnv.metadata == other.metadata == CADEnv().metadata
    assert CADEnv.metadata["render_fps"] == round(1 / STEP)


def test_pictures_show_the_scene():
    env = CADEnv(render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (720, 720, 3)
    assert first.dtype == np.uint8
    assert first.std() > 5.0
    for _ in range(10):
        env.step(GO)
    assert (env.render() != first).any()
    env.close()
    env.reset(seed=0)
    assert (env.render() == first).all()
    env.close()


def test_north_is_up_in_pictures():
    config = {"screen_width": 400, "screen_height": 400, "scaling": 2.0}
    env = CADEnv(render_mode="rgb_array", config=config, layers=())
    env.reset(seed=0)
    # The ego comes from the south of the junction, which is in the middle of the picture: it must be below.
    env.simulation.world.driver[2:] = OFF
    green = (np.abs(env.render().astype(int) - (50, 200, 0)) < 20).all(axis=-1)
    rows = np.flatnonzero(green.any(axis=1))
    env.close()
    assert len(rows) > 0
    assert rows.mean() > 200


def test_without_a_render_mode_nothing_is_drawn():
    env = gym.make("CADLeftTurn-v0")
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="without specifying any render mode"):
        assert env.unwrapped.render() is None
