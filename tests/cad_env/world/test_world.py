"""Contact and the clock of the world: nothing tunnels, and who has touched whom stays known."""

import math

import numpy as np
import pytest
from scenes import ARM, EAST, NORTH, WEST, boxes, cross, go_on, moments, world_of

from cad_env.scenarios.scene import Placement
from cad_env.world.state import OFF, SCRIPTED, STANDING, crashed
from cad_env.world.step import note_contacts
from cad_env.world.time_to_contact import time_to_contact


def rolling(route: int, progress: float, speed: float, **more: float) -> Placement:
    return Placement(route, progress, speed, speed, SCRIPTED, **more)


PHASES = np.arange(0.0, 4.0, 0.1)  # m: where in its step a vehicle arrives


@pytest.mark.parametrize("phase", PHASES)
def test_nothing_tunnels_head_on_at_40_m_s(phase: float):
    world = world_of(rolling(EAST, ARM - 30.0, 20.0), rolling(WEST, ARM - 30.0 - phase, 20.0))
    go_on(world, 3.0)
    assert world.struck.tolist() == [1, 0]


@pytest.mark.parametrize("phase", PHASES)
def test_ten_centimetres_are_a_contact_at_40_m_s(phase: float):
    aside = Placement(EAST, ARM, 0.0, 0.0, STANDING, offset=1.8)
    world = world_of(rolling(EAST, ARM - 30.0 - phase, 40.0), aside)
    go_on(world, 3.0)
    assert world.struck.tolist() == [1, 0]


@pytest.mark.parametrize("phase", np.arange(0.0, 2.0, 0.1))
def test_nothing_tunnels_through_the_side_of_a_standing_car(phase: float):
    target = Placement(NORTH, ARM, 0.0, 0.0, STANDING, width=1.8)
    world = world_of(rolling(EAST, ARM - 40.0 - phase, 30.0), target)
    go_on(world, 3.0)
    assert crashed(world).all()


def test_passing_at_ten_centimetres_is_no_contact():
    world = world_of(rolling(EAST, ARM - 30.0, 40.0), Placement(EAST, ARM, 0.0, 0.0, STANDING, offset=2.0))
    go_on(world, 3.0)
    assert not crashed(world).any()


def test_a_vehicle_remembers_the_first_it_touched():
    world = boxes((0, 0, 0), (4, 0, 0), (-4, 0, 0), (50, 0, 0))
    note_contacts(world)
    assert world.struck.tolist() == [1, 0, 0, -1]
    world.position[1] = 100.0, 100.0
    note_contacts(world)
    assert world.struck.tolist() == [1, 0, 0, -1]


def test_who_is_off_touches_nobody():
    world = boxes((0, 0, 0), (4, 0, 0))
    world.driver[1] = OFF
    note_contacts(world)
    assert not crashed(world).any()


def test_a_crashed_vehicle_brakes_hard_and_stays():
    world = world_of(rolling(EAST, ARM - 10.0, 20.0), Placement(NORTH, ARM, 0.0, 0.0, STANDING))
    struck_at = next(time for time in moments(world, 5.0) if crashed(world).any())
    speed = world.speed[0]
    go_on(world, 1.0)
    assert speed - world.speed[0] == pytest.approx(8.0)
    go_on(world, 3.0)
    assert struck_at < 1.0
    assert world.speed[0] == 0.0
    assert crashed(world).all()


def test_long_trucks_touch_from_afar():
    # Two trucks of 18 m nose to nose: their centres are as far apart as any contact can be.
    world = boxes((0, 0, 0, 18.0, 2.5), (17.9, 0, 0, 18.0, 2.5))
    note_contacts(world)
    assert crashed(world).all()


def test_a_vehicle_leaves_at_the_end_of_its_route():
    world = world_of(rolling(EAST, cross().length[EAST] - 5.0, 10.0), rolling(WEST, 100.0, 10.0))
    go_on(world, 0.4)
    assert world.driver[0] == SCRIPTED
    go_on(world, 0.2)
    assert world.driver[0] == OFF
    assert world.driver[1] == SCRIPTED
    there = world.position[0].copy()
    go_on(world, 1.0)
    assert (world.position[0] == there).all()


def test_time_to_contact_is_gap_over_closing_speed():
    world = boxes((0, 0, 0), (44.8, 0, math.pi), (20, 20, 0))
    world.speed[:2] = 15.0, 5.0
    assert time_to_contact(world, 0) == pytest.approx(2.0, abs=0.11)
    assert time_to_contact(world, 1) == time_to_contact(world, 0)
    assert time_to_contact(world, 2) == math.inf
    world.speed[:2] = 2.0, 1.0  # 13 s: beyond the horizon
    assert time_to_contact(world, 0) == math.inf
    world.driver[1] = OFF
    world.speed[:2] = 15.0, 5.0
    assert time_to_contact(world, 0) == math.inf
