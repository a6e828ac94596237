"""Intervals cover what they say, and tests give the values that can be computed by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baselines.paper.statistics import (
    difference_estimate,
    holm,
    mcnemar,
    mcnemar_of_seeds,
    mean_estimate,
    percentile_estimates,
    resampled_sums,
)
from cad_env.scoring.interval import (
    wilson,
    wilson_estimate,  # fmt: skip
)
from cad_env.types import Bools


def outcomes(*counts: tuple[bool, int]) -> Bools:
    return np.concatenate([np.full(count, value) for value, count in counts])


@given(st.integers(1, 1000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_of_a_count_it_is_the_interval_that_scores_have(pair: tuple[int, int]) -> None:
    count, of = pair
    estimate = wilson_estimate(count / of, of)
    assert (estimate.low, estimate.high) == pytest.approx(wilson(count, of), abs=1e-9)
    assert estimate.low <= estimate.value <= estimate.high


@pytest.mark.parametrize(("rate", "episodes"), [(1.1, 10), (-0.1, 10), (0.5, 0)])
def test_what_is_no_rate_is_refused(rate: float, episodes: int) -> None:
    with pytest.raises(ValueError, match="a rate must be from 0 to 1"):
        wilson_estimate(rate, episodes)


def test_mcnemar_asks_only_those_episodes_that_one_of_two_lost() -> None:
    first = outcomes((True, 10), (False, 2), (True, 500), (False, 30))
    second = outcomes((False, 10), (True, 2), (True, 500), (False, 30))
    test = mcnemar(first, second)
    assert (test.first_only, test.second_only) == (10, 2)
    assert test.p == pytest.approx(2 * (1 + 12 + 66) / 2**12)
    assert mcnemar(second, first).p == pytest.approx(test.p)
    assert mcnemar(first, first).p == 1.0


def test_mcnemar_refuses_what_is_not_paired() -> None:
    with pytest.raises(ValueError, match="must be paired"):
        mcnemar(np.ones(3, bool), np.ones(4, bool))


def test_of_training_seeds_the_least_telling_pair_speaks() -> None:
    good, bad = np.ones((2, 20), bool), np.zeros((2, 20), bool)
    bad[1, :15] = True
    assert mcnemar_of_seeds(good, bad) == mcnemar(good[1], bad[1])
    assert mcnemar_of_seeds(good[:1], bad) == mcnemar(good[0], bad[1])
    assert mcnemar_of_seeds(good, bad[:1]) == mcnemar(good[0], bad[0])


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([]) == []


@given(st.lists(st.floats(0.0, 1.0), max_size=12))
def test_holm_keeps_the_order_and_never_helps(p_values: list[float]) -> None:
    adjusted = holm(p_values)
    assert all(p <= more <= 1.0 for p, more in zip(p_values, adjusted, strict=True))
    ranked = [adjusted[k] for k in sorted(range(len(p_values)), key=lambda k: p_values[k])]
    assert ranked == sorted(ranked)


def test_a_bootstrap_is_as_wide_as_the_normal_law_says() -> None:
    values = np.random.default_rng(0).normal(5.0, 2.0, (1, 400))
    estimate = mean_estimate(values, np.random.default_rng(1))
    assert estimate.value == values.mean()
    assert estimate.high - estimate.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.08)


def test_chance_is_an_argument() -> None:
    values = np.random.default_rng(0).random((2, 50))
    first, same, other = (mean_estimate(values, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == same != other


def test_the_same_episodes_with_more_training_seeds_are_not_more_episodes() -> None:
    values = np.random.default_rng(0).random((1, 100))
    once, often = (mean_estimate(np.tile(values, (n, 1)), np.random.default_rng(1)) for n in (1, 20))
    assert often.high - often.low == pytest.approx(once.high - once.low, rel=0.1)


def test_training_seeds_that_differ_widen_the_interval() -> None:
    values = np.random.default_rng(0).random((3, 400)) * 0.1
    alike = mean_estimate(values, np.random.default_rng(1))
    apart = mean_estimate(values + np.array([[0.0], [0.5], [1.0]]), np.random.default_rng(1))
    assert apart.high - apart.low > 5 * (alike.high - alike.low)


def test_a_difference_on_the_same_episodes_forgets_how_hard_they_are() -> None:
    rng = np.random.default_rng(0)
    hard = rng.normal(0.0, 10.0, (1, 200))
    better = hard + 1.0 + rng.normal(0.0, 0.1, (3, 200))
    estimate = difference_estimate(better, hard, np.random.default_rng(1))
    assert 0.9 < estimate.low < estimate.value < estimate.high < 1.1
    assert difference_estimate(hard, hard, np.random.default_rng(1)).high == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(ValueError, match="the same episodes"):
        difference_estimate(hard, hard[:, 1:], np.random.default_rng(1))


def test_sums_are_of_whole_episodes() -> None:
    counts = np.zeros((2, 3, 2))
    counts[:, 1] = 7.0, 70.0
    drawn = resampled_sums(counts, np.random.default_rng(0), draws=50)
    assert drawn.shape == (50, 2)
    assert (drawn[:, 1] == 10 * drawn[:, 0]).all()
    assert set((drawn[:, 0] / 14).tolist()) <= {0.0, 1.0, 2.0, 3.0}


def test_a_number_that_does_not_exist_has_no_interval() -> None:
    drawn = np.array([[1.0, np.nan], [3.0, np.nan], [np.nan, np.nan]])
    first, second = percentile_estimates(np.array([2.0, np.nan]), drawn)
    assert first is not None
    assert 1.0 <= first.low <= first.high <= 3.0
    assert second is None


@pytest.mark.slow
def test_intervals_cover_the_truth_nineteen_times_in_twenty() -> None:
    rng = np.random.default_rng(0)
    rate, episodes, runs, hits = 0.8, 200, 1000, {"wilson": 0, "mean": 0, "difference": 0}
    for _ in range(runs):
        hard = rng.random((1, episodes))  # of an episode, for both
        first, second = (np.where(hard < p, 1.0, 0.0) for p in (rate, rate - 0.1))
        for name, truth, estimate in (
            ("wilson", rate, wilson_estimate(float(first.mean()), episodes)),
            ("mean", rate, mean_estimate(first, rng, 500)),
            ("difference", 0.1, difference_estimate(first, second, rng, 500)),
        ):
            hits[name] += estimate.low <= truth <= estimate.high
    assert all(0.92 <= count / runs <= 0.98 for count in hits.values()), hits
