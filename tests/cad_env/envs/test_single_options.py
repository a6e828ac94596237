"""The settings of the single-agent environment: their spellings, and what is refused."""

import re
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import pytest

from cad_env import RADIO_PRESETS, SensorConfig
from cad_env.envs.parallel import parallel_env
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.types import GO

WRONG = [
    ({"radoi": "dsrc"}, "unknown option radoi='dsrc': choose among"),
    ({"config": {"radoi": "dsrc"}}, "unknown setting radoi='dsrc': choose among"),
    ({"config": {"duration": 10}}, "unknown setting duration=10"),
    ({"config": {"policy_frequency": 5}}, "policy_frequency is 10 in this environment, got 5"),
    ({"config": {"observation": {"type": "Kinematics"}}}, "observation is {'type': 'SpatiotemporalGraph'}"),
    ({"radio": "5g"}, "unknown radio '5g': choose one of none, ideal, dsrc, cv2x or give a RadioConfig"),
    ({"radio": {"rat": 1.0}}, "unknown radio setting rat=1.0: choose among burst, delay, loss, range, rate"),
    ({"radio": {"loss": 2.0}}, "radio loss must be a number from 0 to 1, got 2.0"),
    ({"radio": 5}, "unknown radio 5"),
    ({"radio": None}, "unknown radio None"),
    ({"radio": ["dsrc"]}, "unknown radio ['dsrc']"),
    ({"sensor": {"rnage": 1.0}}, "unknown sensor setting rnage=1.0: choose among class_error, false_alarm, gnss_noise"),
    ({"sensor": {"miss": -0.1}}, "sensor miss must be a number from 0 to 1, got -0.1"),
    ({"sensor": 80.0}, "sensor must be a SensorConfig or a dict of its settings, got 80.0"),
    ({"ranges": {"ego_sped": 1}}, "unknown left_turn range ego_sped=1: choose among"),
    ({"traffic": "heavy"}, "traffic must be one of none, light, dense, got 'heavy'"),
    ({"penetration": 2}, "penetration must be a number from 0 to 1, got 2"),
    ({"depth": 0}, "depth must be a whole number from 1 to 15, got 0"),
    ({"depth": 16}, "depth must be a whole number from 1 to 15, got 16"),
    ({"depth": 2.5}, "depth must be a whole number from 1 to 15, got 2.5"),
    ({"depth": "15"}, "depth must be a whole number from 1 to 15, got '15'"),
    ({"scenario": "right_turn"}, "unknown scenario 'right_turn': choose among left_turn"),
    ({"scenario": ["left_turn"]}, "unknown scenario ['left_turn']"),
    ({"render_mode": "ascii"}, "unknown render_mode 'ascii': choose one of human, rgb_array"),
]


@pytest.mark.parametrize(("options", "complaint"), WRONG)
def test_a_wrong_option_is_refused_by_name_value_and_choices(options: dict, complaint: str):
    with pytest.raises(ValueError, match=re.escape(complaint)) as refusal:
        CADEnv(**options)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("options", "complaint"), WRONG[:1] + WRONG[5:8])
def test_gym_make_passes_the_refusal_on(options: dict, complaint: str):
    with pytest.raises(ValueError, match=re.escape(complaint)):
        gym.make("CADLeftTurn-v0", **options)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"hazrad": True}, "unknown reset option hazrad=True: choose among config, hazard"),
        ({"hazard": 1}, "hazard must be True, False or None, got 1"),
        ({"config": {"radoi": 1}}, "unknown setting radoi=1"),
    ],
)
def test_a_wrong_reset_option_is_refused(options: dict, complaint: str):
    with pytest.raises(ValueError, match=re.escape(complaint)):
        CADEnv().reset(seed=0, options=options)


@pytest.mark.parametrize(
    ("options", "same"),
    [
        ({"radio": RADIO_PRESETS["dsrc"]}, {}),
        ({"radio": {"rate": 7.2e6}}, {"radio": "cv2x"}),
        ({"sensor": {"noise": 1.0}}, {"sensor": SensorConfig(noise=1.0)}),
        ({"config": {"radio": "none", "depth": 3}}, {"radio": "none", "depth": 3}),
        ({"config": None}, {}),
    ],
)
def test_one_setting_has_several_spellings(options: dict, same: dict):
    assert CADEnv(**options).simulation.setup == CADEnv(**same).simulation.setup


def test_a_reset_can_change_settings():
    env = CADEnv()
    env.reset(seed=0, options={"config": {"radio": "none"}})
    *_, info = env.step(GO)
    assert info["bytes_sent"] == 0
    assert env.config["radio"] == "none"


@pytest.mark.parametrize(
    "make",
    [
        lambda **options: gym.make("CADLeftTurn-v0", **options),
        lambda **options: gym.make("cad_env:CADScenario-v0", scenario="overtaking", **options),
        lambda **options: gym.make_vec("CADLeftTurn-v0", **options),
        lambda **options: gym.make_vec("CADLeftTurn-v0", vectorization_mode="sync", **options),
        lambda **options: parallel_env("CADLeftTurn-v0", **options),
        CADEnv,
        CADVectorEnv,
    ],
)
def test_libraries_that_try_a_keyword_learn_that_it_is_unexpected(make: Callable[..., Any]):
    # As TorchRL's GymEnv does: it leaves `frameskip` out if a TypeError says that.
    with pytest.raises(
        TypeError, match=re.escape("__init__() got an unexpected keyword argument 'frameskip'")
    ) as found:
        make(frameskip=1)
    assert isinstance(found.value, ValueError)
    assert "\n" not in str(found.value)
    assert str(found.value).startswith("unknown option frameskip=1: choose among ")
