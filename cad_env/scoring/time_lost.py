"""Time lost: how much later a method arrives than the expert does on the same seed.

A collision has no time, so a time lost never stands without the collision rate, nor the rate without it: braking for
ever avoids every collision, and loses all the time there is.

The mean has the interval of the normal distribution, the 90th percentile that of R. S. Woodruff ("Confidence intervals
for medians and other position measures", Journal of the American Statistical Association 47 (1952)): the times at both
ends of the Wilson interval of a rate of 0.9. Records of several training seeds drive the same episodes, which are the
clusters of both intervals: more training seeds make them narrower only as far as they differ.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cad_env.scoring.interval import Estimate, clustered_mean, effective_number, wilson_of_rate
from cad_env.types import COLLISION, SUCCESS

if TYPE_CHECKING:
    from cad_env.scoring.scorecard import Record

EXPERT = "expert"  # the name of the method that the others are compared with
HIGH = 0.9  # the percentile that stands beside the mean


@dataclass(frozen=True)
class TimeLost:
    """s that a method arrives after the expert; negative where it is before it."""

    times: int  # that are known: episodes, of each training seed
    mean: Estimate
    high: Estimate  # 90th percentile


def time_lost(records: "Iterable[Record]", expert: "Iterable[Record]") -> TimeLost | None:
    """The time lost in all episodes in which it is known, or None if there is none.

    records: of one method, from one training seed or several; expert: of the expert, also of other episodes. The
    interval of a single episode has no width.

    >>> from cad_env.scoring.scorecard import Record
    >>> rest = 0, None, None, 0, 0, 0, None, None, 3, 0.0
    >>> expert = [Record("left_turn", "expert", seed, False, "success", 10.0, *rest) for seed in range(4)]
    >>> went = "success", "success", "timeout", "collision"
    >>> ended = 11.0, 9.5, 40.0, 5.0
    >>> mine = [Record("left_turn", "my", k, False, went[k], ended[k], *rest) for k in range(4)]
    >>> lost = time_lost(mine, expert)
    >>> lost.times, round(lost.mean.value, 2), lost.high.value
    (3, 10.17, 30.0)
    """
    known = times_lost(records, expert)
    values = sorted(value for times in known.values() for value in times)
    if not values:
        return None
    return TimeLost(len(values), clustered_mean(list(known.values())), _percentile(values, list(known.values())))


def times_lost(
    records: "Iterable[Record]", expert: "Iterable[Record]"
) -> dict[tuple[str, int], list[float]]:  # fmt: skip
    """(scenario, seed) -> s after the expert, one of each record of that episode that has a time.

    Who waits until time is up has lost the time up to then, at least. There is no time where the method collides, or
    where the expert does not arrive.
    """
    best = {(record.scenario, record.seed): record.time for record in expert if record.outcome == SUCCESS}
    found: dict[tuple[str, int], list[float]] = {}
    for record in records:
        episode = record.scenario, record.seed
        if record.outcome != COLLISION and episode in best:
            found.setdefault(episode, []).append(record.time - best[episode])
    return found


def _percentile(values: Sequence[float], episodes: Sequence[Sequence[float]]) -> Estimate:
    """The 90th percentile of sorted values, with Woodruff's interval."""
    value = _quantile(values, HIGH)
    below = [sum(time <= value for time in times) for times in episodes]
    low, high = wilson_of_rate(HIGH, effective_number(below, [len(times) for times in episodes]))
    return Estimate(value, _quantile(values, low), _quantile(values, high))


def _quantile(values: Sequence[float], share: float) -> float:
    """The least of sorted values that so large a share is not above."""
    rank = math.ceil(share * len(values) - 1e-9)  # 0.9 of 10 is the ninth, whatever floats make of it
    return values[min(max(rank, 1), len(values)) - 1]
