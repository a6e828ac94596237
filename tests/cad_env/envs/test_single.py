"""The single-agent environment: outcomes, what info says, and which actions are refused."""

import math
import re

import gymnasium as gym
import numpy as np
import pytest
from scenes import Steady, Twitchy

from cad_env import RadioConfig
from cad_env.envs.single import CADEnv
from cad_env.rules.expert import Expert
from cad_env.scoring.rollout import rollout
from cad_env.types import BRAKE, GO, MAX_STEPS

HAZARDS = range(1_000_000, 1_000_005)
INFO = {
    "seed", "hazard", "speed", "crashed", "outcome", "is_success", "min_ttc", "struck_from_behind",
    "bytes_sent", "bytes_received",
    "largest_message", "messages_sent", "messages_lost", "messages_refused", "refused", "hazard_time",
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


def test_standing_ends_in_a_timeout_after_exactly_max_steps():
    steps, rewards, terminated, truncated, info = last_step(CADEnv(), BRAKE, 0)
    assert steps == MAX_STEPS == 400
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
        heard += MAX_STEPS * (len(env.simulation.agents) - 1)
    assert abs(lost / heard - 0.3) < 5 * math.sqrt(0.3 * 0.7 / heard)


def test_object_lists_are_what_each_vehicle_tracks_itself():
    env = CADEnv(sensor={"noise": 0.0, "miss": 0.0})
    env.reset(seed=2)  # one vehicle at the most has come into view just now, and has no track yet
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


def test_object_lists_are_in_info_when_asked_for():
    env = CADEnv(object_lists=True)
    _, info = env.reset(seed=2)
    assert len(info["object_lists"]) == len(env.simulation.agents)
    assert "object_lists" not in CADEnv().reset(seed=2)[1]
