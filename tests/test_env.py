"""The single-agent environment: outcomes, what info says, highway-env's face, and what is refused."""

import math
import re

import gymnasium as gym
import numpy as np
import pytest
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import RoadNetwork
from scenes import Steady, Twitchy

from cad_env import RADIO_PRESETS, RadioConfig, SensorConfig
from cad_env.env import CADEnv
from cad_env.planner import Expert
from cad_env.rollout import rollout
from cad_env.types import BRAKE, GO
from cad_env.world.state import OFF

HAZARDS = range(1_000_000, 1_000_005)
INFO = {
    "seed", "hazard", "speed", "crashed", "outcome", "is_success", "min_ttc", "bytes_sent", "bytes_received",
    "largest_message", "messages_sent", "messages_lost", "refused", "hazard_timing",
}  # fmt: skip


def last_step(env: CADEnv, action: int, seed: int, hazard: bool | None = None) -> tuple:
    """(steps, rewards, terminated, truncated, info) of an episode of the same action."""
    env.reset(seed=seed, options={"hazard": hazard})
    rewards = []
    while True:
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        if terminated or truncated:
            return len(rewards), rewards, terminated, truncated, info


@pytest.mark.parametrize("seed", HAZARDS)
def test_never_braking_in_a_hazard_ends_in_a_collision(seed: int):
    steps, rewards, terminated, truncated, info = last_step(CADEnv(), GO, seed, hazard=True)
    assert (terminated, truncated) == (True, False)
    assert (info["outcome"], info["crashed"], info["is_success"]) == ("collision", True, False)
    assert info["min_ttc"] == 0.0
    assert -1.0 < rewards[-1] < -0.9
    assert 0.0 < sum(rewards) + 1.0 < 1.0
    assert 20 < steps < 100


@pytest.mark.parametrize("seed", HAZARDS)
def test_arriving_ends_in_success_and_pays_two_in_all(seed: int):
    _, rewards, terminated, truncated, info = last_step(CADEnv(), GO, seed, hazard=False)
    assert (terminated, truncated) == (True, False)
    assert (info["outcome"], info["crashed"], info["is_success"]) == ("success", False, True)
    assert sum(rewards) == pytest.approx(2.0, abs=0.05)  # the whole way, and arriving
    assert min(rewards) >= 0.0


def test_standing_ends_in_a_timeout_after_exactly_300_steps():
    steps, rewards, terminated, truncated, info = last_step(CADEnv(), BRAKE, 0)
    assert steps == 300
    assert (terminated, truncated) == (False, True)
    assert (info["outcome"], info["crashed"], info["is_success"]) == ("timeout", False, False)
    assert rewards[-1] == 0.0


def test_the_expert_succeeds_where_never_braking_collides():
    env = CADEnv()
    episodes = [rollout(env, Expert(), seed, hazard=True) for seed in HAZARDS]
    assert [episode.outcome for episode in episodes] == ["success"] * len(HAZARDS)
    assert all(episode.min_ttc > 0.0 for episode in episodes)


def test_until_the_end_no_outcome_is_given():
    env = CADEnv()
    _, info = env.reset(seed=0)
    assert (info["outcome"], info["is_success"], info["crashed"]) == (None, False, False)
    *_, terminated, truncated, info = env.step(GO)
    assert (terminated, truncated, info["outcome"]) == (False, False, None)


def test_info_holds_plain_numbers_under_known_names():
    env = CADEnv()
    for info in (env.reset(seed=0)[1], env.step(GO)[-1]):
        assert set(info) == INFO
        assert all(isinstance(value, int | float | bool | str | None) for value in info.values())
    assert info["seed"] == 0
    assert info["bytes_sent"] > 0
    assert info["messages_sent"] == len(env.simulation.agents)


def test_min_ttc_only_falls_and_starts_at_infinity_on_a_free_road():
    env = CADEnv()
    _, info = env.reset(seed=HAZARDS[0], options={"hazard": True})
    history = [info["min_ttc"]]
    while info["outcome"] is None:
        *_, info = env.step(GO)
        history.append(info["min_ttc"])
    assert (np.diff([min(t, 99.0) for t in history]) <= 0.0).all()
    assert history[-1] == 0.0


@pytest.mark.parametrize("hazard", [True, False])
def test_the_kind_of_an_episode_can_be_forced(hazard: bool):
    env = CADEnv()
    assert all(env.reset(seed=seed, options={"hazard": hazard})[1]["hazard"] is hazard for seed in range(10))


def test_without_a_seed_resets_differ_and_follow_the_last_seed():
    env, again = CADEnv(), CADEnv()
    seeds = []
    for one in (env, again):
        one.reset(seed=7)
        seeds.append([one.reset()[1]["seed"] for _ in range(5)])
    assert seeds[0] == seeds[1]
    assert len(set(seeds[0])) == 5


def test_a_message_over_the_budget_is_refused_whole_and_info_says_why():
    env = CADEnv(radio=RadioConfig(rate=8.0))
    env.reset(seed=0)
    *_, info = env.step(GO)
    assert info["refused"] == "over the byte budget of its slot"
    assert info["bytes_sent"] == info["bytes_received"] == info["messages_sent"] == 0
    *_, info = CADEnv(radio="ideal").reset(seed=0)
    assert info["refused"] is None


