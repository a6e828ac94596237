"""Whom a vehicle that never brakes would meet on its way."""

import math

import pytest
from scenes import ARM, BESIDE, EAST, NORTH, cross, world_of

from cad_env.scenarios.scene import Placement
from cad_env.world.state import SCRIPTED
from cad_env.world.unbraked import who_is_met

EGO = Placement(EAST, ARM - 50.0, 10.0, 10.0)
GOAL = ARM + 30.0
MEETS, PASSES = (Placement(NORTH, ARM - distance, 10.0, 10.0, SCRIPTED) for distance in (50.0, 90.0))


def met(*others: Placement, goal: float = GOAL, steps: int = 400) -> tuple[int, float]:
    return who_is_met(world_of(EGO, *others), cross(), goal, steps)


def test_it_is_the_row_that_is_touched_and_the_time_of_the_decision_after_which_it_is():
    beside = Placement(BESIDE, ARM - 50.0, 10.0, 10.0)
    row, time = met(beside, PASSES, MEETS)
    assert row == 3
    assert time == pytest.approx(4.7)  # 50 m at 10 m/s, less half a length and half a width


@pytest.mark.parametrize("others", [(), (PASSES,), (PASSES, Placement(BESIDE, ARM, 0.0, 0.0))])
def test_nobody_is_met_by_who_comes_through(others: tuple):
    row, time = met(*others)
    assert row == -1
    assert time == math.inf


def test_nothing_is_looked_at_beyond_the_goal_or_the_time():
    assert met(MEETS, goal=ARM - 10.0)[0] == -1
    assert met(MEETS, steps=46)[0] == -1
    assert met(MEETS, steps=47)[0] == 1


def test_the_contacts_of_others_do_not_count():
    world = world_of(EGO, PASSES, Placement(NORTH, ARM - 120.0, 20.0, 20.0, SCRIPTED))
    assert who_is_met(world, cross(), GOAL, 400)[0] == -1
    assert world.struck.tolist() == [-1, 2, 1]
