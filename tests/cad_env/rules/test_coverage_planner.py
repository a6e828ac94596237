"""Rules that wait for whatever nobody vouches for, and only for that."""

import math
from typing import Any

import numpy as np
import pytest

from cad_env.checks import ConfigError
from cad_env.envs.vector import CADVectorEnv
from cad_env.pipeline.observe import as_observation, empty_view
from cad_env.pipeline.observe_lanes import LANE_FEATURES, empty_lane_view
from cad_env.rules.coverage_planner import CoverageConfig, CoveragePlanner
from cad_env.rules.planner import Planner
from cad_env.scenarios import SHIPPED
from cad_env.scoring.rollout import rollouts
from cad_env.types import BRAKE, GO, ROUTE_SPACING, Observation

FAR = 200.0  # m, where nothing is hidden up to there


def lane(reach: float, through: float, hidden: float, time: float) -> dict[str, float]:
    """A lane that crosses the way from the left, `reach` m ahead of the ego's front."""
    return {"x": reach + 4.0, "sin": -1.0, "reach": reach, "through": through, "hidden": hidden, "time": time}


def seen(*lanes: dict[str, float], speed: float = 0.0, coming: float | None = None) -> Observation:
    """A straight way over these lanes; `coming`: m before the first, a car that comes along it at 12 m/s."""
    view, shown = empty_view(), empty_lane_view()
    ages = np.arange(view.odometry.shape[0])[::-1]
    view.odometry[:, 0] = -0.1 * speed * ages
    view.ego[:] = speed, 10.0, 4.8, 1.9
    view.route[:, 0] = ROUTE_SPACING * (1 + np.arange(len(view.route)))
    if coming is not None:
        view.tracks[0, :, 0] = lanes[0]["x"] - view.odometry[:, 0]
        view.tracks[0, :, 1] = coming + 1.2 * ages
        view.mask[0] = 1
    for k, each in enumerate(lanes):
        shown.lane_mask[k] = 1
        shown.lanes[k] = [each.get(name, 0.0) for name in LANE_FEATURES]
    return as_observation(view) | as_observation(shown)


def decided(*lanes: dict[str, float], coming: float | None = None, speed: float = 0.0, **config: Any) -> int:
    return CoveragePlanner(CoverageConfig(**config)).act(seen(*lanes, speed=speed, coming=coming))


def test_without_lanes_it_goes():
    assert decided(speed=8.0) == GO


def test_it_waits_at_the_lane_for_what_could_be_there_before_it_is_through():
    assert decided(lane(0.4, 9.5, 30.0, 1.5)) == BRAKE
    assert decided(lane(0.4, 9.5, FAR, 10.0)) == GO
    # 10 m from a standstill at 2 m/s2 take 3.2 s.
    assert [decided(lane(0.4, 9.5, 70.0, time), spare=0.0) for time in (3.0, 3.5)] == [BRAKE, GO]
    assert [decided(lane(0.4, 9.5, 70.0, 3.5), spare=spare) for spare in (0.0, 1.0)] == [GO, BRAKE]


def test_it_drives_on_while_it_can_still_stop_before_the_lane():
    # From 9 m/s it stops within 8.6 m.
    assert [decided(lane(reach, reach + 9.0, 10.0, 0.5), speed=9.0) for reach in (14.0, 10.0)] == [GO, BRAKE]


def test_it_leaves_a_lane_that_it_is_on():
    assert decided(lane(-2.0, 6.0, 5.0, 0.1), speed=5.0) == GO


def test_it_enters_no_lane_on_which_it_would_have_to_wait_for_the_next():
    busy, hidden = lane(0.4, 9.5, 50.0, 5.0), lane(7.0, 16.0, 5.0, 0.2)
    assert decided(busy) == GO
    assert decided(busy, hidden) == BRAKE
    quiet = lane(0.4, 9.5, 75.0, 5.0)  # what comes there is seen long before
    assert decided(quiet, hidden) == GO
    assert decided(quiet, hidden, coming=80.0) == BRAKE
    assert decided(lane(-3.0, 6.0, 5.0, 0.2), lane(0.4, 9.5, 5.0, 0.2)) == BRAKE


def test_who_is_hidden_behind_a_known_vehicle_comes_after_it():
    # At 12 m/s the known one is there in 5 s, and so is whoever follows it: enough to be through.
    behind = lane(0.4, 9.5, 65.0, 3.0)
    assert decided(behind) == BRAKE
    assert decided(behind, coming=60.0) == GO


@pytest.mark.parametrize("name", ["short", "spare", "watch"])
def test_a_knob_that_is_no_number_is_refused(name: str):
    with pytest.raises(ValueError, match=f"{name} must be a number from"):
        CoverageConfig(**{name: math.nan})


def test_an_observation_without_coverage_is_refused():
    with pytest.raises(ConfigError, match="coverage=True"):
        CoveragePlanner().act(as_observation(empty_view()))


@pytest.mark.parametrize("scenario", SHIPPED)
def test_alone_it_is_safer_than_rules_that_forget_what_is_hidden(scenario: str):
    collided = {}
    for policy in (Planner(), CoveragePlanner()):
        envs = CADVectorEnv(8, scenario=scenario, radio="none", coverage=True)
        episodes = list(rollouts(envs, policy, range(700_000, 700_024), hazard=True))
        collided[type(policy)] = sum(episode.outcome == "collision" for episode in episodes)
    assert collided[CoveragePlanner] <= 1
    assert collided[Planner] >= 8


@pytest.mark.parametrize("scenario", SHIPPED)
def test_with_a_witness_it_arrives_and_does_not_collide(scenario: str):
    envs = CADVectorEnv(8, scenario=scenario, coverage=True)
    outcomes = [episode.outcome for episode in rollouts(envs, CoveragePlanner(), range(700_000, 700_024))]
    assert outcomes.count("collision") <= 1
    assert outcomes.count("success") >= 16
