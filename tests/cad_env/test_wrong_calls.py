"""What is called wrongly is refused in one line; what numpy, a path or a large seed says rightly is taken."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from cad_env import CADEnv, CADVectorEnv, CloudConfig, RadioConfig, SensorConfig, parallel_env
from cad_env.envs.fixed_agents import FixedAgents
from cad_env.rules.planner import PlannerConfig
from cad_env.scoring.fleet import rollout_fleet
from cad_env.scoring.rollout import play_episodes, rollout, rollouts
from cad_env.simulation.batch import SceneBatch
from cad_env.simulation.setup import Setup, setup_from
from cad_env.types import GO


class Going:
    """A policy that always goes."""

    privileged = False

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Any) -> int:
        """GO."""
        return GO


def stepped(env: Any, actions: Any) -> None:
    """A reset, and a step with these actions."""
    env.reset(seed=0)
    env.step(actions)


def make(**options: Any) -> gym.Env:
    return gym.make("CADLeftTurn-v0", **options)


def make_vec(**options: Any) -> Any:
    return gym.make_vec("CADLeftTurn-v0", num_envs=2, **options)


NOT_THE_ID = "CADLeftTurn-v0 is the scenario left_turn, got scenario='overtaking': use CADScenario-v0"
NO_SEEDS = [
    (1.5, "1.5"), ("a", "'a'"), (-1, "-1"), (True, "True"), (np.float64(3.0), "np.float64(3.0)"),
    (np.bool_(True), "np.True_"), (np.int64(-1), "np.int64(-1)"), (None, "None"), (1j, "1j"), ("12", "'12'"),
]  # fmt: skip
Call = Callable[[], Any]
CALLS: list[tuple[Call, type[Exception], str]] = [
    # Another scenario under the id of one.
    (lambda: make(scenario="overtaking"), ValueError, NOT_THE_ID),
    (lambda: make_vec(scenario="overtaking"), ValueError, NOT_THE_ID),
    (lambda: make_vec(scenario=["left_turn", "overtaking"]), ValueError, NOT_THE_ID),
    (lambda: make_vec(scenario="overtaking", vectorization_mode="sync"), ValueError, NOT_THE_ID),
    (lambda: parallel_env("CADLeftTurn-v0", scenario="overtaking"), ValueError, NOT_THE_ID),
    (lambda: make(config={"scenario": "overtaking"}), ValueError, "scenario is given twice, as 'left_turn' and in con"),
    (lambda: CADEnv(radio="dsrc", config={"radio": "none"}), ValueError, "radio is given twice, as 'dsrc' and in conf"),
    # Steps before a reset, and what is no action.
    (lambda: CADEnv().step(GO), gym.error.ResetNeeded, "call reset() before step()"),
    (lambda: CADVectorEnv(2).step([GO, GO]), gym.error.ResetNeeded, "Cannot step before the first reset()"),
    (lambda: parallel_env().step({}), RuntimeError, "call reset() before step()"),
    (lambda: stepped(CADEnv(), [[0], [0, 1]]), ValueError, "action must be 0 (go) or 1 (brake), got [[0], [0, 1]]"),
    (lambda: stepped(CADVectorEnv(2), [[0], [0, 1]]), ValueError, "actions must be 2 times 0 (go) or 1 (brake), got"),
    (lambda: stepped(parallel_env(), None), ValueError, "actions must be a dict with one for each of ['cav_0'"),
    (lambda: stepped(parallel_env(), [0, 0, 0, 0]), ValueError, "actions must be a dict with one for each of ['cav_0'"),
    # Options of a reset.
    (lambda: CADEnv().reset(options=3), ValueError, "options must be a dict of reset options (hazard, config), got 3"),
    (lambda: CADEnv().reset(options=0), ValueError, "options must be a dict of reset options (hazard, config), got 0"),
    (lambda: CADVectorEnv(2).reset(options=3), ValueError, "options must be a dict of reset options (hazard, reset_ma"),
    (lambda: parallel_env().reset(options=[]), ValueError, "options must be a dict of reset options (hazard, options"),
    (lambda: FixedAgents(parallel_env()).reset(options=3), ValueError, "options must be a dict of reset options"),
    (lambda: CADEnv().reset(options={"config": 3}), ValueError, "config must be a dict of settings, got 3"),
    (
        lambda: CADVectorEnv(2).reset(options={"reset_mask": [True, False]}),
        ValueError, "options['reset_mask'] must be a numpy array of bools, got [True, False]",
    ),
    (lambda: CADVectorEnv(2).reset(seed=[1]), ValueError, "seed must be one number or a list of 2, got [1]"),
    (lambda: CADVectorEnv(2).reset(seed=[5, -1]), ValueError, "seed must be a whole number from 0 on, got -1"),
    (lambda: CADVectorEnv(2).reset(seed={1: 2, 3: 4}), ValueError, "seed must be a whole number from 0 on, got {1"),
    # Settings.
    (lambda: CADEnv(config=3), ValueError, "config must be a dict of settings, got 3"),
    (lambda: CADEnv(config=0), ValueError, "config must be a dict of settings, got 0"),
    (lambda: CADEnv(config={"screen_width": "x"}), ValueError, "screen_width must be a whole number from 1 to 16384"),
    (lambda: CADEnv(config={"screen_height": -4}), ValueError, "screen_height must be a whole number from 1 to 16384"),
    (lambda: CADEnv(config={"scaling": 0}), ValueError, "scaling must be a number from 0.01 to 1000, got 0"),
    (lambda: CADEnv(config={"centering_position": 3}), ValueError, "centering_position must be a pair of shares of th"),
    (lambda: CADEnv(config={"centering_position": [0, "x"]}), ValueError, "centering_position must be a number from "),
    (lambda: CADEnv(config={"real_time_rendering": "no"}), ValueError, "real_time_rendering must be True or False, go"),
    (lambda: CADEnv(object_lists="yes"), ValueError, "object_lists must be True or False, got 'yes'"),
    (lambda: CADEnv(layers=[["sight"]]), ValueError, "unknown layer ['sight']: choose among"),
    (lambda: CADEnv(depth=3.0), ValueError, "depth must be a whole number from 1 to 15, got 3.0"),
    (lambda: CADEnv(depth=np.int64(16)), ValueError, "depth must be a whole number from 1 to 15, got np.int64(16)"),
    (lambda: CADEnv(penetration=np.float32(2)), ValueError, "penetration must be a number from 0 to 1, got np.float"),
    (lambda: CADEnv(sensor={"range": np.array(9.0)}), ValueError, "sensor range must be a number from 1 to 500, got a"),
    (lambda: CADEnv(ranges=None), ValueError, "ranges must be a dict of the scenario's ranges, got None"),
    (lambda: CADEnv(ranges={"ego_speed": np.ones(3)}), ValueError, "ego_speed must be a pair (from, to) within [1"),
    (lambda: CADEnv(ranges={"collaborators": True}), ValueError, "collaborators must be a pair (from, to) within"),
    (lambda: CADEnv(ranges={"collaborators": (3.0, 4)}), ValueError, "collaborators must be a pair of whole numbers, "),
    (lambda: parallel_env(max_cycles=5.0), ValueError, "max_cycles must be a whole number from 1 on, got 5.0"),
    (lambda: parallel_env(team=1.5), ValueError, "team must be a number from 0 to 1, got 1.5"),
    (lambda: parallel_env(waiting="no"), ValueError, "waiting must be True or False, got 'no'"),
    (lambda: parallel_env(ranges=[]), ValueError, "ranges must be a dict of the scenario's ranges, got []"),
    (lambda: CADVectorEnv(True), ValueError, "num_envs must be a whole number from 1 on, got True"),
    (lambda: CADVectorEnv(copy="x"), ValueError, "copy must be True or False, got 'x'"),
    (lambda: CADVectorEnv(copy=1), ValueError, "copy must be True or False, got 1"),
    (lambda: CADVectorEnv(object_lists=None), ValueError, "object_lists must be True or False, got None"),
    (lambda: CADVectorEnv(autoreset_mode=None), ValueError, "autoreset_mode must be one of NextStep, SameStep, Disabl"),
    (lambda: CADVectorEnv(2, scenario=3), ValueError, "unknown scenario 3: choose among left_turn"),
    (lambda: CADVectorEnv(2, scenario=None), ValueError, "unknown scenario None: choose among left_turn"),
    (lambda: CADVectorEnv(2, scenario=["overtaking", None]), ValueError, "unknown scenario None: choose among left"),
    (lambda: CloudConfig(azimuths=10**9), ValueError, "cloud azimuths must be a whole number from 8 to 8192, got 10"),
    (lambda: CloudConfig(beams=1.0), ValueError, "cloud beams must be a whole number from 1 to 128, got 1.0"),
    (lambda: CloudConfig(merged=10**9), ValueError, "cloud merged must be a whole number from 1 to 65536, got 10000"),
    (lambda: CloudConfig(azimuths="x", beams=None), ValueError, "cloud azimuths must be a whole number from 8 to 819"),
    (lambda: PlannerConfig(margin="x"), ValueError, "margin must be a number from 0 to 5, got 'x'"),
    # Misspelt names of settings records: TypeError is what Python itself would raise.
    (lambda: RadioConfig(los=1), (TypeError, ValueError), "unknown radio setting los=1: choose among burst, dela"),
    (lambda: SensorConfig(rnage=1), (TypeError, ValueError), "unknown sensor setting rnage=1: choose among class_e"),
    (lambda: CloudConfig(beam=1), (TypeError, ValueError), "unknown cloud setting beam=1: choose among azimuths, bea"),
    (lambda: Setup(radoi=1), (TypeError, ValueError), "unknown option radoi=1: choose among cloud, codec, coverage, d"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "kind", "words"), CALLS, ids=[words for _, _, words in CALLS])
def test_a_wrong_call_is_refused_in_one_line(call: Call, kind: Any, words: str):
    with pytest.raises(kind) as refusal:
        call()
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("seed", "said"), NO_SEEDS)
def test_what_is_no_seed_is_refused_alike_everywhere(seed: Any, said: str):
    complaint = f"seed must be a whole number from 0 on, got {said}"
    batch = SceneBatch([setup_from({})])
    calls: list[Call] = [
        lambda: rollout(CADEnv(), Going(), seed), lambda: next(rollouts(CADVectorEnv(1), Going(), [seed])),
        lambda: rollout_fleet(parallel_env(), Going(), seed), lambda: batch.start(0, seed),
        lambda: next(play_episodes(batch, [seed], lambda which, _: which)),
    ]  # fmt: skip
    if seed is not None:  # by which a reset goes on from the last
        calls += [
            lambda: CADEnv().reset(seed=seed), lambda: parallel_env().reset(seed=seed),
            lambda: FixedAgents(parallel_env()).reset(seed=seed), lambda: CADVectorEnv(2).reset(seed=seed),
            lambda: CADVectorEnv(2).reset(seed=[0, seed]), lambda: make().reset(seed=seed),
        ]  # fmt: skip
    for call in calls:
        with pytest.raises(ValueError) as refusal:  # noqa: PT011  the text is compared below
            call()
        assert str(refusal.value) == complaint


def test_a_refused_reset_changes_nothing():
    env, envs = CADEnv(), CADVectorEnv(2)
    env.reset(seed=3)
    envs.reset(seed=[3, 4])
    with pytest.raises(ValueError, match="seed must be"):
        envs.reset(seed=[5, -1])
    with pytest.raises(ValueError, match="hazard must be"):
        env.reset(seed=4, options={"hazard": "yes"})
    assert env.step(GO)[4]["seed"] == 3
    assert envs.step([GO, GO])[4]["seed"].tolist() == [3, 4]


@pytest.mark.parametrize("seed", [0, 2**31, 2**63 - 2, 2**63 - 1, 2**63, 2**64, 2**70, 10**400])
def test_any_whole_number_from_0_on_is_a_seed(seed: int):
    observation, info = CADEnv().reset(seed=seed)
    envs = CADVectorEnv(2)
    for seeds in (seed, [seed, seed + 1]):
        several, infos = envs.reset(seed=seeds)
        assert infos["seed"].tolist() == [seed, seed + 1]
        np.testing.assert_array_equal(several["tracks"][0], observation["tracks"])
    assert envs.reset(seed=3)[1]["seed"].tolist() == [3, 4]
    assert envs.reset()[1]["seed"].max() < 2**31
    assert parallel_env().reset(seed=seed)[1]["cav_0"]["seed"] == info["seed"] == seed


def test_seeds_are_int64_where_they_fit():
    assert CADVectorEnv(2).reset(seed=2**63 - 2)[1]["seed"].dtype == np.int64


@pytest.mark.parametrize("kind", [np.int8, np.int64, np.uint64])
def test_numpy_s_whole_numbers_are_seeds(kind: type):
    for env in (CADEnv(), CADVectorEnv(1), parallel_env()):
        same, first = env.reset(seed=kind(7)), env.reset(seed=7)
        np.testing.assert_equal(same, first)
    seeds = CADVectorEnv(2).reset(seed=np.array([7, 9], kind))[1]["seed"]
    assert seeds.tolist() == [7, 9]


@pytest.mark.parametrize(
    ("numpy_s", "own"),
    [
        ({"depth": np.int64(5)}, {"depth": 5}),
        ({"penetration": np.float32(0.5)}, {"penetration": 0.5}),
        ({"sensor": {"noise": np.float64(0.25)}}, {"sensor": SensorConfig(noise=0.25)}),
        ({"sensor": {"noise": 0}}, {"sensor": SensorConfig(noise=0.0)}),
        ({"radio": {"rate": np.int64(10**6), "delay": np.float32(0.5)}}, {"radio": RadioConfig(1e6, delay=0.5)}),
        ({"radio": {"rate": np.float32("inf")}}, {"radio": {"rate": float("inf")}}),
        ({"cloud": {"beams": np.uint8(4)}}, {"cloud": CloudConfig(beams=4)}),
        ({"ranges": {"collaborators": np.array([3, 4])}}, {"ranges": {"collaborators": (3, 4)}}),
        ({"ranges": {"ego_speed": np.array([7, 8], np.float32)}}, {"ranges": {"ego_speed": (7.0, 8.0)}}),
        ({"ranges": {"ego_speed": [np.int64(7), 8]}}, {"ranges": {"ego_speed": (7, 8)}}),
    ],
)
def test_numpy_s_numbers_are_numbers(numpy_s: dict[str, Any], own: dict[str, Any]):
    setup = CADEnv(**numpy_s).simulation.setup
    assert setup == CADEnv(**own).simulation.setup
    assert type(setup.depth) is int
    for record in (setup.sensor, setup.radio):
        assert {type(value) for value in vars(record).values()} == {float}


def test_numpy_s_bools_are_switches():
    env = CADEnv(object_lists=np.bool_(True), config={"show_trajectories": np.bool_(False)})
    assert "object_lists" in env.reset(seed=0, options={"hazard": np.bool_(True)})[1]
    for made in (env, CADVectorEnv(1, copy=np.bool_(False)), parallel_env()):
        for hazard in (True, False):
            same = made.reset(seed=0, options={"hazard": np.bool_(hazard)})
            np.testing.assert_equal(same, made.reset(seed=0, options={"hazard": hazard}))


def test_the_same_setting_may_be_given_twice():
    env = make(config={"scenario": "left_turn"})
    assert make(config=env.unwrapped.config).unwrapped.config == env.unwrapped.config


def test_an_id_keeps_its_spec():
    assert make().spec.id == make().unwrapped.spec.id == make_vec().spec.id == "CADLeftTurn-v0"
    assert gym.make(make(radio="cv2x").spec).unwrapped.config["radio"] == "cv2x"
    env = gym.make("CADScenario-v0", scenario="overtaking")
    assert env.unwrapped.simulation.scenario.name == "overtaking"
