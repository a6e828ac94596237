"""Priority to the right, as YIELDING drivers keep it."""

import numpy as np
import pytest

from cad_env.scenarios.scene import Placement, place
from cad_env.scenarios.unsignalised import FAR, LINE, STOP, UNSIGNALISED
from cad_env.types import MAX_STEPS
from cad_env.world.state import STREAM, YIELDING, World
from cad_env.world.step import advance

MAP = UNSIGNALISED.map
NOBODY = np.zeros(0, np.int64)


def coming(name: str, away: float = 30.0, speed: float = 8.0, driver: int = YIELDING) -> Placement:
    """A car so many metres before its line."""
    return Placement(MAP.route(name), LINE - away, speed, speed, driver)


def driven(*vehicles: Placement, seconds: float = 30.0) -> tuple[World, list[float]]:
    """The world at the end, and when each had left the junction, s; inf: never."""
    world, scratch = place(vehicles, MAP.routes), np.zeros(len(vehicles))
    left = [np.inf] * len(vehicles)
    for step in range(round(10 * seconds)):
        advance(world, MAP.routes, NOBODY, NOBODY, scratch)
        for row in range(len(vehicles)):
            if world.progress[row] > FAR + STOP + 3.0:
                left[row] = min(left[row], 0.1 * step)
    assert (world.struck < 0).all()
    return world, left


def test_of_two_whose_ways_meet_just_one_gives_way():
    meets, yields = MAP.routes.meets, MAP.routes.yields
    some = np.argwhere(~np.isnan(meets[..., 0]))
    assert len(some) == 4 * (5 + 7 + 2)  # of each arm: left, through, right
    for a, b in some.tolist():
        assert meets[a, b].tolist() == pytest.approx(meets[b, a, [2, 3, 0, 1]].tolist())
        assert yields[a, b] + yields[b, a] == 1


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("east_through", "south_through"),
        ("north_through", "east_left"),
        ("west_left", "north_left"),
        ("south_through", "north_left"),
        ("south_right", "north_left"),
        ("west_through", "south_left"),
    ],
)
def test_who_goes_first(first: str, second: str):
    if first == "west_through":  # from the left, but it gives way to nobody
        vehicles = coming(first, driver=STREAM), coming(second)
    else:
        vehicles = coming(first), coming(second)
    _, (one, other) = driven(*vehicles)
    _, (alone,) = driven(vehicles[0])
    assert one == pytest.approx(alone, abs=0.2)
    assert one < other < 20.0


def test_whose_ways_do_not_meet_do_not_wait():
    _, times = driven(coming("south_through"), coming("north_through"))
    assert times == pytest.approx([driven(coming("south_through"))[1][0]] * 2, abs=0.2)


def test_whoever_has_time_enough_goes_before_one_who_has_priority():
    _, (far, near) = driven(coming("east_through", 80.0), coming("south_through", 20.0))
    assert near == pytest.approx(driven(coming("south_through", 20.0))[1][0], abs=0.2)
    assert near < far


@pytest.mark.parametrize("ways", [("through",) * 4, ("left",) * 4, ("left", "through", "right", "left")])
def test_four_who_would_wait_for_each_other_do_not_wait_for_ever(ways: tuple[str, ...]):
    arms = ("south", "east", "north", "west")
    vehicles = [coming(f"{arm}_{way}", 20.0 + 0.1 * k) for k, (arm, way) in enumerate(zip(arms, ways, strict=True))]
    _, times = driven(*vehicles, seconds=0.1 * MAX_STEPS)
    assert max(times) < 30.0
