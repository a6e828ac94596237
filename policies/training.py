"""From nothing to a driver: record the expert, clone it, let the clone drive and be corrected, keep the best.

One network learns all scenarios of its course. A course is a list of stages in files, so a killed run goes on after
the last stage it finished. Every stage draws its chance from (seed, stage), so stopping and going on changes nothing.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cad_env.config import check_range, radio_config
from cad_env.planner import Expert
from cad_env.scenarios import SCENARIOS, scenario_named
from cad_env.types import Policy
from cad_env.vector import CADVectorEnv
from policies.cloning import Recipe, drive, fit, load_state, save_state
from policies.demonstrations import Frames, join, record
from policies.driver import LearnedPolicy
from policies.metrics import Log, summary, worth
from policies.saved import SavedModel, load_model, save_model
from policies.stgraph import StGraphConfig, StGraphNet

# Seeds of training stay below a million; those of scoring begin there. Every scenario uses the same ones.
EXPERT_SEEDS, CORRECTED_SEEDS, VALIDATION_SEEDS, FINAL_SEEDS = 0, 300_000, 900_000, 950_000
LAST_SEED = 999_999
SIDE_BY_SIDE = 32
FINALISTS = 2  # checkpoints that are validated once more, at every threshold

# What one unit of each kind of work costs, relative to an optimiser step: for an honest progress bar.
EXPERT_COST, DRIVEN_COST = 0.9, 1.6

Advance = Callable[[float], object]


@dataclass(frozen=True)
class Course:
    """How one network is trained. Episodes are counted per scenario."""

    scenarios: tuple[str, ...] = tuple(SCENARIOS)
    radio: str = "dsrc"  # none: trained, as it will be run, without sharing
    seed: int = 0
    episodes: int = 600  # driven by the expert
    corrections: int = 2  # DAgger rounds: the network drives, the expert labels
    corrected_episodes: int = 200  # in each of them
    steps: int = 2400  # optimiser steps of the first round; half as many in each later one
    segments: int = 3  # parts of a round; a checkpoint and a validation after each
    validation: int = 60  # episodes after each segment
    final_validation: int = 100  # episodes for each of the best checkpoints and thresholds
    thresholds: tuple[float, ...] = (0.65, 0.5, 0.35)
    recipe: Recipe = field(default_factory=Recipe)
    network: StGraphConfig = field(default_factory=StGraphConfig)

    def __post_init__(self) -> None:
        for name in self.scenarios:
            scenario_named(name)
        if not self.scenarios or len(set(self.scenarios)) < len(self.scenarios):
            raise ValueError(f"scenarios must name at least one, each once, got {' '.join(self.scenarios)!r}")
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
        per_scenario = EXPERT_COST * self.episodes + DRIVEN_COST * driven
        return len(self.scenarios) * per_scenario + sum(self.steps_of(turn) for turn in rounds)


@dataclass(frozen=True)
class _Workshop:
    """What the stages of a course work with."""

    course: Course
    folder: Path
    network: StGraphNet
    optimiser: torch.optim.Adam
    envs: Mapping[str, CADVectorEnv]  # of every scenario
    log: Log
    advance: Advance

    def driven(self, episodes: int) -> None:
        """Tell of episodes that the network drove."""
        self.advance(DRIVEN_COST * episodes)


def train(course: Course, folder: Path, advance: Advance) -> None:
    """Train one network into `folder` (model.safetensors, config.json, metrics.csv), going on where it stopped."""
    torch.set_num_threads(1)  # the graphs are small: a second thread waits more than it works
    if (folder / "config.json").exists():
        load_model(folder)
        advance(course.work())
        return
    folder.mkdir(parents=True, exist_ok=True)
    network = StGraphNet(course.network, seed=course.seed)
    optimiser = torch.optim.Adam(network.parameters(), lr=course.recipe.learning_rate)
    envs = {name: CADVectorEnv(SIDE_BY_SIDE, scenario=name, radio=course.radio) for name in course.scenarios}
    shop = _Workshop(course, folder, network, optimiser, envs, Log(folder / "metrics.csv"), advance)
    frames: dict[str, Frames] = {}
    for turn in range(course.corrections + 1):
        for name in course.scenarios:
            parts = [frames[name]] if turn else []
            frames[name] = join([*parts, _record(shop, turn, name)])
        _round(shop, turn, frames)
    _keep_best(shop)


def _record(shop: _Workshop, turn: int, scenario: str) -> Frames:
    """The frames of a scenario in a round: driven by the expert at first, then by the network as it is now."""
    shards = shop.folder / "demonstrations" / scenario / f"round_{turn}"
    first, count, cost = EXPERT_SEEDS, shop.course.episodes, EXPERT_COST
    driver: Policy = Expert()
    if turn > 0:
        first, count, cost = CORRECTED_SEEDS + turn * 10_000, shop.course.corrected_episodes, DRIVEN_COST
        driver = LearnedPolicy(shop.network)
    return record(
        shards, shop.envs[scenario], driver, range(first, first + count), lambda done: shop.advance(cost * done)
    )


def _round(shop: _Workshop, turn: int, frames: Mapping[str, Frames]) -> None:
    """Fit the network to the frames so far, in segments, each validated in closed loop on every scenario."""
    course, total = shop.course, shop.course.steps_of(turn)
    size = total // course.segments
    for segment in range(course.segments):
        checkpoint = _checkpoint(shop.folder, turn, segment)
        if checkpoint.exists() and len(shop.log.of(turn, segment)) == len(course.scenarios):
            load_state(checkpoint, shop.network, shop.optimiser)
            shop.advance(size)
            shop.driven(course.validation * len(course.scenarios))
            continue
        rng = np.random.default_rng([course.seed, turn, segment])
        steps = range(segment * size, (segment + 1) * size)
        loss = fit(shop.network, shop.optimiser, frames, course.recipe, steps, total, rng, shop.advance)
        save_state(checkpoint, shop.network, shop.optimiser)
        found = _validated(shop, 0.5, range(VALIDATION_SEEDS, VALIDATION_SEEDS + course.validation))
        shop.log.replace(turn, segment, [{"loss": round(loss, 5), "threshold": 0.5, **row} for row in found])


def _validated(shop: _Workshop, threshold: float, seeds: range) -> list[dict[str, Any]]:
    """What the network is worth in closed loop, a summary for each scenario."""
    policy = LearnedPolicy(shop.network, threshold)
    return [{"scenario": name, **summary(drive(policy, envs, seeds, shop.driven))} for name, envs in shop.envs.items()]


def _keep_best(shop: _Workshop) -> None:
    """Validate the best checkpoints at every threshold on further seeds, and save the winner as the model."""
    course = shop.course
    seeds = range(FINAL_SEEDS, FINAL_SEEDS + course.final_validation)
    finals: list[dict[str, Any]] = []
    for turn, segment in shop.log.best(FINALISTS):
        load_state(_checkpoint(shop.folder, turn, segment), shop.network, shop.optimiser)
        for threshold in course.thresholds:
            found = _validated(shop, threshold, seeds)
            finals.append({"round": turn, "segment": segment, "threshold": threshold, "validation": found})
    best = min(finals, key=lambda final: worth(final["validation"]))
    load_state(_checkpoint(shop.folder, best["round"], best["segment"]), shop.network, shop.optimiser)
    notes = {"course": json.loads(json.dumps(asdict(course))), "chosen": best, "finalists": finals}
    save_model(shop.folder, SavedModel(shop.network, best["threshold"], notes))


def _checkpoint(folder: Path, turn: int, segment: int) -> Path:
    return folder / "checkpoints" / f"round_{turn}_segment_{segment}.safetensors"
