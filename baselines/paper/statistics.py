"""Intervals and tests for methods that are scored on the same episodes: pure functions, chance is an argument.

The outcomes of a method are an array (S, E): S training seeds (one where nothing is trained) times the same E
episodes. Every training seed drives the same episodes, so a bootstrap draws training seeds and, once for all of them,
episodes (the crossed bootstrap: A. B. Owen, "The pigeonhole bootstrap", Annals of Applied Statistics 1, 2007). Frames
are never drawn by themselves: at 10 Hz a frame says little that the one before it did not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.stats import binomtest

from cad_env.scoring.interval import Estimate
from cad_env.types import Bools, Floats

DRAWS = 2000  # of a bootstrap
LEVEL = 0.95
_Z = 1.959963984540054  # the 97.5th percentile of the normal distribution


@dataclass(frozen=True)
class Mcnemar:
    """Two methods on the same episodes: who alone succeeded how often, and the exact two-sided p."""

    first_only: int
    second_only: int
    p: float


def mcnemar(first: Bools, second: Bools) -> Mcnemar:
    """The exact test of Q. McNemar (Psychometrika 12, 1947) on paired outcomes (E,): a binomial test of the pairs that
    differ. p is 1 if none does.

    >>> mcnemar(np.array([True] * 5 + [False]), np.array([False] * 5 + [False]))
    Mcnemar(first_only=5, second_only=0, p=0.0625)
    """
    if first.shape != second.shape or first.ndim != 1:
        raise ValueError(f"outcomes must be paired, (E,) each, got {first.shape} and {second.shape}")
    one, other = int((first & ~second).sum()), int((second & ~first).sum())
    return Mcnemar(one, other, float(binomtest(one, one + other).pvalue) if one + other else 1.0)


def mcnemar_of_seeds(first: Bools, second: Bools) -> Mcnemar:
    """Of two methods, (S, E) and (R, E), the test with the largest p among their training seeds.

    Both with several seeds are paired seed by seed, in their order; one with a single seed meets all of the other. A
    small p then speaks for every training seed, not for a lucky one.
    """
    alone = 1 in (len(first), len(second))
    pairs = product(first, second) if alone else zip(first, second, strict=False)
    tests = [mcnemar(one, other) for one, other in pairs]
    return max(tests, key=lambda test: test.p)


def holm(p_values: Sequence[float]) -> list[float]:
    """p of a family of tests, adjusted so that the chance of any false alarm stays below the level.

    S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6 (1979).

    >>> holm([0.01, 0.04, 0.03])
    [0.03, 0.06, 0.06]
    """
    adjusted, so_far = [0.0] * len(p_values), 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=lambda k: p_values[k])):
        so_far = max(so_far, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = so_far
    return adjusted


def resampled_sums(values: Floats, rng: np.random.Generator, draws: int = DRAWS) -> Floats:
    """Sums over training seeds and episodes of (S, E, ...) values, drawn anew with replacement: (draws, ...).

    With S = 1 only the episodes are drawn.
    """
    seeds, episodes = values.shape[:2]
    flat = values.reshape(seeds, episodes, -1)
    of_seeds = rng.multinomial(seeds, np.full(seeds, 1 / seeds), draws).astype(float)
    of_episodes = rng.multinomial(episodes, np.full(episodes, 1 / episodes), draws).astype(float)
    columns = [np.einsum("de,de->d", of_seeds @ flat[:, :, k], of_episodes) for k in range(flat.shape[2])]
    return np.stack(columns, axis=1).reshape(draws, *values.shape[2:])


def mean_estimate(values: Floats, rng: np.random.Generator, draws: int = DRAWS) -> Estimate:
    """The mean of (S, E) values, such as a rate of outcomes that are 0 or 1, with its percentile interval.

    Where all values are the same the interval has no width: give a rate near 0 or 1 Wilson's.
    """
    return _estimate(float(values.mean()), resampled_sums(values, rng, draws) / values.size)


def difference_estimate(first: Floats, second: Floats, rng: np.random.Generator, draws: int = DRAWS) -> Estimate:
    """How much larger the mean of (S, E) values is than that of (R, E) on the same episodes, with its interval.

    The same episodes are drawn for both, training seeds for each by itself.
    """
    if first.shape[1:] != second.shape[1:]:
        raise ValueError(f"values must be of the same episodes, got {first.shape} and {second.shape}")
    episodes = first.shape[1]
    drawn = rng.multinomial(episodes, np.full(episodes, 1 / episodes), draws) / episodes
    means = [np.einsum("de,de->d", _drawn_seeds(values, rng, draws), drawn) for values in (first, second)]
    return _estimate(float(first.mean() - second.mean()), means[0] - means[1])


def _drawn_seeds(values: Floats, rng: np.random.Generator, draws: int) -> Floats:
    seeds = len(values)
    weights: Floats = rng.multinomial(seeds, np.full(seeds, 1 / seeds), draws) / seeds
    return weights @ values


def _estimate(value: float, drawn: Floats) -> Estimate:
    low, high = np.quantile(drawn, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    return Estimate(value, float(low), float(high))


def percentile_estimates(values: Floats, drawn: Floats) -> list[Estimate | None]:
    """Of M numbers (M,) and their draws (draws, M) an estimate each; None where the number does not exist (NaN).

    Draws in which a number does not exist, such as a precision without a brake, do not count.
    """
    found: list[Estimate | None] = []
    for value, column in zip(values.tolist(), drawn.T, strict=True):
        kept = column[np.isfinite(column)]
        found.append(_estimate(value, kept) if math.isfinite(value) and len(kept) else None)
    return found
