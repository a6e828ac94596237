"""Rates with their 95 % intervals.

Intervals are Wilson's: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", Journal of
the American Statistical Association 22 (1927).

The agents of an episode share its fate, so n agents are not n independent trials. The interval of a share of agents is
Wilson's on the *effective* number of agents: their number divided by the design effect, which is the variance of the
share between episodes over that of independent agents (E. L. Korn, B. I. Graubard, "Confidence intervals for
proportions with small expected number of positive counts estimated from survey data", Survey Methodology 24 (1998)).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

Z = 1.959963984540054  # the 97.5th percentile of the normal distribution


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Share:
    """A rate of whole counts with its 95 % interval."""

    count: int
    of: int
    low: float
    high: float

    @property
    def rate(self) -> float:
        """count / of."""
        return self.count / self.of


def wilson(count: float, trials: float) -> tuple[float, float]:
    """The 95 % Wilson interval of `count` in a number of trials.

    >>> low, high = wilson(50, 500)
    >>> round(low, 4), round(high, 4)
    (0.0767, 0.1294)
    """
    return wilson_of_rate(count / trials, trials)


def wilson_of_rate(rate: float, trials: float) -> tuple[float, float]:
    """The 95 % Wilson interval of a rate; neither the trials nor the successes need be a whole number."""
    if not 0.0 <= rate <= 1.0 or trials <= 0:
        raise ValueError(f"a rate must be from 0 to 1 over at least one trial, got {rate!r} over {trials!r}")
    scale = 2.0 * (trials + Z**2)
    middle = (2.0 * trials * rate + Z**2) / scale
    half = Z / scale * math.sqrt(4.0 * trials * rate * (1.0 - rate) + Z**2)
    return max(0.0, middle - half) if rate > 0.0 else 0.0, min(1.0, middle + half) if rate < 1.0 else 1.0


def share_of(count: int, of: int) -> Share:
    """A share of independent trials."""
    return Share(count, of, *wilson(count, of))


def wilson_estimate(rate: float, episodes: int) -> Estimate:
    """A rate over so many episodes with its Wilson interval, e.g. the mean rate of several training seeds."""
    return Estimate(rate, *wilson_of_rate(rate, episodes))


def clustered(counts: Sequence[int], sizes: Sequence[int]) -> Share:
    """The share of `counts` in `sizes`, agents of each episode, with its interval by the effective sample size.

    The effective number is never more than there are agents. Where nobody or everybody counts, so that the variance
    says nothing, it is the number of episodes: agents that always fare alike.

    >>> clustered([1] * 50 + [0] * 450, [1] * 500)  # an agent an episode: Wilson's own
    Share(count=50, of=500, low=0.0766..., high=0.1294...)
    >>> clustered([4] * 50 + [0] * 450, [4] * 500)  # four that always fare alike are no more than one
    Share(count=200, of=2000, low=0.0766..., high=0.1294...)
    """
    count, total = sum(counts), sum(sizes)
    return Share(count, total, *wilson_of_rate(count / total, effective_number(counts, sizes)))


def effective_number(counts: Sequence[int], sizes: Sequence[int]) -> float:
    """How many independent trials a share of `counts` in `sizes`, agents of each episode, is worth; see `clustered`."""
    count, total, episodes = sum(counts), sum(sizes), len(sizes)
    rate = count / total
    alone = rate * (1.0 - rate) / total  # the variance if agents were independent
    between = math.fsum((k - rate * n) ** 2 for k, n in zip(counts, sizes, strict=True)) / total**2
    effective = total * alone / between if alone > 0.0 and between > 0.0 else math.inf if alone > 0.0 else episodes
    return min(effective, total)


def clustered_mean(clusters: Sequence[Sequence[float]]) -> Estimate:
    """The mean of all values, at least one, with the 95 % interval of the normal distribution.

    The interval is by the variance between clusters, each with at least one value; that of a single one has no width.

    >>> mean = clustered_mean([[9.0], [10.0], [11.0], [10.0]])
    >>> mean.value, round(mean.low, 3), round(mean.high, 3)
    (10.0, 9.2, 10.8)
    """
    values, count = [value for cluster in clusters for value in cluster], len(clusters)
    mean = math.fsum(values) / len(values)
    between = math.fsum(math.fsum(value - mean for value in cluster) ** 2 for cluster in clusters)
    half = Z * math.sqrt(between * count / max(count - 1, 1)) / len(values)
    return Estimate(mean, mean - half, mean + half)
