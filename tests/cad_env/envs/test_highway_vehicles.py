"""highway-env's face of the single-agent environment: its road, its vehicles, its pictures."""

import math

import gymnasium as gym
import numpy as np
import pytest
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import RoadNetwork

from cad_env.envs.single import CADEnv
from cad_env.types import BRAKE, GO
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


def test_vehicles_of_a_scene_cannot_be_replaced():
    env = CADEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="drawn by its scenario"):
        env.road.vehicles = env.road.vehicles[:2]


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
