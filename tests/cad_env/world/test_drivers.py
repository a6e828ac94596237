"""Who presses the pedals: IDM behind others and before red lights, and the command that comes from outside."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import ARM, BESIDE, EAST, NORTH, WEST, cross, go_on, moments, world_of

from cad_env.scenarios.scene import Placement
from cad_env.types import BRAKE, GO, TRUCK
from cad_env.world.drivers import MIN_GAP, gap_to_leader, idm_acceleration
from cad_env.world.state import SCRIPTED, STANDING, crashed


@pytest.mark.parametrize("yaw", [0.0, 0.15, -0.15])
@pytest.mark.parametrize("speed", [3.0, 10.0, 18.0])
def test_a_driver_stops_behind_a_standing_turned_truck(yaw: float, speed: float):
    truck = Placement(EAST, 200.0, 0.0, 0.0, STANDING, TRUCK, 14.0, 2.6, yaw=yaw)
    world = world_of(Placement(EAST, 100.0, speed, speed), truck)
    go_on(world, 40.0)
    gap = 200.0 - 7.0 - 2.4 - world.progress[0]
    assert world.speed[0] < 0.1
    assert 0.5 * MIN_GAP < gap < 2.0 * MIN_GAP
    assert not crashed(world).any()


def test_a_driver_stops_at_a_red_line_and_not_before_it():
    world = world_of(Placement(EAST, 100.0, 12.0, 12.0, stop_at=200.0))
    go_on(world, 40.0)
    front = world.progress[0] + 2.4
    assert world.speed[0] < 0.1
    assert 198.0 < front < 200.1  # IDM creeps the last centimetres


def test_nobody_stops_for_the_light_of_another():
    world = world_of(Placement(EAST, 100.0, 12.0, 12.0), Placement(BESIDE, 100.0, 12.0, 12.0, stop_at=200.0))
    go_on(world, 15.0)
    assert world.speed[0] == pytest.approx(12.0)
    assert world.speed[1] < 0.5


@given(
    st.floats(1.0, 20.0), st.floats(0.0, 15.0), st.floats(0.3, 20.0), st.lists(st.booleans(), min_size=8, max_size=8)
)
def test_a_follower_never_touches_a_leader_that_brakes_when_it_likes(speed, leader_speed, spare, brakes):
    # It starts with a gap in which it can still stop, as every vehicle of a scene does.
    distance = 4.8 + MIN_GAP + 1.5 * speed + speed**2 / 12 + spare
    world = world_of(Placement(EAST, 100.0, speed, 20.0), Placement(EAST, 100.0 + distance, leader_speed, leader_speed))
    for brake in brakes:
        go_on(world, 1.0, (1,), BRAKE if brake else GO)
    assert not crashed(world).any()
    assert world.progress[0] < world.progress[1]


def test_the_leader_is_the_nearest_in_the_way_and_nobody_else():
    own = Placement(EAST, 100.0, 10.0, 10.0)
    nearest, beyond = Placement(EAST, 130.0, 4.0, 4.0), Placement(EAST, 150.0, 1.0, 1.0)
    behind, aside = Placement(EAST, 95.1, 20.0, 20.0), Placement(BESIDE, 110.0, 2.0, 2.0)
    oncoming, crossing = Placement(WEST, 2 * ARM - 120.0, 3.0, 3.0), Placement(NORTH, ARM, 3.0, 3.0)
    world = world_of(own, beyond, nearest, behind, aside, oncoming, crossing)
    assert gap_to_leader(world, cross(), 0) == pytest.approx((30.0 - 4.8, 4.0))
    alone = world_of(own, behind, aside, oncoming)
    assert gap_to_leader(alone, cross(), 0) == (math.inf, 0.0)


@given(st.floats(0.0, 60.0), st.floats(0.0, 60.0))
def test_the_gap_is_from_bumper_to_bumper_wherever_they_are(here: float, apart: float):
    world = world_of(Placement(EAST, 100.0 + here, 10.0, 10.0), Placement(EAST, 105.0 + here + apart, 4.0, 4.0))
    assert gap_to_leader(world, cross(), 0)[0] == pytest.approx(apart + 5.0 - 4.8, abs=1e-9)


def test_idm_has_its_published_equilibria():
    # v = v0 on a free road, and the gap s0 + vT over sqrt(1 - (v/v0)^4) behind a leader of one's own speed.
    assert idm_acceleration(10.0, 10.0, math.inf, 0.0) == 0.0
    speed, wanted = 8.0, 10.0
    gap = (2.0 + 1.2 * speed) / math.sqrt(1.0 - (speed / wanted) ** 4)
    assert idm_acceleration(speed, wanted, gap, speed) == pytest.approx(0.0, abs=1e-12)
    assert idm_acceleration(0.0, 10.0, math.inf, 0.0) == pytest.approx(2.0)


@given(st.floats(0.0, 30.0), st.floats(0.0, 30.0), st.floats(-5.0, 200.0), st.floats(0.0, 30.0))
def test_no_driver_brakes_harder_or_starts_faster_than_a_car_can(speed, wanted, gap, leader):
    assert -8.0 <= idm_acceleration(speed, wanted, gap, leader) <= 2.0


def test_the_brake_takes_force_two_decisions_after_it_is_asked_for():
    world = world_of(Placement(EAST, 100.0, 12.0, 12.0))
    speeds = [world.speed[0] for _ in moments(world, 1.0, (0,), BRAKE)]
    assert speeds[:2] == [12.0, 12.0]
    assert np.diff(speeds[1:]) == pytest.approx(-0.6)  # 6 m/s2


def test_releasing_the_brake_takes_as_long():
    world = world_of(Placement(EAST, 100.0, 12.0, 12.0))
    go_on(world, 1.0, (0,), BRAKE)
    braked = world.speed[0]
    speeds = [world.speed[0] for _ in moments(world, 0.4, (0,), GO)]
    assert speeds[0] < braked
    assert speeds[1] < speeds[0]
    assert speeds[2] > speeds[1]


def test_braking_ends_in_standing_and_never_in_reverse():
    world = world_of(Placement(EAST, 100.0, 5.0, 12.0))
    go_on(world, 3.0, (0,), BRAKE)
    assert world.speed[0] == 0.0
    there = world.position[0].copy()
    go_on(world, 2.0, (0,), BRAKE)
    assert (world.position[0] == there).all()
    go_on(world, 5.0, (0,), GO)
    assert world.speed[0] > 5.0


def test_scripted_drivers_hold_their_speed_whatever_is_ahead():
    world = world_of(Placement(EAST, 100.0, 15.0, 15.0, SCRIPTED), Placement(EAST, 160.0, 5.0, 5.0))
    go_on(world, 2.0)
    assert world.speed[0] == 15.0


def test_who_stands_does_not_move():
    world = world_of(Placement(EAST, 100.0, 0.0, 10.0, STANDING))
    before = world.position.copy()
    go_on(world, 2.0, (0,), GO)
    assert (world.position == before).all()
