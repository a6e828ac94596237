"""From nothing to a policy: record the expert, clone it, let the clone drive and be corrected, keep the best.

One network of any spec learns all scenarios of its course. A course is a list of stages in files, so a killed run
goes on after the last stage it finished. Every stage draws its chance from (seed, stage), so stopping and going on
changes nothing.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from cad_env.config import check_range, radio_config
from cad_env.envs.vector import CADVectorEnv
from cad_env.scenarios import SHIPPED, scenario_named
from cad_env.types import FRAMES
from policies.model_folder import SavedModel, load_model, save_model
from policies.registry import spec_named
from policies.spec import Frames, NetworkSpec, fitting
from policies.stgraph.network import StGraphConfig
from policies.training.cloning import Recipe, drive, fit, load_state, save_state
from policies.training.demonstrations import Demonstrations, record
from policies.training.frame_cache import frames_of
from policies.training.validation_log import Log, summary

# Seeds of training stay below a million; those of scoring begin there. Every scenario uses the same ones.
EXPERT_SEEDS, DAGGER_SEEDS, VALIDATION_SEEDS, FINAL_SEEDS = 0, 300_000, 900_000, 950_000
LAST_SEED = 999_999
SIDE_BY_SIDE = 32
METRICS, FINALS = "metrics.csv", "finalists.csv"  # what each checkpoint was worth, and the best at every threshold
VALIDATED_AT = 0.5  # threshold, after each segment
FINALISTS = 2  # checkpoints that are validated once more

# What one unit of each kind of work costs, relative to an optimiser step: for an honest progress bar.
REPLAYED_COST, DRIVEN_COST = 0.9, 1.6

Advance = Callable[[float], object]


@dataclass(frozen=True)
class Course:
    """How one network is trained. Episodes are counted per scenario."""

    scenarios: tuple[str, ...] = SHIPPED
    radio: str = "dsrc"  # none: trained, as it will be run, without sharing
    depth: int = FRAMES  # newest frames in a message
    seed: int = 0
    episodes: int = 1500  # driven by the expert
    dagger_rounds: int = 2  # DAgger rounds: the network drives, the expert labels
    dagger_episodes: int = 400  # in each of them
    mixing: float = 0.0  # share of the decisions that the expert takes in the first of them; of the n-th: to the n
    steps: int = 2400  # optimiser steps of the first round; half as many in each later one
    segments: int = 3  # parts of a round; a checkpoint and a validation after each
    validation: int = 60  # episodes after each segment
    final_validation: int = 100  # episodes for each of the best checkpoints and thresholds
    thresholds: tuple[float, ...] = (0.8, 0.65, 0.5, 0.35)
    recipe: Recipe = field(default_factory=Recipe)
    spec: str = "stgraph"
    network: Any = field(default_factory=StGraphConfig)  # of the spec's config type

    def __post_init__(self) -> None:
        object.__setattr__(self, "scenarios", tuple(scenario_named(each).name for each in self.scenarios))
        if not self.scenarios or len(set(self.scenarios)) < len(self.scenarios):
            raise ValueError(f"scenarios must name at least one, each once, got {' '.join(self.scenarios)!r}")
        object.__setattr__(self, "network", fitting(self.network, self.scenarios))
        radio_config(self.radio)
        for name, low, high in (
            ("seed", 0, 2**31), ("episodes", 1, DAGGER_SEEDS), ("dagger_rounds", 0, 49), ("steps", 3, 10**7),
            ("dagger_episodes", 1, 10_000), ("segments", 1, 100), ("validation", 1, FINAL_SEEDS - VALIDATION_SEEDS),
            ("final_validation", 1, LAST_SEED - FINAL_SEEDS),
        ):  # fmt: skip
            check_range(name, getattr(self, name), low, high)
        check_range("mixing", self.mixing, 0.0, 1.0)
        if not self.thresholds or len(set(self.thresholds)) < len(self.thresholds):
            raise ValueError(f"thresholds must be at least one, each once, got {self.thresholds}")
        for threshold in self.thresholds:
            check_range("thresholds", threshold, 0.0, 1.0)
        check_range("depth", self.depth, 1, FRAMES)
        self.recipe.of_each(len(self.scenarios))

    def steps_of(self, turn: int) -> int:
        """Optimiser steps of a round, a multiple of its segments."""
        whole = self.steps if turn == 0 else self.steps // 2
        return max(whole // self.segments, 1) * self.segments

    def work(self) -> float:
        """All that `train` will tell its `advance`."""
        rounds = range(self.dagger_rounds + 1)
        driven = self.dagger_rounds * self.dagger_episodes + self.segments * len(rounds) * self.validation
        driven += FINALISTS * len(self.thresholds) * self.final_validation
        replayed = self.episodes + self.dagger_rounds * self.dagger_episodes
        per_scenario = REPLAYED_COST * replayed + DRIVEN_COST * driven
        return len(self.scenarios) * per_scenario + sum(self.steps_of(turn) for turn in rounds)


@dataclass(frozen=True)
class _Workshop:
    """What the stages of a course work with."""

    course: Course
    folder: Path
    demonstrations: Path  # of the expert, shared by all courses
    spec: NetworkSpec
    network: nn.Module
    optimiser: torch.optim.Adam
    log: Log  # of every checkpoint
    finals: Log  # of the best, at every threshold
    advance: Advance

    @property
    def dagger_folder(self) -> Path:
        """Where the episodes are that the network drove to be corrected."""
        return self.folder / "dagger_rounds"

    def driven(self, episodes: int) -> None:
        """Tell of episodes that the network drove."""
        self.advance(DRIVEN_COST * episodes)

    def envs(self, scenario: str) -> CADVectorEnv:
        """Scenes as the network is to drive in them, as it is now."""
        return self._envs(scenario, self.spec.environment(self.network))

    def replayed(self, scenario: str) -> CADVectorEnv:
        """Scenes to look at what was recorded in."""
        return self._envs(scenario, self.spec.replayed(self.network))

    def _envs(self, scenario: str, needs: dict[str, Any]) -> CADVectorEnv:
        return CADVectorEnv(SIDE_BY_SIDE, scenario=scenario, radio=self.course.radio, depth=self.course.depth, **needs)

    def fitted(self, turn: int, segment: int) -> bool:
        """Whether a segment has its checkpoint."""
        return checkpoint(self.folder, turn, segment).exists()

    def load(self, turn: int, segment: int) -> float:
        """Go back to the network and the optimiser as they were after a segment; gives its loss."""
        return load_state(checkpoint(self.folder, turn, segment), self.network, self.optimiser)


def record_demonstrations(folder: Path, scenario: str, episodes: int, advance: Advance) -> list[Demonstrations]:
    """The expert's episodes of a scenario, kept in `folder`/<scenario>; it sees the truth, so nothing is sent."""
    envs = CADVectorEnv(SIDE_BY_SIDE, scenario=scenario, radio="none")
    return record(folder / scenario, envs, None, range(EXPERT_SEEDS, EXPERT_SEEDS + episodes), advance)


