"""Caution: what cannot be seen may come, so creep until it can be seen."""

import math

import numpy as np
import pytest

from cad_env.envs.vector import CADVectorEnv
from cad_env.pipeline.observe import as_observation, empty_view
from cad_env.rules.cautious import Cautious, CautiousConfig
from cad_env.rules.planner import Planner
from cad_env.scoring.rollout import rollouts
from cad_env.types import BRAKE, CAR, GO, ROUTE_SPACING, TRUCK, Observation

QUEUE = 3.5  # m to the left, the middle of the lane beside the ego's


def standing(*vehicles: tuple[float, float, int], speed: float = 0.0) -> Observation:
    """A straight road along which the ego drives at `speed`, m/s; vehicles stand at (x, y), m, in its frame."""
    view = empty_view()
    ages = np.arange(view.odometry.shape[0])[::-1]
    view.odometry[:, 0] = -0.1 * speed * ages
    view.ego[:] = speed, 10.0, 4.5, 1.8
    view.route[:, 0] = ROUTE_SPACING * (1 + np.arange(len(view.route)))
    for k, (x, y, kind) in enumerate(vehicles):
        view.tracks[k, :, 0], view.tracks[k, :, 1] = x - view.odometry[:, 0], y
        view.mask[k], view.kind[k] = 1, kind
    return as_observation(view)


def decided(observation: Observation, **caution: float) -> int:
    return Cautious(CautiousConfig(**caution)).act(observation)


def test_on_an_open_road_there_is_no_reason_to_slow_down():
    for speed in (0.0, 5.0, 10.0):
        assert decided(standing(speed=speed)) == GO


def test_what_a_truck_hides_beside_the_way_may_hold_a_vehicle():
    seen = standing((8.0, QUEUE, TRUCK), speed=9.0)
    assert decided(seen) == BRAKE
    assert Planner().act(seen) == GO
    assert decided(standing((8.0, -QUEUE, TRUCK), speed=9.0)) == BRAKE  # from the other side as well
    farther = standing((8.0, 2.0 * QUEUE, TRUCK), speed=9.0)
    assert [decided(farther, speed=pace) for pace in (1.0, 15.0)] == [GO, BRAKE]  # one that dawdles comes too late


def test_it_creeps_on_to_where_it_sees_and_then_goes():
    decisions = [decided(standing((x, QUEUE, TRUCK), speed=3.0)) for x in (-1.0, -9.0)]
    assert decisions == [BRAKE, GO]
    assert decided(standing((-1.0, QUEUE, TRUCK), speed=2.0)) == GO


def test_nothing_comes_through_a_vehicle_that_stands():
    truck = (6.0, QUEUE, TRUCK)
    assert decided(standing(truck, speed=9.0)) == BRAKE
    queue = [(10.0 + 2.0 * k, 8.5, CAR) for k in range(5)]  # across, right behind what the truck hides
    assert decided(standing(truck, *queue, speed=9.0)) == GO


def test_it_sees_no_farther_than_its_sensor():
    assert decided(standing(speed=9.0), range=10.0) == BRAKE


@pytest.mark.parametrize("name", ["speed", "reserve", "short", "lean", "creep", "range"])
def test_a_knob_that_is_no_number_is_refused(name: str):
    with pytest.raises(ValueError, match=f"{name} must be a number from"):
        CautiousConfig(**{name: math.nan})


@pytest.mark.parametrize(("scenario", "share"), [("street_crossing", 0.25)])
def test_caution_avoids_collisions_of_the_rules_without_it(scenario: str, share: float):
    # In the left turn the lane is seen only from within it: who creeps up to there is hit by who drives on.
    envs = CADVectorEnv(8, scenario=scenario, radio="none")
    ends = {}
    for policy in (Planner(), Cautious()):
        episodes = list(rollouts(envs, policy, range(700_000, 700_032), hazard=True))
        ends[type(policy)] = sum(episode.outcome == "collision" for episode in episodes)
    assert ends[Cautious] < share * ends[Planner]
