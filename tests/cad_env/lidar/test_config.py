"""Asking for clouds: what is in the observation then, and what is refused."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from cad_env.envs.parallel import CADParallelEnv
from cad_env.envs.single import CADEnv
from cad_env.lidar.config import CloudConfig
from cad_env.pipeline.observe import HORIZON
from cad_env.simulation.batch import SceneBatch
from cad_env.simulation.setup import Setup, setup_from
from cad_env.types import GO

CLOUD = {"azimuths": 128, "beams": 4, "merged": 200}


def test_clouds_are_in_the_space_and_only_when_asked_for():
    env = gym.make("CADLeftTurn-v0", cloud=CloudConfig(**CLOUD))
    space = env.observation_space
    assert space["cloud"].shape == (200, 3)
    assert np.abs(space["cloud"].high).max() == HORIZON
    assert space.contains(env.reset(seed=1)[0])
    assert all(space.contains(env.step(GO)[0]) for _ in range(5))
    for without in (CADEnv(), CADEnv(cloud=None)):
        assert not {"cloud", "cloud_mask"} & {*without.observation_space, *without.reset(seed=1)[0]}
    asked = gym.make_vec("CADLeftTurn-v0", 2, vectorization_mode="vector_entry_point", cloud=CLOUD)
    assert asked.observation_space.contains(asked.reset(seed=1)[0])


def test_what_cannot_be_shared_is_refused_with_one_line():
    for wrong in ({"azimuth": 3}, {"beams": 0}, {"beams": 2.5}, {"merged": True}, {"codec": 3}, "raw", 7):
        with pytest.raises(ValueError, match="cloud") as caught:
            setup_from({"cloud": wrong})
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="sensor range with clouds"):
        setup_from({"cloud": {}, "sensor": {"range": 400.0}})
    with pytest.raises(ValueError, match="cloud is for one ego"):
        CADParallelEnv(cloud=CLOUD)
    with pytest.raises(ValueError, match="clouds of one shape"):
        SceneBatch([Setup(), replace(Setup(), cloud=CloudConfig())])
    env = CADEnv(cloud=CLOUD)
    with pytest.raises(ValueError, match="cannot change later"):
        env.reset(options={"config": {"cloud": None}})
    env.reset(options={"config": {"radio": "cv2x"}})
