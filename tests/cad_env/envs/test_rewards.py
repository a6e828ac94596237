"""Rewards from outside: a function of a step, the same in all environments."""

from itertools import pairwise

import numpy as np
import pytest

from cad_env.envs.parallel import CADParallelEnv
from cad_env.envs.rewards import COLLISION_COST, REWARDS, SECOND_COST, StepOutcome, progress
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.types import BRAKE, GO, MAX_STEPS

SEED = 3
FLEET = {"ranges": {"collaborators": (3, 3)}}


def everything(step: StepOutcome) -> float:
    """A number in which all of a step shows."""
    ended = {None: 0.0, "success": 1e3, "collision": 2e3, "timeout": 3e3, "waited": 4e3}[step.outcome]
    return step.action + step.travelled + 10 * step.progress + step.speed + step.time + ended + 1e-3 * step.bytes_sent


def same(step: StepOutcome) -> float:
    """The default, as a function of its own."""
    return progress(step)


@pytest.mark.parametrize("radio", ["none", "dsrc"])
def test_the_default_as_a_function_is_the_default(radio: str) -> None:
    for make in (CADEnv, CADParallelEnv):
        named, own = make(radio=radio), make(radio=radio, reward=same)
        for env in (named, own):
            env.reset(seed=SEED)
        for k in range(300):
            (_, one, terminated, truncated, _), (_, other, *_) = (
                env.step(int(k % 3 == 0) if make is CADEnv else dict.fromkeys(env.agents, GO)) for env in (named, own)
            )
            assert one == other
            if terminated or truncated if make is CADEnv else not named.agents:
                break


def test_a_step_says_what_happened() -> None:
    steps: list[StepOutcome] = []

    def watched(step: StepOutcome) -> float:
        steps.append(step)
        return 0.25

    env = CADEnv(reward=watched, radio="dsrc")
    _, info = env.reset(seed=SEED, options={"hazard": False})
    while info["outcome"] is None:
        _, reward, *_, info = env.step(GO)
        assert reward == 0.25
    assert steps[-1].outcome == "success"
    assert {step.outcome for step in steps[:-1]} == {None}
    assert sum(step.progress for step in steps) == pytest.approx(1.0, abs=0.05)
    assert all(later.time == pytest.approx(step.time + 0.1) for step, later in pairwise(steps))
    assert {step.action for step in steps} == {GO}
    assert {step.hazard for step in steps} == {False}
    assert steps[-1].min_ttc == info["min_ttc"]
    assert all(later.min_ttc <= step.min_ttc for step, later in pairwise(steps))
    assert 0 < steps[20].bytes_sent < info["bytes_sent"] + 1
    assert steps[20].travelled == pytest.approx(0.1 * steps[20].speed, rel=0.1)
    env.reset(seed=SEED)
    env.step(BRAKE)
    assert steps[-1].action == BRAKE


def test_the_least_time_to_contact_of_every_agent_is_its_own() -> None:
    least: dict[type, list[float]] = {CADEnv: [], CADParallelEnv: []}
    env = CADEnv(reward=lambda step: least[CADEnv].append(step.min_ttc) or 0.0, **FLEET)
    _, info = env.reset(seed=SEED, options={"hazard": True})
    while info["outcome"] is None:
        _, _, _, _, info = env.step(GO)
    fleet = CADParallelEnv(waiting=True, reward=lambda step: step.min_ttc, ranges=FLEET["ranges"])
    fleet.reset(seed=SEED, options={"hazard": True})
    differs = False
    while "cav_0" in fleet.agents:
        _, rewards, *_ = fleet.step(dict.fromkeys(fleet.agents, GO))
        least[CADParallelEnv].append(rewards["cav_0"])
        differs |= len(set(rewards.values())) > 1
    assert least[CADEnv] == least[CADParallelEnv]
    assert least[CADEnv][-1] == info["min_ttc"] < 1.0
    assert differs


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_side_by_side_it_is_as_alone(mode: str) -> None:
    envs = CADVectorEnv(2, mode, reward=everything)
    alone = [CADEnv(reward=everything) for _ in range(2)]
    envs.reset(seed=SEED)
    for place, env in enumerate(alone):
        env.reset(seed=SEED + place)
    going = [True, True]
    for k in range(MAX_STEPS):
        action = int(k % 7 == 0)
        rewards = envs.step(np.full(2, action))[1]
        for place, env in enumerate(alone):
            if going[place]:
                _, reward, terminated, truncated, _ = env.step(action)
                assert rewards[place] == reward
                going[place] = not (terminated or truncated)
        if not any(going):
            break
    assert not any(going)


def test_a_wrong_reward_is_refused() -> None:
    for make in (CADEnv, CADParallelEnv, CADVectorEnv):
        with pytest.raises(
            ValueError, match=r"reward must be a function of a StepOutcome or one of progress, .*, got 'fast'"
        ):
            make(reward="fast")


def ended(outcome: str | None) -> StepOutcome:
    """A step on which a quarter of the way was covered."""
    return StepOutcome(GO, 5.0, 0.25, 8.0, 3.0, outcome, True, 4.0, 100)


def test_named_rewards_pay_what_they_say() -> None:
    assert [REWARDS["progress"](ended(outcome)) for outcome in (None, "success", "collision", "timeout")] == [
        0.25, 1.25, -0.75, 0.25,
    ]  # fmt: skip
    safe = [REWARDS["safety-first"](ended(outcome)) for outcome in (None, "success", "collision", "timeout")]
    assert safe == [0.25, 1.25, 0.25 - COLLISION_COST, 0.25]
    timely = [REWARDS["time-and-safety"](ended(outcome)) for outcome in (None, "success", "collision", "timeout")]
    assert timely == [pay - 0.1 * SECOND_COST for pay in safe]


@pytest.mark.parametrize("name", REWARDS)
def test_all_environments_take_a_reward_by_its_name(name: str) -> None:
    envs, alone = CADVectorEnv(1, reward=name), CADEnv(reward=name)
    fleet, steps = CADParallelEnv(reward=name, ranges=FLEET["ranges"]), []
    watched = CADEnv(reward=lambda step: steps.append(step) or 0.0)
    for env in (envs, alone, fleet, watched):
        env.reset(seed=SEED)
    for action in (GO, BRAKE, GO):
        watched.step(action)
        wanted = pytest.approx(REWARDS[name](steps[-1]), abs=1e-12)
        assert alone.step(action)[1] == wanted
        assert envs.step(np.array([action]))[1][0] == wanted
        assert "cav_0" in fleet.step(dict.fromkeys(fleet.agents, action))[1]
