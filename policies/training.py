"""From nothing to a driver: record the expert, clone it, let the clone drive and be corrected, keep the best.

A course is a list of stages in files, so a killed run goes on after the last stage it finished. Every stage draws
its chance from (seed, stage), so stopping and going on changes nothing.
"""

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cad_env.config import check_range, radio_config
from cad_env.env import CADEnv
from cad_env.files import replace_file
from cad_env.planner import Expert
from policies.cloning import Recipe, Worth, drive, fit, load_state, save_state, worth
from policies.demonstrations import Frames, join, record
from policies.driver import LearnedPolicy
from policies.saved import SavedModel, load_model, save_model
from policies.stgraph import StGraphConfig, StGraphNet

# Seeds of training stay below a million; those of scoring begin there.
EXPERT_SEEDS, CORRECTED_SEEDS, VALIDATION_SEEDS, FINAL_SEEDS = 0, 300_000, 900_000, 950_000
LAST_SEED = 999_999
SIDE_BY_SIDE = 32

# What one unit of each kind of work costs, relative to an optimiser step: for an honest progress bar.
EXPERT_COST, DRIVEN_COST = 0.5, 2.0

Advance = Callable[[float], object]


@dataclass(frozen=True)
class Course:
    """How one network is trained."""

    scenario: str = "left_turn"
    radio: str = "dsrc"  # none: trained, as it will be run, without sharing
    seed: int = 0
    episodes: int = 1000  # driven by the expert
    corrections: int = 0  # DAgger rounds: the network drives, the expert labels
    corrected_episodes: int = 256  # in each of them
    steps: int = 1800  # optimiser steps of the first round; half as many in each later one
    segments: int = 3  # parts of a round; a checkpoint and a validation after each
    validation: int = 100  # episodes after each segment
    final_validation: int = 150  # episodes for each of the best checkpoints and thresholds
    thresholds: tuple[float, ...] = (0.5, 0.35)
    recipe: Recipe = field(default_factory=Recipe)
    network: StGraphConfig = field(default_factory=StGraphConfig)

    def __post_init__(self) -> None:
        radio_config(self.radio)
        for name, low, high in (
            ("seed", 0, 2**31), ("episodes", 1, CORRECTED_SEEDS), ("corrections", 0, 50), ("steps", 3, 10**7),
            ("corrected_episodes", 1, 10_000), ("segments", 1, 100), ("validation", 1, FINAL_SEEDS - VALIDATION_SEEDS),
            ("final_validation", 1, LAST_SEED - FINAL_SEEDS),
        ):  # fmt: skip
            check_range(name, getattr(self, name), low, high)

    def steps_of(self, turn: int) -> int:
        """Optimiser steps of a round, a multiple of its segments."""
        whole = self.steps if turn == 0 else self.steps // 2
        return max(whole // self.segments, 1) * self.segments

    def work(self) -> float:
        """All that `train` will tell its `advance`."""
        rounds = range(self.corrections + 1)
        driven = self.corrections * self.corrected_episodes + self.segments * len(rounds) * self.validation
        driven += FINALISTS * len(self.thresholds) * self.final_validation
        return EXPERT_COST * self.episodes + sum(self.steps_of(turn) for turn in rounds) + DRIVEN_COST * driven


FINALISTS = 2  # checkpoints that are validated once more, at every threshold


def train(course: Course, folder: Path, advance: Advance) -> None:
    """Train one network into `folder` (model.safetensors, config.json, metrics.csv), going on where it stopped."""
    torch.set_num_threads(1)  # the graphs are small: a second thread waits more than it works
    if (folder / "config.json").exists():
        load_model(folder)
        advance(course.work())
        return
    folder.mkdir(parents=True, exist_ok=True)
    log = _Log(folder / "metrics.csv")
    network = StGraphNet(course.network, seed=course.seed)
    optimiser = torch.optim.Adam(network.parameters(), lr=course.recipe.learning_rate)
    envs = [_env(course) for _ in range(SIDE_BY_SIDE)]
    parts: list[Frames] = []
    for turn in range(course.corrections + 1):
        parts.append(_record(course, folder, turn, network, advance))
        _round(course, folder, turn, join(parts), network, optimiser, envs, log, advance)
    _keep_best(course, folder, network, envs, log, advance)


def _env(course: Course) -> CADEnv:
    return CADEnv(scenario=course.scenario, radio=course.radio)


def _record(course: Course, folder: Path, turn: int, network: StGraphNet, advance: Advance) -> Frames:
    """The frames of a round: driven by the expert at first, then by the network as it is now."""
    shards = folder / "demonstrations" / f"round_{turn}"
    if turn == 0:
        seeds, driver = range(EXPERT_SEEDS, EXPERT_SEEDS + course.episodes), Expert()
        return record(shards, lambda: _env(course), driver, seeds, lambda n: advance(EXPERT_COST * n))
    first = CORRECTED_SEEDS + turn * 10_000
    seeds = range(first, first + course.corrected_episodes)
    learner = LearnedPolicy(network)
    return record(shards, lambda: _env(course), learner, seeds, lambda n: advance(DRIVEN_COST * n))


def _round(
    course: Course,
    folder: Path,
    turn: int,
    frames: Frames,
    network: StGraphNet,
    optimiser: torch.optim.Adam,
    envs: Sequence[CADEnv],
    log: "_Log",
    advance: Advance,
) -> None:
    """Fit the network to the frames so far, in segments, each validated in closed loop."""
    total = course.steps_of(turn)
    size = total // course.segments
    for segment in range(course.segments):
        checkpoint = _checkpoint(folder, turn, segment)
        if checkpoint.exists() and log.has(turn, segment):
            load_state(checkpoint, network, optimiser)
            advance(size + DRIVEN_COST * course.validation)
            continue
        rng = np.random.default_rng([course.seed, turn, segment])
        steps = range(segment * size, (segment + 1) * size)
        loss = fit(network, optimiser, frames, course.recipe, steps, total, rng, advance)
        save_state(checkpoint, network, optimiser)
        seeds = range(VALIDATION_SEEDS, VALIDATION_SEEDS + course.validation)
        log.add(turn, segment, round(loss, 5), 0.5, _validated(network, 0.5, envs, seeds, advance))


def _validated(
    network: StGraphNet, threshold: float, envs: Sequence[CADEnv], seeds: range, advance: Advance
) -> dict[str, Any]:
    episodes = drive(network, threshold, envs, seeds, lambda n: advance(DRIVEN_COST * n))
    outcomes = [episode.outcome for episode in episodes]
    value = worth(episodes)
    calm = [episode for episode in episodes if not episode.hazard]
    return {
        "episodes": len(episodes), "collisions": outcomes.count("collision"), "timeouts": outcomes.count("timeout"),
        "failures": value.failures, "mean_time": round(value.time, 3),
        "needless_brakes": round(sum(episode.brakes > 0 for episode in calm) / max(len(calm), 1), 4),
    }  # fmt: skip


def _keep_best(
    course: Course, folder: Path, network: StGraphNet, envs: Sequence[CADEnv], log: "_Log", advance: Advance
) -> None:
    """Validate the best checkpoints at every threshold on further seeds, and save the winner as the model."""
    optimiser = torch.optim.Adam(network.parameters())
    seeds = range(FINAL_SEEDS, FINAL_SEEDS + course.final_validation)
    finals = []
    for row in sorted(log.rows, key=_worth_of)[:FINALISTS]:
        load_state(_checkpoint(folder, int(row["round"]), int(row["segment"])), network, optimiser)
        for threshold in course.thresholds:
            found = _validated(network, threshold, envs, seeds, advance)
            finals.append({"round": row["round"], "segment": row["segment"], "threshold": threshold, **found})
    best = min(finals, key=_worth_of)
    load_state(_checkpoint(folder, int(best["round"]), int(best["segment"])), network, optimiser)
    notes = {"course": json.loads(json.dumps(asdict(course))), "chosen": best, "finalists": finals}
    save_model(folder, SavedModel(network, best["threshold"], notes))


def _worth_of(row: Mapping[str, Any]) -> Worth:
    return Worth(row["failures"], row["mean_time"])


def _checkpoint(folder: Path, turn: int, segment: int) -> Path:
    return folder / "checkpoints" / f"round_{turn}_segment_{segment}.safetensors"


class _Log:
    """metrics.csv: one row a checkpoint. A row torn by a kill is dropped, and its segment validated again."""

    COLUMNS = (
        "round", "segment", "loss", "threshold", "episodes", "collisions", "timeouts", "failures", "mean_time",
        "needless_brakes",
    )  # fmt: skip

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[dict[str, float]] = list(self._kept())
        self._write()

    def has(self, turn: int, segment: int) -> bool:
        return any((row["round"], row["segment"]) == (turn, segment) for row in self.rows)

    def add(self, turn: int, segment: int, loss: float, threshold: float, found: dict[str, Any]) -> None:
        self.rows = [row for row in self.rows if (row["round"], row["segment"]) != (turn, segment)]
        self.rows.append({"round": turn, "segment": segment, "loss": loss, "threshold": threshold, **found})
        self._write()

    def _kept(self) -> Iterator[dict[str, float]]:
        if not self.path.exists():
            return
        with self.path.open(newline="") as file:
            for row in csv.DictReader(file):
                try:
                    yield {name: json.loads(row[name]) for name in self.COLUMNS}
                except (KeyError, TypeError, ValueError):
                    continue

    def _write(self) -> None:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, self.COLUMNS)
        writer.writeheader()
        writer.writerows(self.rows)
        replace_file(self.path, text.getvalue().encode())