def test_messages_are_lost_at_the_rate_of_the_radio():
    env, lost, heard = CADEnv(radio=RadioConfig(loss=0.3, range=1e6)), 0, 0
    for seed in range(4):
        episode = rollout(env, Steady(BRAKE), seed)
        lost += int(episode.messages_lost.sum())
        heard += 300 * (len(env.simulation.agents) - 1)
    assert abs(lost / heard - 0.3) < 5 * math.sqrt(0.3 * 0.7 / heard)


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


def test_object_lists_are_what_each_vehicle_tracks_itself():
    env = CADEnv(sensor={"noise": 0.0, "miss": 0.0})
    env.reset(seed=1)
    for _ in range(5):
        env.step(BRAKE)
    lists, fleet = env.object_lists(), env.simulation.fleet
    assert len(lists) == len(env.simulation.agents)
    for vehicle, places in enumerate(lists):
        visible = env.simulation.world.position[fleet.visible[vehicle]]
        assert len(places) >= len(visible) - 1
        for place in places:
            assert np.linalg.norm(visible - place[:2], axis=1).min() < 0.3


def test_two_environments_in_one_process_leave_each_other_alone():
    def drive(env: CADEnv, other: CADEnv | None) -> list[float]:
        observation, _ = env.reset(seed=11)
        policy, seen = Twitchy(), []
        for _ in range(60):
            if other is not None:
                if other.done if hasattr(other, "done") else True:
                    other.reset()
                other.step(BRAKE)
            observation, reward, *_ = env.step(policy.act(observation))
            seen += [reward, float(observation["tracks"].sum()), float(observation["odometry"].sum())]
            if env.done:
                break
        return seen

    alone = drive(CADEnv(), None)
    other = CADEnv(radio="none", sensor={"noise": 3.0}, ranges={"ego_speed": (12.0, 12.0)})
    other.reset(seed=5)
    assert drive(CADEnv(), other) == alone


@pytest.mark.parametrize(
    "action", [2, -1, 0.5, math.nan, math.inf, "go", None, True, np.True_, [0], np.array([1]), np.zeros(2), {}]
)
def test_an_action_that_is_none_is_refused_and_changes_nothing(action):
    env = CADEnv()
    env.reset(seed=0)
    before = env.simulation.world.position.copy()
    with pytest.raises(ValueError, match=re.escape("action must be 0 (go) or 1 (brake), got")):
        env.step(action)
    assert env.simulation.steps == 0
    assert (env.simulation.world.position == before).all()
    env.step(GO)


@pytest.mark.parametrize("action", [0, 1, np.int8(1), np.int64(0), np.array(1), 1.0])
def test_whole_numbers_of_any_kind_are_actions(action):
    env = CADEnv()
    env.reset(seed=0)
    env.step(action)
    assert env.simulation.world.command[0, -1] == int(action)


def test_a_step_after_the_end_is_refused():
    env = CADEnv()
    last_step(env, GO, HAZARDS[0], hazard=True)
    with pytest.raises(RuntimeError, match=re.escape("the episode is over: call reset()")):
        env.step(GO)
    env.reset(seed=0)
    env.step(GO)


def test_a_step_before_the_first_reset_is_refused():
    with pytest.raises(gym.error.ResetNeeded):
        gym.make("CADLeftTurn-v0").step(GO)


WRONG = [
    ({"radoi": "dsrc"}, "unknown option radoi='dsrc': choose among"),
    ({"config": {"radoi": "dsrc"}}, "unknown setting radoi='dsrc': choose among"),
    ({"config": {"duration": 10}}, "unknown setting duration=10"),
    ({"config": {"policy_frequency": 5}}, "policy_frequency is 10 in this environment, got 5"),
    ({"config": {"observation": {"type": "Kinematics"}}}, "observation is {'type': 'SpatiotemporalGraph'}"),
    ({"radio": "5g"}, "unknown radio '5g': choose one of none, ideal, dsrc, cv2x or give a RadioConfig"),
    ({"radio": {"rat": 1.0}}, "unknown radio setting rat=1.0: choose among delay, loss, range, rate"),
    ({"radio": {"loss": 2.0}}, "radio loss must be a number from 0 to 1, got 2.0"),
    ({"radio": 5}, "unknown radio 5"),
    ({"radio": None}, "unknown radio None"),
    ({"radio": ["dsrc"]}, "unknown radio ['dsrc']"),
    ({"sensor": {"rnage": 1.0}}, "unknown sensor setting rnage=1.0: choose among gnss_noise, gnss_yaw_noise"),
    ({"sensor": {"miss": -0.1}}, "sensor miss must be a number from 0 to 1, got -0.1"),
    ({"sensor": 80.0}, "sensor must be a SensorConfig or a dict of its settings, got 80.0"),
    ({"ranges": {"ego_sped": 1}}, "unknown left_turn range ego_sped=1: choose among"),
    ({"traffic": "heavy"}, "traffic must be one of none, light, dense, got 'heavy'"),
    ({"penetration": 2}, "penetration must be a number from 0 to 1, got 2"),
    ({"depth": 0}, "depth must be a number from 1 to 15, got 0"),
    ({"depth": 16}, "depth must be a number from 1 to 15, got 16"),
    ({"depth": 2.5}, "depth must be a whole number, got 2.5"),
    ({"depth": "15"}, "depth must be a number from 1 to 15, got '15'"),
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


def test_object_lists_are_in_info_when_asked_for():
    env = CADEnv(object_lists=True)
    _, info = env.reset(seed=2)
    assert len(info["object_lists"]) == len(env.simulation.agents)
    assert "object_lists" not in CADEnv().reset(seed=2)[1]
