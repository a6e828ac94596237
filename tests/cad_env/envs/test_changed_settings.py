"""Settings that change while an environment is in use: what counts from when on, and what is refused."""

import re
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scenes import Twitchy

from cad_env import SensorConfig, parallel_env
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.lidar.config import CloudConfig
from cad_env.rendering.framing import screen
from cad_env.scenarios import SCENARIOS
from cad_env.simulation.setup import Setup, setup_from
from cad_env.types import BRAKE, GO

CHANGES: list[tuple[str, Any]] = [
    ("radio", "none"),
    ("radio", {"rate": 1e5, "delay": 0.3}),
    ("traffic", "dense"),
    ("scenario", "overtaking"),
    ("scenario", SCENARIOS["street_crossing"]),
    ("depth", 2),
    ("penetration", 0.5),
    ("sensor", SensorConfig(noise=2.0)),
    ("sensor", {"miss": 0.5}),
    ("ranges", {"empty_share": 1.0, "ego_speed": [8.0, 8.0]}),
    ("share", lambda graph: None),
]


def played(env: gym.Env) -> list[bytes]:
    """What there is to see in the first steps of one episode."""
    seen, policy = [env.reset(seed=3)[0]], Twitchy()
    for _ in range(8):
        seen.append(env.step(policy.act(seen[-1]))[0])
    return [b"".join(part.tobytes() for part in one.values()) for one in seen]


@pytest.mark.parametrize(("name", "value"), CHANGES)
def test_what_is_written_into_config_counts_from_the_next_reset_on(name: str, value: Any):
    env, usual = gym.make("CADLeftTurn-v0"), played(CADEnv())
    assert played(env) == usual
    env.unwrapped.config[name] = value
    fresh = CADEnv(**{name: value})
    assert played(env) == played(fresh) != usual
    assert env.unwrapped.simulation.setup == fresh.simulation.setup
    assert {**env.unwrapped.config, name: 0} == {**fresh.config, name: 0}  # the screen suits the scenario
    del env.unwrapped.config[name]
    assert played(env) == usual
    assert env.unwrapped.simulation.setup == CADEnv().simulation.setup


def test_until_the_reset_the_episode_goes_on_as_it_began():
    env, usual = CADEnv(), CADEnv()
    for each in (env, usual):
        each.reset(seed=3, options={"hazard": True})  # whose time is a number
    env.config["radio"] = "none"
    one, other = env.step(GO), usual.step(GO)
    assert one[4] == other[4]
    assert one[4]["bytes_sent"] > 0


def test_a_change_inside_a_setting_counts_too():
    ranges = {"ego_speed": [8.0, 8.0]}
    env = CADEnv(config={"ranges": ranges, "radio": {"loss": 0.0}})
    env.reset(seed=3)
    env.config["ranges"]["ego_speed"][:] = [9.0, 9.0]
    env.config["radio"]["loss"] = 0.9
    assert env.simulation.setup.ranges == {"ego_speed": (8.0, 8.0)}
    env.reset(seed=3)
    assert env.simulation.setup == setup_from({"ranges": {"ego_speed": (9.0, 9.0)}, "radio": {"loss": 0.9}})
    assert env.simulation.world.target_speed[0] == 9.0


def test_a_setup_has_ranges_of_its_own():
    given: dict[str, Any] = {"ego_speed": [8.0, 8.0]}
    setup = Setup(ranges=given)
    given["ego_speed"][0] = 7.0
    given["radoi"] = 1
    assert setup.ranges == {"ego_speed": (8.0, 8.0)}


@pytest.mark.parametrize("as_a_dict", [True, False])
def test_config_may_be_replaced_as_a_whole(as_a_dict: bool):
    env = CADEnv(radio="none")
    env.reset(seed=3)
    env.config = {"traffic": "dense"} if as_a_dict else {**env.config, "traffic": "dense"}
    assert played(env) == played(CADEnv(traffic="dense", **({} if as_a_dict else {"radio": "none"})))
    assert env.config["policy_frequency"] == 10


WRONG = [
    ("radoi", "none", "unknown setting radoi='none': choose among"),
    ("radio", "5g", "unknown radio '5g': choose one of"),
    ("policy_frequency", 5, "policy_frequency is 10 in this environment, got 5"),
    ("observation", {"type": "Kinematics"}, "observation is {'type': 'SpatiotemporalGraph'} in this environment"),
    ("depth", 0, "depth must be a whole number from 1 to 15, got 0"),
    ("ranges", {"ego_sped": 1}, "unknown left_turn range ego_sped=1"),
    ("scenario", "right_turn", "unknown scenario 'right_turn'"),
    ("layers", ("x-ray",), "x-ray"),
    ("reward", "points", "reward must be a function of a StepOutcome or one of progress, safety-first"),
    ("cloud", CloudConfig(), "cloud is a part of the observation and cannot change later"),
]


