"""Where somebody may be whom nobody has reported: what grows, what is only slow, and who is asked for."""

import numpy as np
import pytest

from cad_env.numerics.jit import compiled
from cad_env.pipeline.hidden import (
    CLOSED,
    FOLLOWS,
    LEADS,
    PATIENCE,
    UNDER,
    Hidden,
    foremost,
    grow,
    hidden_at,
    new_hidden,
)
from cad_env.scenarios import scenario_named
from cad_env.world.lanes import PLACES, Lanes


@compiled
def _grown(hidden: Hidden, lanes: Lanes, route: int) -> None:
    grow(hidden_at(hidden, 0), lanes, route)


class Lane:
    """The first lane that the way of the left turn's ego meets, without a vehicle on it."""

    def __init__(self) -> None:
        self.map = scenario_named("left_turn").map
        self.route = next(r for r in range(len(self.map.lanes.other)) if self.map.lanes.other[r, 0] >= 0)
        self.hidden = new_hidden(1, self.map.lanes)
        self.hidden.places[:] = 0

    @property
    def places(self) -> np.ndarray:
        return self.hidden.places[0, 0]

    def grow(self, seen: slice | None = None) -> None:
        """One step; the places `seen` are vouched for afterwards."""
        _grown(self.hidden, self.map.lanes, self.route)
        if seen is not None:
            self.places[seen] = 0


def test_who_is_hidden_comes_on_by_one_place_a_step_at_most() -> None:
    lane = Lane()
    lane.places[100] = 1
    for step in range(1, 5):
        lane.grow()
        assert (lane.places[100 : 101 + step] > 0).all()
        assert not lane.places[101 + step :].any()
        assert lane.places[100 + step] == 1  # the foremost has lost nothing


def test_who_lingers_in_a_pocket_is_never_forgotten_and_in_time_is_taken_to_stand() -> None:
    lane = Lane()
    lane.places[100:103] = 1
    known = np.zeros(PLACES, np.uint8)
    for step in range(PATIENCE + 10):
        lane.grow()
        lane.places[80:100] = lane.places[103:] = 0  # seen on both sides
        assert (lane.places[100:103] > 0).all()
        assert (foremost(lane.places, known, 0, 110) == 102) == (step < PATIENCE + 2 - 1)
    assert foremost(lane.places, known, 90, 110) == -1


def test_who_is_fed_from_outside_is_never_taken_to_stand() -> None:
    lane = Lane()
    for _ in range(PLACES):
        lane.grow(slice(111, PLACES))
    first = int(np.flatnonzero(lane.places)[0])
    assert (lane.places[first:111] == 1).all()


def test_a_pocket_behind_a_vehicle_that_drives_on_moves_with_it_and_is_not_taken_to_stand() -> None:
    lane = Lane()
    lane.places[100:105] = 1
    for _ in range(3 * PATIENCE):
        lane.hidden.known[0, 0, 104] = LEADS
        lane.grow()
        lane.places[80:100] = lane.places[105:] = 0
    assert (lane.places[104 - FOLLOWS : 105] == 1).all()


@pytest.mark.parametrize(("by", "behind", "expected"), [
    (LEADS, FOLLOWS, -1), (LEADS, FOLLOWS + 1, 99), (UNDER, FOLLOWS, 99), (CLOSED, FOLLOWS, -1),
])  # fmt: skip
def test_only_who_could_be_just_behind_a_vehicle_on_the_lane_is_not_asked_for(
    by: int, behind: int, expected: int
) -> None:
    places, known = np.zeros(PLACES, np.uint8), np.zeros(PLACES, np.uint8)
    places[100 - behind : 102], known[100:102] = 1, by
    assert foremost(places, known, 0, PLACES - 1) == expected
    if by == LEADS:
        places[110] = 1
        assert foremost(places, known, 0, PLACES - 1) == 110
