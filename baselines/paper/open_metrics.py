"""Open-loop answers -> AD, EAR and what the paper leaves out, each with its interval over episodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.paper.open_loop import OpenEpisode, OpenLoop
from baselines.paper.statistics import DRAWS, percentile_estimates, resampled_sums
from cad_env.scoring.interval import Estimate
from cad_env.types import Bools, Floats, Ints

AP_DRAWS = 200  # of the average precision, which runs through all frames in every one
_METRICS = ("ad", "ear", "precision", "f1", "false_brake_rate")


@dataclass(frozen=True)
class OpenScore:
    """A method in a scenario over all training seeds. None where a number does not exist, such as no brake's AP."""

    scenario: str
    method: str
    radio: str
    training_seeds: int
    episodes: int  # of each training seed
    frames: int  # of each training seed
    brake_share: float  # of the frames, by the expert
    ad: Estimate | None  # "accident detection": share of the expert's brake frames in which it brakes (recall)
    ear: Estimate | None  # "expert action rate": share of all frames in which it does as the expert (accuracy)
    precision: Estimate | None  # share of its brake frames in which the expert brakes
    f1: Estimate | None
    false_brake_rate: Estimate | None  # share of the expert's go frames in which it brakes
    average_precision: Estimate | None  # over all thresholds
    ad_spread: tuple[float, float] | None  # least and most among training seeds
    ear_spread: tuple[float, float] | None
    bytes_per_message: float | None  # mean of all messages, as encoded
    largest_message: int | None  # bytes


def open_score(runs: Mapping[int, OpenLoop], rng: np.random.Generator) -> OpenScore:
    """The score of a method's runs by training seed, on the episodes that all of them have."""
    whole = list(runs.values())
    kept = _common(whole)
    counts = np.array([[episode.counts() for episode in run] for run in kept], float)  # (S, E, 4)
    drawn = ratios(resampled_sums(counts, rng, DRAWS))
    found = dict(zip(_METRICS, percentile_estimates(ratios(counts.sum((0, 1))), drawn), strict=True))
    by_seed = ratios(counts.sum(1))
    frames = int(counts[0].sum())
    messages = sum(episode.messages for run in kept for episode in run)
    return OpenScore(
        scenario=whole[0].scenario, method=whole[0].method, radio=whole[0].radio, training_seeds=len(kept),
        episodes=len(kept[0]), frames=frames, brake_share=float(counts[0, :, (0, 2)].sum() / frames), **found,
        average_precision=_average_precision(kept, rng), ad_spread=_spread(by_seed[:, 0]),
        ear_spread=_spread(by_seed[:, 1]),
        bytes_per_message=sum(episode.bytes for run in kept for episode in run) / messages if messages else None,
        largest_message=max(episode.largest for run in kept for episode in run) if messages else None,
    )  # fmt: skip


def ratios(counts: Floats) -> Floats:
    """(..., 5) _METRICS of (..., 4) frames: true brake, false brake, false go, true go. NaN where there is none.

    >>> ratios(np.array([6.0, 2.0, 3.0, 9.0])).round(3).tolist()
    [0.667, 0.75, 0.75, 0.706, 0.182]
    """
    hit, false, missed, calm = np.moveaxis(counts, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        parts = [
            hit / (hit + missed), (hit + calm) / (hit + false + missed + calm), hit / (hit + false),
            2 * hit / (2 * hit + false + missed), false / (false + calm),
        ]  # fmt: skip
    return np.stack(parts, axis=-1)


class Ranking(NamedTuple):
    """Frames (n,) from the surest brake down: sorted once, weighed often."""

    labels: Ints
    last: Bools  # of its score: frames of equal score stand or fall together
    owner: Ints  # the place of its episode


def ranking(scores: Floats, labels: Ints, owner: Ints) -> Ranking:
    """Frames (n,) by their scores."""
    order = np.argsort(-scores, kind="stable")
    return Ranking(labels[order], np.append(np.diff(scores[order]) != 0, True), owner[order])


def average_precision(ranked: Ranking, weights: Floats) -> float:
    """The area under precision over recall as a step function; weights (E,) of the episodes. NaN without a brake.

    >>> ranked = ranking(np.array([0.9, 0.8, 0.3]), np.array([1, 0, 1]), np.array([0, 0, 0]))
    >>> round(average_precision(ranked, np.ones(1)), 4)  # 1/2 * 1 + 1/2 * 2/3
    0.8333
    """
    weight = weights[ranked.owner]
    hits, chosen = np.cumsum(weight * ranked.labels)[ranked.last], np.cumsum(weight)[ranked.last]
    if not hits[-1] > 0:
        return float("nan")
    precision = np.divide(hits, chosen, out=np.zeros_like(hits), where=chosen > 0)
    return float((precision * np.diff(hits, prepend=0.0)).sum() / hits[-1])


def _average_precision(runs: Sequence[Sequence[OpenEpisode]], rng: np.random.Generator) -> Estimate | None:
    """The mean over training seeds; drawn as the counts are, since thresholds of different networks do not compare."""
    if any(episode.brake_probability is None for run in runs for episode in run):
        return None
    seeds, episodes = len(runs), len(runs[0])
    ranked = [_ranked(run) for run in runs]
    value = np.mean([average_precision(each, np.ones(episodes)) for each in ranked])
    drawn = np.empty((AP_DRAWS, 1))
    for draw in range(AP_DRAWS):
        weights = np.bincount(rng.integers(episodes, size=episodes), minlength=episodes).astype(float)
        drawn[draw] = np.mean([average_precision(ranked[k], weights) for k in rng.integers(seeds, size=seeds)])
    return percentile_estimates(np.array([value]), drawn)[0]


def _ranked(run: Sequence[OpenEpisode]) -> Ranking:
    scores = np.concatenate([np.array(episode.brake_probability) for episode in run])
    labels = np.array([int(digit) for episode in run for digit in episode.labels])
    return ranking(scores, labels, np.repeat(np.arange(len(run)), [len(episode.labels) for episode in run]))


def _common(runs: Sequence[OpenLoop]) -> list[list[OpenEpisode]]:
    """Of each run the episodes whose seeds all have, in one order."""
    by_seed = [{episode.seed: episode for episode in run.episodes} for run in runs]
    shared = sorted(set.intersection(*(set(each) for each in by_seed)))
    if not shared:
        raise ValueError(f"the training seeds of {runs[0].method} have no held-out episode in common")
    return [[each[seed] for seed in shared] for each in by_seed]


def _spread(values: Floats) -> tuple[float, float] | None:
    return (float(values.min()), float(values.max())) if len(values) > 1 and np.isfinite(values).all() else None
