"""With a penetration each vehicle is connected by a draw of its own: the witness no more often than any other.

Counts are compared with the binomial law. So many are compared that an interval of 95 % would be left now and then by
chance alone; the level is shared out among all counts of a test (Bonferroni), so that an honest draw fails in 0.1 % of
all choices of the seeds.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import pytest
from scipy.stats import binom, norm

from cad_env.numerics.philox import generator
from cad_env.scenarios import SCENARIOS
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.scene import EGO, Scene

LEVEL = 0.001  # of a false alarm, over all counts of a test
EVERY = pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS)
PENETRATION = pytest.mark.parametrize("penetration", [0.05, 0.1, 0.3])
DENSITY = pytest.mark.parametrize("density", ["light", "dense"])


@dataclass
class Count:
    """How often a vehicle was there, and how often connected."""

    there: int = 0
    connected: int = 0

    def note(self, connected: bool) -> None:
        self.there += 1
        self.connected += connected


def scenes(scenario: Scenario, traffic: Traffic, count: int) -> list[Scene]:
    return [scenario.scene(scenario.configured({}), traffic, seed) for seed in range(count)]


@cache
def witnesses(scenario: Scenario, count: int) -> list[tuple[int, ...]]:
    """The rows of the witnesses of each scene."""
    ranges = scenario.configured({})
    return [scenario.actors(scenario.map, ranges, generator(seed, "traffic")).witnesses for seed in range(count)]


def counts(drawn: Sequence[Scene], witnessed: Sequence[tuple[int, ...]]) -> dict[str, Count]:
    """By vehicle: each row, those behind the hidden stream by their place behind it; the first and the last witness."""
    found: dict[str, Count] = {}
    for scene, rows in zip(drawn, witnessed, strict=True):
        assert scene.connected[0] == EGO
        for what, row in [*vehicles(scene), ("first witness", rows[0]), ("last witness", rows[-1])]:
            found.setdefault(what, Count()).note(row in scene.connected)
    return found


def vehicles(scene: Scene) -> Iterator[tuple[str, int]]:
    """All but the ego and the hidden ones. Rows of the stream differ in number, so traffic is counted from its end."""
    before = min(scene.hidden, default=len(scene.placements))
    behind = max(scene.hidden, default=len(scene.placements) - 1) + 1
    yield from ((f"row {row}", row) for row in range(1, before))
    yield from ((f"traffic {row - behind}", row) for row in range(behind, len(scene.placements)))


def check_draw(scenario: Scenario, density: str, penetration: float, count: int) -> None:
    """Every count lies within the binomial interval of its vehicle."""
    found = counts(scenes(scenario, Traffic(density, penetration), count), witnesses(scenario, count))
    assert found["first witness"].there == count
    assert len(found) > 5
    for what, each in found.items():
        low, high = binom.interval(1.0 - LEVEL / len(found), each.there, penetration)
        assert low <= each.connected <= high, f"{what}: {each.connected} of {each.there}, not {low} to {high}"


@EVERY
@DENSITY
@PENETRATION
def test_each_vehicle_is_connected_by_itself(scenario: Scenario, density: str, penetration: float) -> None:
    check_draw(scenario, density, penetration, 200)


@pytest.mark.slow
@EVERY
@DENSITY
@PENETRATION
def test_each_vehicle_is_connected_by_itself_in_many_scenes(
    scenario: Scenario, density: str, penetration: float
) -> None:
    check_draw(scenario, density, penetration, 2000)


@EVERY
@PENETRATION
def test_how_many_witnesses_are_connected_follows_the_binomial_law(scenario: Scenario, penetration: float) -> None:
    count = 300
    drawn, rows = scenes(scenario, Traffic("light", penetration), count), witnesses(scenario, count)
    some = sum(not set(each).isdisjoint(scene.connected) for each, scene in zip(rows, drawn, strict=True))
    fewest, most = (1.0 - (1.0 - penetration) ** choose(map(len, rows)) for choose in (min, max))
    assert binom.ppf(LEVEL / 2, count, fewest) <= some <= binom.ppf(1.0 - LEVEL / 2, count, most)


@EVERY
def test_as_many_scenes_are_silent_as_independent_draws_leave(scenario: Scenario) -> None:
    penetration, expected, spread = 0.05, 0.0, 0.0
    drawn = scenes(scenario, Traffic("light", penetration), 300)
    for scene in drawn:
        chance = (1.0 - penetration) ** (len(scene.placements) - 1 - len(scene.hidden))
        expected, spread = expected + chance, spread + chance * (1.0 - chance)
    assert abs(sum(scene.connected == (EGO,) for scene in drawn) - expected) < norm.isf(LEVEL / 2) * math.sqrt(spread)
