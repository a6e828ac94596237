"""The checks that Gymnasium and Stable-Baselines3 have for environments, with warnings as errors."""

import json
import pickle
import subprocess
import sys
import warnings
from collections.abc import Iterator

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FlattenObservation, RecordEpisodeStatistics, TimeAwareObservation
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as sb3_check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv

import cad_env
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.scenarios import SCENARIOS
from cad_env.types import BRAKE, FRAMES, GO, MAX_STEPS, OBSERVED_TRACKS

ID = "CADLeftTurn-v0"
EVERY_ID = pytest.mark.parametrize("env_id", [scenario.gym_id for scenario in SCENARIOS.values()])

# What Stable-Baselines3 advises for its own networks: an image would be uint8, and a 2-D box is unusual to it.
SHAPE_ADVICE = (
    r"It seems that your observation tracks is an image but its `dtype` is \(float32\) whereas it has to be `np.uint8`",
    r"It seems that your observation space tracks is an image but the upper and lower bounds are not in \[0, 255\]",
    r"Your observation (tracks|mask|odometry|route) has an unconventional shape \(neither an image, nor a 1D vector\)",
    r"The minimal resolution for an image is 36x36 for the default `CnnPolicy`",
)


@pytest.fixture
def strictly() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.usefixtures("strictly")
@EVERY_ID
@pytest.mark.parametrize(
    "options",
    [
        {"traffic": "none"},
        {"radio": "none"},
        {"radio": "cv2x", "depth": 3, "sensor": {"noise": 1.0}, "traffic": "dense", "penetration": 0.7},
    ],
)
def test_gymnasium_s_checker_finds_nothing(env_id: str, options: dict):
    check_env(gym.make(env_id, **options).unwrapped)


@EVERY_ID
@pytest.mark.usefixtures("strictly")
def test_gymnasium_s_passive_checker_finds_nothing_in_a_whole_episode(env_id: str):
    env = gym.make(env_id, render_mode="rgb_array")
    env.reset(seed=0)
    ended = False
    while not ended:
        _, _, terminated, truncated, _ = env.step(GO)
        ended = terminated or truncated
    assert env.render().std() > 5.0
    env.close()


@EVERY_ID
@pytest.mark.usefixtures("strictly")
def test_stable_baselines_checker_finds_nothing_in_flat_observations(env_id: str):
    sb3_check_env(FlattenObservation(gym.make(env_id)), warn=True)


@EVERY_ID
@pytest.mark.usefixtures("strictly")
def test_stable_baselines_checker_has_only_its_advice_on_shapes(env_id: str):
    for advice in SHAPE_ADVICE:
        warnings.filterwarnings("ignore", message=advice)
    sb3_check_env(gym.make(env_id), warn=True)
    sb3_check_env(gym.make(env_id).unwrapped, warn=True)


def test_ppo_learns_on_the_natural_observations():
    model = PPO("MultiInputPolicy", make_vec_env(ID, n_envs=2), n_steps=16, batch_size=16, n_epochs=1, device="cpu")
    before = model.policy.state_dict()["action_net.weight"].clone()
    model.learn(64)
    assert (model.policy.state_dict()["action_net.weight"] != before).any()


def test_success_reaches_stable_baselines():
    env = DummyVecEnv([lambda: gym.make(ID)])
    env.seed(1_000_000)
    env.reset()
    for _ in range(300):
        _, _, dones, infos = env.step(np.array([GO]))
        if dones[0]:
            break
    assert dones[0]
    assert infos[0]["is_success"] is (infos[0]["outcome"] == "success")
    assert infos[0]["terminal_observation"]["tracks"].shape == (OBSERVED_TRACKS, FRAMES, 3)


def test_the_name_of_the_package_in_the_id_is_enough():
    program = "import gymnasium as gym; env = gym.make('cad_env:CADLeftTurn-v0'); print(env.reset(seed=0)[1]['seed'])"
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "0"