@pytest.mark.parametrize(("name", "value", "complaint"), WRONG)
def test_what_is_wrong_in_config_is_refused_by_name_until_it_is_right(name: str, value: Any, complaint: str):
    env = CADEnv()
    env.reset(seed=0)
    kept = env.config.get(name)
    env.config[name] = value
    for _ in range(2):
        with pytest.raises(ValueError, match=re.escape(complaint)) as refusal:
            env.reset(seed=0)
        assert "\n" not in str(refusal.value)
    env.config[name] = kept
    if kept is None:
        del env.config[name]
    assert played(env) == played(CADEnv())


def test_what_changes_no_episode_throws_none_away():
    env, usual = CADEnv(render_mode="rgb_array"), CADEnv()
    for each in (env, usual):
        each.reset(seed=3)
        each.step(GO)
    simulation = env.simulation
    env.configure({"screen_width": 400, "layers": (), "object_lists": True, "radio": "dsrc", "depth": 15})
    assert env.simulation is simulation
    assert env.step(BRAKE)[1:4] == usual.step(BRAKE)[1:4]
    env.reset(seed=3)
    assert env.simulation is simulation
    env.close()


def test_after_another_thing_is_to_be_simulated_reset_comes_first():
    env = CADEnv(render_mode="rgb_array")
    env.reset(seed=3)
    env.step(GO)
    env.configure({"radio": "none"})
    for act in (lambda: env.step(GO), env.render, env.truth, env.object_lists):
        with pytest.raises(gym.error.ResetNeeded, match=re.escape("no episode has begun: call reset() first")):
            act()
    env.reset(seed=3)
    assert env.step(GO)[4]["bytes_sent"] == 0
    env.close()


@pytest.mark.parametrize(
    "act",
    [
        lambda: parallel_env().state(),
        lambda: parallel_env().truth("cav_0"),
        lambda: parallel_env(render_mode="rgb_array").render(),
        lambda: CADVectorEnv(2).step(np.zeros(2, int)),
        lambda: CADVectorEnv(2).batch.step(np.arange(2), np.zeros(2, int)),
        lambda: next(CADVectorEnv(2).batch.truths(np.arange(2)).each()),
        lambda: CADVectorEnv(2).batch.simulations[1].observation(0),
        lambda: CADVectorEnv(2).batch.simulations[1].steps,
    ],
)
def test_before_the_first_reset_it_is_what_is_asked_for(act: Callable[[], Any]):
    with pytest.raises(gym.error.ResetNeeded, match="reset") as refusal:
        act()
    assert "\n" not in str(refusal.value)


def test_a_simulation_has_no_other_names_than_its_own():
    with pytest.raises(AttributeError, match="'Simulation' object has no attribute 'wrold'"):
        CADEnv().simulation.wrold  # noqa: B018


def size_of(scenario: str) -> tuple[int, int]:
    suited = screen(SCENARIOS[scenario].map)
    return suited["screen_height"], suited["screen_width"]


@pytest.mark.parametrize("by_option", [True, False])
def test_a_picture_has_the_size_that_suits_its_scenario(by_option: bool):
    env, fresh = (CADEnv(render_mode="rgb_array", scenario=name) for name in ("left_turn", "overtaking"))
    for each in (env, fresh):
        each.reset(seed=3)
    assert env.render().shape[:2] == size_of("left_turn")
    if by_option:
        env.reset(seed=3, options={"config": {"scenario": "overtaking"}})
    else:
        env.config["scenario"] = "overtaking"
        env.reset(seed=3)
    assert env.render().shape[:2] == size_of("overtaking") != size_of("left_turn")
    assert (env.render() == fresh.render()).all()
    env.close()
    fresh.close()


def test_a_screen_of_the_user_s_stays_whatever_the_scenario():
    env = CADEnv(render_mode="rgb_array", config={"screen_width": 400})
    env.reset(seed=3, options={"config": {"scenario": "overtaking"}})
    assert env.render().shape[:2] == (size_of("overtaking")[0], 400)
    env.config["screen_height"], env.config["scaling"] = 200, 2.0
    image = env.render()
    assert image.shape[:2] == (200, 400)
    env.config["scaling"] = 4.0
    assert (env.render() != image).any()
    env.close()


def test_a_reset_without_changes_says_nothing_and_builds_nothing():
    env = CADEnv(ranges={"ego_speed": [8.0, 9.0]}, sensor={"noise": 0.3}, cloud={"azimuths": 64, "beams": 2})
    simulation, before = env.simulation, dict(env.config)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env.reset(seed=1)
    assert env.simulation is simulation
    assert env.config == before