def train(
    course: Course,
    folder: Path,
    advance: Advance,
    demonstrations: Path | None = None,
) -> None:
    """Train one network into `folder` (the model and how it came about), going on where it stopped.

    `demonstrations` is where the expert's episodes are, or are put; several courses may share it.
    """
    torch.set_num_threads(1)  # the graphs are small: a second thread waits more than it works
    if (folder / "config.json").exists():
        load_model(folder)
        advance(course.work())
        return
    folder.mkdir(parents=True, exist_ok=True)
    spec = spec_named(course.spec)
    network = spec.build(course.network, seed=course.seed)
    optimiser = torch.optim.Adam(network.parameters(), lr=course.recipe.learning_rate)
    log, finals, shared = Log(folder / METRICS), Log(folder / FINALS), demonstrations or folder / "demonstrations"
    shop = _Workshop(course, folder, shared, spec, network, optimiser, log, finals, advance)
    frames: dict[str, Frames] = {}
    known = 0  # rounds whose frames are in there
    for turn in range(course.dagger_rounds + 1):
        if not all(shop.fitted(turn, segment) for segment in range(course.segments)):
            for missing in range(known, turn + 1):
                _learn_of(shop, missing, frames)
            known = turn + 1
        _round(shop, turn, frames)
    _keep_best(shop)


