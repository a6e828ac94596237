"""Lanes: places that lie on their routes, and conflicts where bodies would touch."""

import numpy as np
import pytest
from scenes import EAST, NORTH, WEST, cross

from cad_env.scenarios import SHIPPED, scenario_named
from cad_env.scenarios.lanes import BEND, IN_THE_WAY, conflicts_of, lanes_of, point_at
from cad_env.types import STEP
from cad_env.world.lanes import PLACE, PLACES, TOP_SPEED, Lanes


def middles(lanes: Lanes, b: int) -> dict[int, np.ndarray]:
    """Where the pieces of a lane place the middle of each of its places."""
    found = {}
    for s in range(lanes.pieces[b], lanes.pieces[b + 1]):
        x, y, cos, sin, length = lanes.piece[s]
        first, last = lanes.piece_places[s]
        for place in range(first, last):
            along = (place - first + 0.5) * length / (last - first)
            found[place] = np.array([x + along * cos, y + along * sin])
    return found


@pytest.mark.parametrize("scenario", SHIPPED)
def test_every_place_lies_on_its_route(scenario: str) -> None:
    built = scenario_named(scenario).map
    lanes, checked = built.lanes, 0
    for b in range(len(built.plans)):
        found = middles(lanes, b)
        assert sorted(found) == list(range(lanes.first[b], PLACES))
        for place, middle in found.items():
            there = point_at(built.routes, b, lanes.start[b] + (place + 0.5) * PLACE)
            assert np.hypot(*(middle - there)) < BEND + 0.1
            checked += 1
    assert checked >= 2 * PLACES


def test_a_place_is_what_the_fastest_drive_in_a_step() -> None:
    assert PLACE == TOP_SPEED * STEP


@pytest.mark.parametrize("scenario", SHIPPED)
def test_no_stream_is_faster_than_what_is_reckoned_with(scenario: str) -> None:
    assert scenario_named(scenario).ranges().stream_speed[1] <= TOP_SPEED


def test_a_left_turn_meets_the_lane_that_it_yields_to_and_those_with_a_red_light() -> None:
    built = scenario_named("left_turn").map
    own = built.route("south_left")
    names = [built.plans[each.other].name for each in conflicts_of(built.routes, own)]
    assert sorted(names) == ["east_left", "north_through", "west_left", "west_through"]
    through = next(each for each in conflicts_of(built.routes, own) if each.other == built.route("north_through"))
    crossing = built.crossing(own, through.other)
    assert through.reach < crossing[0] < through.through
    assert through.entry < crossing[1] < through.exit
    assert not through.opposed


def test_overtaking_meets_what_comes_towards_it_for_as_long_as_it_is_in_its_lane() -> None:
    built = scenario_named("overtaking").map
    own = built.route("overtake")
    (found,) = conflicts_of(built.routes, own)
    stretch = np.flatnonzero(built.routes.oncoming[own]) * built.routes.spacing
    assert (found.other, found.opposed) == (built.route("oncoming"), True)
    assert found.reach == stretch[0]
    assert found.through == stretch[-1]
    assert 40.0 < found.exit - found.entry < 60.0


def test_a_straight_crossing_is_in_the_way_for_a_width_to_both_sides() -> None:
    (found,) = [each for each in conflicts_of(cross(), EAST) if each.other == NORTH]
    assert (found.reach, found.through) == (300.0 - IN_THE_WAY + 0.5, 300.0 + IN_THE_WAY - 0.5)
    assert (found.entry, found.exit) == (found.reach, found.through)


def test_who_comes_from_the_other_end_of_the_lane_is_opposed() -> None:
    (found,) = [each for each in conflicts_of(cross(), EAST) if each.other == WEST]
    assert found.opposed


def test_who_begins_together_is_no_conflict() -> None:
    built = scenario_named("overtaking").map
    assert conflicts_of(built.routes, built.route("east")) == []


def test_a_lane_that_meets_nobody_has_no_places() -> None:
    built = scenario_named("overtaking").map
    lanes, east = lanes_of(built.routes, np.full(len(built.plans), 20.0)), built.route("east")
    assert lanes.first[east] == PLACES
    assert lanes.pieces[east] == lanes.pieces[east + 1]
