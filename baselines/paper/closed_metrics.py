"""Closed-loop records -> the numbers of a row, and how it stands against `stgraph` on the same episodes.

With several training seeds a rate is their mean; its Wilson interval is that of the episodes of *one* of them, because
all drive the same episodes: more training seeds make it no narrower.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from baselines.paper.folder import Drives
from baselines.paper.statistics import Mcnemar, difference_estimate, holm, mcnemar_of_seeds, mean_estimate  # fmt: skip
from cad_env.scoring.interval import Estimate, wilson_estimate
from cad_env.scoring.scorecard import Record
from cad_env.types import STEP, Bools, Floats

OURS = "stgraph"
HARD_BRAKE = 4.0  # m/s2 over 0.5 s
CHANCE = 0  # the seed of every bootstrap: the same numbers whatever else is computed
_Range = tuple[float, float]


@dataclass(frozen=True)
class ClosedRow:
    """A method in a scenario over a radio, over all training seeds."""

    radio: str
    scenario: str
    method: str
    training_seeds: int
    episodes: int  # of each training seed
    collision: Estimate
    success: Estimate
    timeout: Estimate
    collision_spread: _Range | None  # least and most among training seeds
    success_spread: _Range | None
    sct: Estimate | None  # success weighted by the expert's time; None without the expert's episodes
    mean_time: Estimate  # s until the outcome, all episodes
    calm_time: Estimate | None  # s, where there is no hazard
    needless: Estimate | None  # share of the episodes without a hazard in which it brakes at all
    needless_decisions: float | None  # decisions to brake in an episode without a hazard, on average
    hard_brakes: Estimate  # share of all episodes
    min_ttc: float | None  # s, 5th percentile of the episodes; None if above all that was measured
    bytes_per_message: float | None
    largest_message: int | None
    bytes_per_second: float  # by all connected vehicles together
    lost: float | None  # share of the messages of the others that the ego missed
    advantage: Estimate | None = None  # success of `stgraph` minus this one's
    test: Mcnemar | None = None  # `stgraph` first; the largest p among training seeds
    adjusted_p: float | None = None  # after Holm, over the rows of this scenario and radio


def closed_row(
    radio: str, scenario: str, method: str, drives: Drives, expert: Mapping[int, Record]
) -> ClosedRow:  # fmt: skip
    """The row of at least one episode, without its comparison."""
    runs = paired(drives)
    episodes = len(runs[0])
    calm = [[record for record in run if not record.hazard] for run in runs]
    records = [record for run in runs for record in run]
    sent = sum(record.messages_sent for record in records)
    total, time = sum(record.bytes_total for record in records), sum(record.time for record in records)
    success, collision = (_outcomes(runs, outcome) for outcome in ("success", "collision"))
    return ClosedRow(
        radio=radio,
        scenario=scenario,
        method=method,
        training_seeds=len(runs),
        episodes=episodes,
        collision=_rate(collision),
        success=_rate(success),
        timeout=_rate(_outcomes(runs, "timeout")),
        collision_spread=_spread(collision),
        success_spread=_spread(success),
        sct=_sct(runs, expert),
        mean_time=_mean([[record.time for record in run] for run in runs]),
        calm_time=_mean([[record.time for record in run] for run in calm]) if calm[0] else None,
        needless=_rate(np.array([[record.brakes > 0 for record in run] for run in calm])) if calm[0] else None,
        needless_decisions=float(np.mean([[record.brakes for record in run] for run in calm])) if calm[0] else None,
        hard_brakes=_rate(np.array([[record.hardest_brake >= HARD_BRAKE for record in run] for run in runs])),
        min_ttc=_low_ttc(records),
        bytes_per_message=total / sent if sent else None,
        largest_message=max(record.bytes_per_message_max or 0 for record in records) if sent else None,
        bytes_per_second=total / time if time >= STEP else 0.0,
        lost=lost_share(records),
    )


def compared(rows: Sequence[ClosedRow], reference: Drives, drives: Mapping[str, Drives]) -> list[ClosedRow]:
    """The rows of one scenario and radio, each with how `stgraph`, the reference, does against it."""
    others = [row for row in rows if row.method != OURS]
    found = {}
    for row in others:
        ours, theirs = success_pairs(reference, drives[row.method])
        if ours.size:
            found[row.method] = paired_difference(ours, theirs), mcnemar_of_seeds(ours, theirs)
    adjusted = dict(zip(found, holm([test.p for _, test in found.values()]), strict=True))
    return [
        replace(row, advantage=found[name][0], test=found[name][1], adjusted_p=adjusted[name])
        if (name := row.method) in found
        else row
        for row in rows
    ]


def paired_difference(first: Bools, second: Bools) -> Estimate:
    """How much oftener the first succeeds, of (S, E) and (R, E)."""
    return difference_estimate(first.astype(float), second.astype(float), np.random.default_rng(CHANCE))


def success_pairs(first: Drives, second: Drives) -> tuple[Bools, Bools]:
    """Successes (S, E) and (R, E) of two methods on the episodes that both have.

    Of the training seeds they keep those that both have; one that is trained once, or not at all, meets all.
    """
    shared = sorted(set(first) & set(second))
    chosen = [first, second]
    if min(len(first), len(second)) > 1 and shared:
        chosen = [{k: drives[k] for k in shared} for drives in chosen]
    seeds = sorted(set.intersection(*(set(run) for drives in chosen for run in drives.values())))
    one, two = (
        np.array([[run[seed].outcome == "success" for seed in seeds] for run in drives.values()]) for drives in chosen
    )
    return one, two


def paired(drives: Drives) -> list[list[Record]]:
    """By training seed, the records of the episodes that all training seeds have, in one order."""
    seeds = sorted(set.intersection(*(set(run) for run in drives.values())))
    if not seeds:
        raise ValueError("the training seeds of a method have no episode in common")
    return [[run[seed] for seed in seeds] for run in drives.values()]


def lost_share(records: Sequence[Record]) -> float | None:
    """Share of the messages of the others, in range or not, that were lost on their way to the ego."""
    # A connected vehicle sends as often as the ego until it leaves the map; the ego's own messages have no way to go.
    others = sum(record.messages_sent * (1 - 1 / record.connected) for record in records if record.connected)
    return sum(record.messages_lost for record in records) / others if others else None


def _outcomes(runs: Sequence[Sequence[Record]], outcome: str) -> Bools:
    return np.array([[record.outcome == outcome for record in run] for run in runs])


def _rate(happened: Bools) -> Estimate:
    return wilson_estimate(float(happened.mean()), happened.shape[1])


def _spread(happened: Bools) -> _Range | None:
    rates = happened.mean(axis=1)
    return (float(rates.min()), float(rates.max())) if len(rates) > 1 else None


def _mean(values: Sequence[Sequence[float]]) -> Estimate:
    return mean_estimate(np.array(values), np.random.default_rng(CHANCE))


def _sct(runs: Sequence[Sequence[Record]], expert: Mapping[int, Record]) -> Estimate | None:
    """Success times the share of the expert's time, as SPL does with the shortest path (Anderson et al., "On evaluation
    of embodied navigation agents", 2018), over the episodes in which the expert succeeds."""
    known = [
        k for k, record in enumerate(runs[0]) if record.seed in expert and expert[record.seed].outcome == "success"
    ]
    if not known:
        return None
    best: Floats = np.array([expert[runs[0][k].seed].time for k in known])
    own: Floats = np.array([[run[k].time for k in known] for run in runs])
    success = _outcomes([[run[k] for k in known] for run in runs], "success")
    return mean_estimate(success * best / np.maximum(own, best), np.random.default_rng(CHANCE))


def _low_ttc(records: Sequence[Record]) -> float | None:
    times = np.array([np.inf if record.min_ttc is None else record.min_ttc for record in records])
    low = float(np.quantile(times, 0.05, method="lower"))
    return low if np.isfinite(low) else None