def _learn_of(shop: _Workshop, turn: int, frames: dict[str, Frames]) -> None:
    """Add the frames of a round, of every scenario, as the network meets them."""
    for name in shop.course.scenarios:
        envs, parts = shop.replayed(name), []
        folder = (shop.dagger_folder if turn else shop.demonstrations) / name / "frames"
        for recorded in _recorded(shop, turn, name):
            parts.append(frames_of(folder, recorded, envs, shop.spec, shop.network))
            shop.advance(REPLAYED_COST * len(recorded))
        before = [frames.pop(name)] if name in frames else []
        first, *others = [*before, *parts]
        del before, parts
        frames[name] = first.joined(others) if others else first


def _recorded(shop: _Workshop, turn: int, scenario: str) -> list[Demonstrations]:
    """The episodes of a round: driven by the expert at first, then by the network as it was before the round."""
    course = shop.course
    if turn == 0:
        return record_demonstrations(shop.demonstrations, scenario, course.episodes, lambda done: None)
    first = DAGGER_SEEDS + turn * 10_000
    seeds = range(first, first + course.dagger_episodes)
    shards = shop.dagger_folder / scenario / f"round_{turn}"
    policy = shop.spec.policy(shop.network, 0.5)
    return record(shards, shop.envs(scenario), policy, seeds, shop.driven, course.mixing**turn)


def _round(shop: _Workshop, turn: int, frames: Mapping[str, Frames]) -> None:
    """Fit the network to the frames so far, in segments, each validated in closed loop on every scenario."""
    course = shop.course
    before, total = (sum(map(course.steps_of, range(rounds))) for rounds in (turn, course.dagger_rounds + 1))
    size = course.steps_of(turn) // course.segments
    for segment in range(course.segments):
        if shop.fitted(turn, segment):
            loss = shop.load(turn, segment)
            shop.advance(size)
        else:
            shop.log.forget(turn, segment)
            rng = np.random.default_rng([course.seed, turn, segment])
            steps = range(before + segment * size, before + (segment + 1) * size)
            loss = fit(shop.spec, shop.network, shop.optimiser, frames, course.recipe, steps, total, rng, shop.advance)
            save_state(checkpoint(shop.folder, turn, segment), shop.network, shop.optimiser, loss)
        seeds = range(VALIDATION_SEEDS, VALIDATION_SEEDS + course.validation)
        _validate(shop, shop.log, (turn, segment, VALIDATED_AT), loss, seeds)


def _validate(shop: _Workshop, log: Log, which: tuple[int, int, float], loss: float, seeds: range) -> None:
    """Note what the network is worth in closed loop, in every scenario of which that is not yet known."""
    turn, segment, threshold = which
    policy, known = shop.spec.policy(shop.network, threshold), {row["scenario"] for row in log.of(*which)}
    for name in shop.course.scenarios:
        if name in known:
            shop.driven(len(seeds))
            continue
        found = summary(drive(policy, shop.envs(name), seeds, shop.driven))
        kind = {"round": turn, "segment": segment, "scenario": name, "loss": round(loss, 5), "threshold": threshold}
        log.add({**kind, **found})


def _keep_best(shop: _Workshop) -> None:
    """Validate the best checkpoints at every threshold on further seeds, and save the winner as the model."""
    course, log = shop.course, shop.finals
    seeds = range(FINAL_SEEDS, FINAL_SEEDS + course.final_validation)
    finalists: list[tuple[int, int, float]] = []
    for turn, segment, _ in shop.log.ranked()[:FINALISTS]:
        loss = shop.load(turn, segment)
        for threshold in course.thresholds:
            finalists.append((turn, segment, threshold))
            _validate(shop, log, finalists[-1], loss, seeds)
    best, *_ = log.ranked()
    shop.load(*best[:2])
    notes = {
        "course": json.loads(json.dumps(asdict(course))), "chosen": log.note(*best),
        "finalists": [log.note(*which) for which in finalists],
    }  # fmt: skip
    save_model(shop.folder, SavedModel(shop.network, best[2], notes, shop.spec))


def checkpoint(folder: Path, turn: int, segment: int) -> Path:
    """Where the network is kept as it was after a segment."""
    return folder / "checkpoints" / f"round_{turn}_segment_{segment}.safetensors"
