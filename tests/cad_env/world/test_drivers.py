"""Who presses the pedals: IDM behind others and before red lights, and the command that comes from outside."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import ARM, BESIDE, EAST, NORTH, WEST, cross, go_on, moments, world_of

from cad_env.scenarios.scene import Placement
from cad_env.types import BRAKE, GO, TRUCK
from cad_env.world.drivers import HARDEST_BRAKING, LOOK_AHEAD, MIN_GAP, gap_to_intruder, gap_to_leader, idm_acceleration
from cad_env.world.state import IDM, OFF, SCRIPTED, STANDING, STREAM, World, crashed
from cad_env.world.step import SUBSTEP, substep


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


# --- Streams: they keep their distances, and brake for who is slower ------------------------------------------


def streaming(progress: float, speed: float, attention: float = math.inf, route: int = EAST) -> Placement:
    return Placement(route, progress, speed, speed, STREAM, attention=attention)


def test_a_driver_of_a_stream_keeps_its_pace_however_near_the_vehicle_before_is():
    world = world_of(streaming(100.0, 15.0), streaming(107.0, 15.0), streaming(114.0, 15.0, 1.0))
    go_on(world, 10.0)
    assert world.speed.tolist() == [15.0] * 3
    assert world.progress == pytest.approx([250.0, 257.0, 264.0])
    usual = world_of(Placement(EAST, 100.0, 15.0, 15.0), streaming(107.0, 15.0))
    go_on(usual, 1.0)
    assert usual.speed[0] < 13.0  # any other driver makes room


@given(st.floats(10.0, 20.0), st.floats(1.2, 2.0), st.lists(st.booleans(), min_size=8, max_size=8))
def test_drivers_of_a_stream_brake_for_a_slower_one_and_never_touch_it(speed, headway, brakes):
    apart = speed * headway  # front to front, all as long as a car
    world = world_of(*(streaming(150.0 - k * apart, speed) for k in range(4)))
    for brake in brakes:
        go_on(world, 1.0, (0,), BRAKE if brake else GO)
    assert not crashed(world).any()
    assert (np.diff(world.progress) < -4.8).all()
    assert (world.speed[1:] < speed).all() or not brakes[0]


def test_the_stream_goes_on_when_the_slower_one_does():
    world = world_of(streaming(100.0, 12.0), streaming(80.0, 12.0))
    go_on(world, 2.0, (0,), BRAKE)
    assert (world.speed < 8.0).all()
    go_on(world, 20.0, (0,), GO)
    assert world.speed == pytest.approx([12.0, 12.0], abs=0.3)


def test_only_who_has_the_same_route_leads_a_stream():
    merging = Placement(BESIDE, 130.0, 5.0, 5.0, offset=-2.0)
    same = Placement(EAST, 140.0, 5.0, 5.0)
    for driver, gap in ((STREAM, 40.0), (IDM, 30.0)):
        world = world_of(Placement(EAST, 100.0, 10.0, 10.0, driver), merging, same)
        assert gap_to_leader(world, cross(), 0) == pytest.approx((gap - 4.8, 5.0))


# --- Attention: who is across the way ---------------------------------------------------------------------------


def in_the_way(beside: float = 0.0, driver: int = SCRIPTED) -> Placement:
    """One that stands across the way EAST at the crossing, so many metres to its left."""
    return Placement(NORTH, ARM + beside, 0.0, 0.0, driver)


def first_reaction(world: World, seconds: float = 8.0) -> float:
    """s until vehicle 0 has begun to brake; inf for never."""
    speed, scratch = world.speed[0], np.zeros(len(world.speed))
    for step in range(round(seconds / SUBSTEP)):
        substep(world, cross(), scratch, SUBSTEP)
        if world.speed[0] < speed:
            return step * SUBSTEP  # it has braked since the beginning of this sub-step
    return math.inf


@pytest.mark.parametrize("attention", [0.0, 0.3, 0.6, 1.0, 1.4])
@pytest.mark.parametrize("driver", [STREAM, IDM])
def test_an_attentive_driver_reacts_after_its_reaction_time_and_not_before(attention: float, driver: int):
    vehicle = Placement(EAST, ARM - 60.0, 14.0, 14.0, driver, attention=attention)
    assert first_reaction(world_of(vehicle, in_the_way())) == pytest.approx(attention, abs=SUBSTEP + 1e-9)


def test_without_attention_it_never_does():
    world = world_of(streaming(ARM - 60.0, 14.0), in_the_way())
    assert first_reaction(world) == pytest.approx(4.0, abs=0.3)  # when they touch
    assert crashed(world).all()


@given(st.floats(8.0, 20.0), st.floats(0.0, 1.4), st.floats(0.0, 20.0))
def test_an_attentive_driver_that_has_the_room_stops_before_who_is_across(speed, attention, spare):
    room = speed * (attention + 1.0) + speed**2 / 10.0 + spare + 4.0  # m from bumper to side
    world = world_of(streaming(ARM - min(room, LOOK_AHEAD - 1.0) - 3.4, speed, attention), in_the_way())
    go_on(world, 15.0)
    assert not crashed(world).any()
    assert world.speed[0] < 0.5


def test_the_time_begins_anew_when_the_way_was_free_again():
    world = world_of(streaming(ARM - 90.0, 10.0, 1.0), in_the_way())
    go_on(world, 0.8)
    assert world.noticed[0] == pytest.approx(0.8)
    world.position[1, 1] = 20.0
    go_on(world, 0.1)
    assert (world.noticed[0], world.speed[0]) == (0.0, 10.0)
    world.position[1, 1] = 0.0
    assert first_reaction(world) == pytest.approx(1.0, abs=SUBSTEP + 1e-9)


def test_the_intruder_is_the_nearest_of_another_route_in_the_way_and_nobody_else():
    def gap(*others: Placement) -> tuple[float, float]:
        return gap_to_intruder(world_of(streaming(ARM - 50.0, 10.0), *others), 0)

    nobody = (math.inf, 0.0)
    free = 50.0 - 0.5 * 4.8 - 0.5 * 1.9
    assert gap(in_the_way()) == pytest.approx((free, 0.0))
    assert gap(Placement(NORTH, ARM, 9.0, 9.0)) == pytest.approx((free, 0.0))  # it does not move along the way
    assert gap(in_the_way(3.2)) == pytest.approx((free, 0.0))  # its tail is in the way ...
    assert gap(in_the_way(3.8)) == nobody  # ... and is not
    assert gap(in_the_way(driver=OFF)) == gap(in_the_way(driver=STANDING)) == nobody
    assert gap(Placement(EAST, ARM - 20.0, 5.0, 5.0), Placement(BESIDE, ARM - 20.0, 5.0, 5.0)) == nobody
    merging = Placement(BESIDE, ARM - 20.0, 5.0, 5.0, offset=-2.0)  # half in the lane already
    assert gap(merging) == pytest.approx((30.0 - 4.8, 5.0))
    towards = Placement(WEST, ARM - 10.0, 7.0, 7.0)  # a ghost driver, 60 m ahead
    assert gap(towards) == pytest.approx((60.0 - 4.8, -7.0))
    assert gap(towards, in_the_way()) == pytest.approx((free, 0.0))
    behind, far = streaming(ARM + 3.0, 10.0), streaming(ARM - LOOK_AHEAD - 1.0, 10.0)
    for vehicle in (behind, far):
        assert gap_to_intruder(world_of(vehicle, in_the_way()), 0) == nobody


@given(st.floats(1.0, 20.0), st.floats(-30.0, 90.0), st.floats(0.0, 2.0), st.floats(0.0, 15.0), st.integers(0, 3))
def test_no_driver_of_a_stream_brakes_harder_or_starts_faster_than_a_car_can(speed, before, attention, pace, route):
    vehicles = [streaming(ARM - before, speed, attention), streaming(ARM - before - 15.0, speed)]
    world = world_of(*vehicles, Placement(route, ARM, pace, pace))
    for _ in moments(world, 6.0):
        assert (world.acceleration >= -HARDEST_BRAKING - 1e-9).all()
        assert (world.acceleration <= 2.0 + 1e-9).all()
        assert (world.speed[:2] <= speed + 1e-9).all()