def test_importing_the_package_is_quick_and_brings_no_torch():
    program = (
        "import sys, cad_env; heavy = {'torch', 'numba', 'pettingzoo', 'highway_env'} & set(sys.modules); print(heavy)"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "set()"


def test_a_spec_goes_through_json_and_pickle_with_its_options():
    spec = gym.make(ID, radio="cv2x", depth=5).spec
    again = EnvSpec.from_json(spec.to_json())
    for copy in (again, pickle.loads(pickle.dumps(spec))):
        env = gym.make(copy)
        assert env.unwrapped.simulation.setup.depth == 5
        assert env.unwrapped.simulation.setup.radio == cad_env.RADIO_PRESETS["cv2x"]
    assert json.loads(spec.to_json())["kwargs"]["depth"] == 5


def test_registering_twice_is_no_error():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        __import__("importlib").reload(cad_env)
    assert gym.spec(ID).kwargs == {"scenario": "left_turn"}


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_gymnasium_s_vectors_are_the_single_environment_side_by_side(mode: str):
    envs = gym.make_vec(f"cad_env:{ID}", num_envs=3, vectorization_mode=mode)
    observations, infos = envs.reset(seed=20)
    history = [(observations, np.zeros(3))]
    actions = [np.array([GO, BRAKE, GO])] * 12
    for action in actions:
        observations, rewards, *_ = envs.step(action)
        history.append(({name: part.copy() for name, part in observations.items()}, rewards))
    envs.close()
    assert infos["seed"].tolist() == [20, 21, 22]
    for k in range(3):
        env = gym.make(ID)
        alone = [(env.reset(seed=20 + k)[0], 0.0)] + [env.step(action[k])[:2] for action in actions]
        for (seen, reward), (together, rewards) in zip(alone, history, strict=True):
            assert reward == rewards[k]
            assert all((seen[name] == together[name][k]).all() for name in seen)


def test_wrappers_of_gymnasium_work():
    env = RecordEpisodeStatistics(gym.make(ID))
    env.reset(seed=1, options={"hazard": False})
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(GO)
        ended = terminated or truncated
    assert info["episode"]["r"] == pytest.approx(2.0, abs=0.05)


def test_a_seeded_action_space_survives_a_reset():
    env = gym.make(ID).unwrapped
    env.action_space.seed(3)
    first = [int(env.action_space.sample()) for _ in range(20)]
    env.action_space.seed(3)
    env.reset(seed=0)
    assert [int(env.action_space.sample()) for _ in range(20)] == first


@pytest.mark.parametrize("env_id", ["CADScenario-v0", *(scenario.gym_id for scenario in SCENARIOS.values())])
def test_a_spec_says_how_many_decisions_an_episode_has(env_id: str):
    assert gym.spec(env_id).max_episode_steps == MAX_STEPS
    options = {"scenario": "left_turn"} if env_id == "CADScenario-v0" else {}
    assert gym.make(env_id, **options).spec.max_episode_steps == MAX_STEPS


def test_gymnasium_s_observation_of_the_time_ends_when_time_is_up():
    env = TimeAwareObservation(gym.make(ID), flatten=False, normalize_time=False)
    observation, _ = env.reset(seed=0)
    assert observation["time"] == 0
    assert observation in env.observation_space
    truncated = False
    while not truncated:
        observation, _, terminated, truncated, _ = env.step(BRAKE)
        assert not terminated
    assert observation["time"] == MAX_STEPS


def waits_then_goes(wait: int) -> Iterator[int]:
    """Brakes so many decisions, and goes until the end."""
    yield from [BRAKE] * wait
    while True:
        yield GO


def flags(env: gym.Env, wait: int) -> list[tuple[bool, bool, str | None]]:
    """(terminated, truncated, outcome) of every decision."""
    env.reset(seed=0, options={"hazard": False})
    found: list[tuple[bool, bool, str | None]] = []
    for action in waits_then_goes(wait):
        _, _, terminated, truncated, info = env.step(action)
        found.append((terminated, truncated, info["outcome"]))
        if terminated or truncated:
            return found
    raise AssertionError


def flags_of_many(envs: gym.vector.VectorEnv, wait: int) -> list[tuple[bool, bool, str | None]]:
    """The same of a vector of one environment."""
    envs.reset(seed=0, options={"hazard": False})
    found: list[tuple[bool, bool, str | None]] = []
    for action in waits_then_goes(wait):
        _, _, terminations, truncations, infos = envs.step(np.array([action]))
        found.append((bool(terminations[0]), bool(truncations[0]), infos["outcome"][0]))
        if found[-1][0] or found[-1][1]:
            return found
    raise AssertionError


@pytest.mark.parametrize(
    ("later", "end"),
    [(-1, (True, False, "success")), (0, (True, True, "success")), (1, (False, True, "timeout"))],
    ids=["before time is up", "in the last decision", "too late"],
)
def test_gymnasium_s_time_limit_changes_nothing(later: int, end: tuple[bool, bool, str]):
    options = {"traffic": "none", "radio": "none", "ranges": {"empty_share": 1.0}}
    early = MAX_STEPS // 2
    wait = early + MAX_STEPS - len(flags(CADEnv(**options), early)) + later  # whoever stands starts the same later on
    expected = flags(CADEnv(**options), wait)
    assert expected[-1] == end
    assert len(expected) == min(MAX_STEPS + later, MAX_STEPS)
    assert set(expected[:-1]) == {(False, False, None)}
    made = gym.make(ID, **options)
    assert flags(made, wait) == expected
    assert flags(gym.make(EnvSpec.from_json(made.spec.to_json())), wait) == expected
    assert flags(gym.make(ID, max_episode_steps=-1, **options), wait) == expected
    assert flags_of_many(CADVectorEnv(1, **options), wait) == expected
    for mode in ("vector_entry_point", "sync"):
        assert flags_of_many(gym.make_vec(ID, num_envs=1, vectorization_mode=mode, **options), wait) == expected
