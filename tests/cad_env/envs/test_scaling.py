"""Observations for networks: divided by fixed scales, alone as side by side."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from cad_env.envs.scaling import SCALES, ScaledObservation, scaled_observation
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.lidar.config import CloudConfig
from cad_env.scenarios import SHIPPED


@pytest.mark.parametrize("scenario", SHIPPED)
def test_what_is_fed_to_a_network_lies_about_one(scenario: str) -> None:
    env = ScaledObservation(CADEnv(scenario=scenario, coverage=True))
    largest = {name: [] for name in env.observation_space}
    for seed in range(4):
        observation, info = env.reset(seed=seed)
        while info["outcome"] is None:
            observation, *_, info = env.step(0)
            for name, part in observation.items():
                largest[name].append(float(np.abs(part).max()))
    for name, found in largest.items():
        assert np.quantile(found, 0.9) < 4.5, name  # what stands at the horizon, 200 m
        assert name not in SCALES or max(found) > 0.2, name
    shown = observation["tracks"][observation["mask"] > 0]
    assert np.mean(np.abs(shown) <= 1.0) > 0.8


def test_side_by_side_it_is_as_alone() -> None:
    envs, alone = CADVectorEnv(2), ScaledObservation(CADEnv())
    seen = scaled_observation(envs.reset(seed=1)[0])
    for place in range(2):
        for name, part in alone.reset(seed=1 + place)[0].items():
            np.testing.assert_array_equal(seen[name][place], part)


def test_what_a_codec_says_of_points_and_whole_numbers_stay_as_they_are() -> None:
    bare = CADEnv(cloud=CloudConfig(azimuths=64, beams=4))
    observation, _ = bare.reset(seed=1)
    found = ScaledObservation(bare).observation(observation)
    np.testing.assert_allclose(found["cloud"][:, :3] * 50.0, observation["cloud"][:, :3], rtol=1e-6)
    np.testing.assert_array_equal(found["mask"], observation["mask"])
    wide = scaled_observation({"cloud": np.full((2, 5), 100.0)})
    np.testing.assert_array_equal(wide["cloud"], [[2.0, 2.0, 2.0, 100.0, 100.0]] * 2)


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version:UserWarning")
def test_it_is_an_environment_of_gymnasium_and_changes_nothing_behind() -> None:
    env = ScaledObservation(gym.make("CADLeftTurn-v0"))
    check_env(env, skip_render_check=True)
    bare = CADEnv()
    before, _ = bare.reset(seed=1)
    kept = {name: part.copy() for name, part in before.items()}
    ScaledObservation(bare).observation(before)
    for name, part in kept.items():
        np.testing.assert_array_equal(before[name], part)
