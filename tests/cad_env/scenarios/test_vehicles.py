"""Hidden streams: platoons with gaps between them, whose times know nothing of the ego and favour no moment."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cad_env.scenarios import SCENARIOS, SHIPPED
from cad_env.scenarios.junction import ARM
from cad_env.scenarios.left_turn import LeftTurnRanges
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.scene import Placement
from cad_env.scenarios.vehicles import EARLIEST, hidden_stream, platoon_times
from cad_env.world.state import STREAM

EVERY = pytest.mark.parametrize("scenario", [SCENARIOS[name] for name in SHIPPED], ids=SHIPPED)
UNTIL = 40.0  # s
RANGES = LeftTurnRanges()


def times_of(scenario: Scenario, seed: int, until: float = UNTIL) -> np.ndarray:
    ranges = scenario.ranges()
    rng = np.random.default_rng(seed)
    return np.array(platoon_times(rng, ranges.platoon, ranges.headway, ranges.platoon_gap, until))


def stream(seed: int, conflict: float = ARM, **changes) -> list[Placement]:
    return hidden_stream(np.random.default_rng(seed), replace(RANGES, **changes), 3, conflict)


@EVERY
def test_headways_gaps_and_platoons_are_as_stated_and_used_to_their_ends(scenario: Scenario):
    ranges = scenario.ranges()
    waits, sizes = [], []
    for seed in range(1000):
        times = times_of(scenario, seed)
        assert all(EARLIEST <= time < UNTIL for time in times)
        between = np.diff(times)
        waits.extend(between.tolist())
        ends = np.flatnonzero(between >= ranges.platoon_gap[0])
        sizes.extend(np.diff(ends).tolist())  # of the platoons that neither end of the time cuts
    waits = np.array(waits)
    within, gaps = waits[waits < ranges.platoon_gap[0]], waits[waits >= ranges.platoon_gap[0]]
    for values, (low, high) in ((within, ranges.headway), (gaps, ranges.platoon_gap)):
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < values.max() <= high
    assert {*sizes} == {*range(ranges.platoon[0], ranges.platoon[1] + 1)}


@EVERY
def test_no_time_is_a_special_one(scenario: Scenario):
    # Neither how many come in any second, nor how long one waits for the next, depends on when one asks.
    count, asked = 4000, np.arange(EARLIEST, 25.0, 2.5)
    arrivals, waits = np.zeros((count, round(UNTIL - EARLIEST))), np.zeros((count, len(asked)))
    for seed in range(count):
        times = times_of(scenario, seed, 50.0)
        arrivals[seed] = np.histogram(times, bins=np.arange(EARLIEST, UNTIL + 0.5))[0]
        waits[seed] = times[np.searchsorted(times, asked)] - asked
    for some in (arrivals, waits, waits > 4.0):
        error = some.std() / math.sqrt(count)
        assert some.mean(axis=0) == pytest.approx(some.mean(), abs=4.5 * error)


def test_whoever_keeps_its_speed_comes_by_the_conflict_at_its_time_and_the_first_are_ahead():
    for seed in range(50):
        vehicles = stream(seed)
        times = [(ARM - vehicle.progress) / vehicle.speed for vehicle in vehicles]
        assert times == sorted(times)
        assert all(time >= EARLIEST - 1e-9 for time in times)
        assert all(vehicle.progress >= 1.0 for vehicle in vehicles)
        assert {(vehicle.route, vehicle.driver) for vehicle in vehicles} <= {(3, STREAM)}
        assert len({vehicle.speed for vehicle in vehicles}) <= 1
        assert all(vehicle.target_speed == vehicle.speed for vehicle in vehicles)


def test_the_stream_lasts_for_a_whole_episode_also_at_its_highest_speed():
    for seed in range(50):
        last = stream(seed, stream_speed=(20.0, 20.0), empty_share=0.0)[-1]
        assert (ARM - last.progress) / last.speed > 40.0 - RANGES.platoon_gap[1]


def test_the_empty_share_is_the_share_of_episodes_without_anybody():
    empty = sum(not stream(seed) for seed in range(1000))
    assert abs(empty - 1000 * RANGES.empty_share) < 5 * math.sqrt(1000 * RANGES.empty_share)
    assert not any(stream(seed, empty_share=1.0) for seed in range(20))
    assert all(stream(seed, empty_share=0.0) for seed in range(20))


def test_so_many_drivers_are_attentive_and_react_after_so_long():
    attention = np.array([vehicle.attention for seed in range(200) for vehicle in stream(seed)])
    attentive = attention[attention < math.inf]
    assert len(attentive) / len(attention) == pytest.approx(RANGES.attentive_share, abs=0.04)
    assert RANGES.reaction[0] <= attentive.min() < 0.62
    assert 1.38 < attentive.max() <= RANGES.reaction[1]
    assert all(vehicle.attention == math.inf for vehicle in stream(1, attentive_share=0.0))
    assert all(vehicle.attention == 0.5 for vehicle in stream(1, attentive_share=1.0, reaction=(0.5, 0.5)))
