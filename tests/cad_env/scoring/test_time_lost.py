"""Time lost is against the expert on the same seed, knows no time for a collision, and has honest intervals."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from cad_env.scoring.interval import Estimate
from cad_env.scoring.scorecard import Record, scorecards
from cad_env.scoring.table import table
from cad_env.scoring.time_lost import TimeLost, time_lost, times_lost
from cad_env.types import Floats

EXPERT = Record("left_turn", "expert", 0, False, "success", 10.0, 0, None, None, 0, 0, 0, None, None, 3, 0.0)


def experts(count: int, **changes: object) -> list[Record]:
    return [replace(EXPERT, seed=seed, **changes) for seed in range(count)]  # type: ignore[arg-type]


def arriving(times: Sequence[float] | Floats, **changes: object) -> list[Record]:
    """One episode a time, all of which arrive."""
    return [
        replace(EXPERT, method="mine", seed=seed, time=float(time), **changes)  # type: ignore[arg-type]
        for seed, time in enumerate(times)
    ]


def lost_of(records: Sequence[Record], expert: Sequence[Record]) -> TimeLost:
    found = time_lost(records, expert)
    assert found is not None
    return found


def test_the_expert_loses_nothing_against_itself() -> None:
    lost = lost_of(experts(20), experts(20))
    assert lost == TimeLost(20, Estimate(0.0, 0.0, 0.0), Estimate(0.0, 0.0, 0.0))


def test_only_the_same_seed_of_the_same_scenario_is_compared() -> None:
    mine = arriving([11.0, 14.0, 13.0])
    others = [replace(EXPERT, seed=1, time=2.0, scenario="overtaking"), replace(EXPERT, seed=0, time=10.5)]
    assert times_lost(mine, others) == {("left_turn", 0): [0.5]}
    assert time_lost(mine[1:], others) is None
    assert time_lost([], experts(3)) is time_lost(mine, []) is None


def test_a_collision_has_no_time_and_waiting_for_ever_costs_all_the_time_there_is() -> None:
    crash, stuck, early = arriving([3.0, 40.0, 9.0])
    records = [replace(crash, outcome="collision"), replace(stuck, outcome="timeout"), early]
    assert times_lost(records, experts(3)) == {("left_turn", 1): [30.0], ("left_turn", 2): [-1.0]}
    assert lost_of(records, experts(3)).mean.value == 14.5


@pytest.mark.parametrize("outcome", ["collision", "timeout"])
def test_an_expert_that_does_not_arrive_is_no_measure(outcome: str) -> None:
    assert time_lost(arriving([11.0]), experts(1, outcome=outcome)) is None


def test_mean_and_percentile_by_hand() -> None:
    lost = lost_of(arriving([10.0 + k for k in range(1, 11)]), experts(10))
    assert lost.times == 10
    assert lost.mean.value == pytest.approx(5.5)
    half = 1.959963984540054 * np.std(np.arange(10), ddof=1) / np.sqrt(10)
    assert (lost.mean.low, lost.mean.high) == pytest.approx((5.5 - half, 5.5 + half))
    assert lost.high.value == 9.0  # nine of ten are not above it
    assert (lost.high.low, lost.high.high) == (6.0, 10.0)  # Wilson's interval of 0.9 in ten: 0.596 to 0.982


def test_a_single_episode_has_an_interval_without_width() -> None:
    lost = lost_of(arriving([12.0]), experts(1))
    assert lost == TimeLost(1, Estimate(2.0, 2.0, 2.0), Estimate(2.0, 2.0, 2.0))


def test_training_seeds_that_fare_alike_make_no_interval_narrower() -> None:
    times = 10.0 + np.random.default_rng(1).exponential(2.0, 60)
    one, three = lost_of(arriving(times), experts(60)), lost_of(arriving(times) * 3, experts(60))
    assert (one.times, three.times) == (60, 180)
    for first, second in ((one.mean, three.mean), (one.high, three.high)):
        assert (second.value, second.low, second.high) == pytest.approx((first.value, first.low, first.high))


def test_training_seeds_that_differ_make_it_narrower() -> None:
    rng = np.random.default_rng(1)
    runs = [arriving(10.0 + rng.exponential(2.0, 60)) for _ in range(4)]
    one, four = lost_of(runs[0], experts(60)), lost_of([record for run in runs for record in run], experts(60))
    assert four.mean.high - four.mean.low < 0.7 * (one.mean.high - one.mean.low)
    assert four.high.high - four.high.low < one.high.high - one.high.low


def _mean(lost: TimeLost) -> tuple[Estimate, float]:
    return lost.mean, 2.0


def _high(lost: TimeLost) -> tuple[Estimate, float]:
    return lost.high, -2.0 * np.log(0.1)


@pytest.mark.parametrize("part", [_mean, _high])
@pytest.mark.parametrize("training_seeds", [1, 3])
def test_intervals_hold_the_truth_about_as_often_as_they_say(
    part: Callable[[TimeLost], tuple[Estimate, float]], training_seeds: int
) -> None:
    """Exponential times with mean 2 s, which all training seeds of an episode share."""
    rng, inside, trials = np.random.default_rng(2), 0, 250
    for _ in range(trials):
        shared = np.repeat(rng.exponential(2.0, 100)[None], training_seeds, axis=0)
        records = [record for run in shared for record in arriving(10.0 + run)]
        estimate, truth = part(lost_of(records, experts(100)))
        inside += estimate.low <= truth <= estimate.high
    assert 0.9 <= inside / trials <= 0.99


def test_a_scorecard_has_the_time_lost_beside_the_collisions() -> None:
    episodes = [*experts(3), *arriving([11.0, 12.0, 5.0])]
    episodes[-1] = replace(episodes[-1], outcome="collision")
    mine = next(row for row in scorecards(episodes) if row.method == "mine" and row.hazard == "all")
    lost = lost_of(episodes[3:], experts(3))
    assert mine.times_lost == 2
    assert (mine.time_lost, mine.time_lost_low, mine.time_lost_high) == (1.5, lost.mean.low, lost.mean.high)
    assert (mine.time_lost_p90, mine.time_lost_p90_low) == (lost.high.value, lost.high.low)
    line = next(line for line in table([mine]).splitlines() if "mine" in line)
    assert line.index("33.3 [") < line.index("1.5 [0.5, 2.5]") < line.index("66.7 [")


def test_without_the_expert_there_is_a_dash_unless_it_is_given_beside() -> None:
    (alone, _), (beside, _) = scorecards(arriving([11.0])), scorecards(arriving([11.0]), expert=experts(1))
    assert alone.time_lost is alone.time_lost_p90_high is None
    assert alone.times_lost == 0
    assert " -  " in table([alone])
    assert beside.time_lost == 1.0
    assert [row.method for row in scorecards(arriving([11.0]), expert=experts(1))] == ["mine", "mine"]
