"""From nothing to a policy: record the expert, clone it, let the clone drive while the expert labels, keep the best.

One network of any spec learns all scenarios of its config, under all its conditions: each scenario under each condition
is a *cell*. The stages of a run write files, so a killed run resumes after the last stage it finished. Every stage
draws its random numbers from (seed, stage), so stopping and resuming changes nothing.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from cad_env.checks import check_path
from cad_env.conditions import condition_named
from cad_env.config import radio_config
from cad_env.envs.vector import CADVectorEnv
from policies.model_folder import SavedModel, load_model, save_model
from policies.registry import spec_named
from policies.spec import Frames, NetworkSpec
from policies.training.cloning import drive_episodes, fit, load_state, save_state
from policies.training.config import (
    DAGGER_SEEDS,
    DRIVEN_COST,
    EXPERT_SEEDS,
    FINAL_SEEDS,
    FINALISTS,
    NOMINAL,
    REPLAYED_COST,
    VALIDATION_SEEDS,
    Advance,
    TrainingCell,
    TrainingConfig,
    small_seed,
)
from policies.training.demonstrations import Demonstrations, record
from policies.training.frame_cache import frames_of
from policies.training.validation_log import Log, summary

SIDE_BY_SIDE = 32
CHECKPOINTS_LOG = "metrics.csv"  # what each checkpoint was worth
FINALISTS_LOG = "finalists.csv"  # what the best were worth, at every threshold
VALIDATED_AT = 0.5  # threshold, after each segment


@dataclass(frozen=True)
class _Run:
    """What the stages of a training run work with."""

    config: TrainingConfig
    folder: Path
    demonstrations: Path  # of the expert, shared by all networks
    spec: NetworkSpec
    network: nn.Module
    optimiser: torch.optim.Adam
    log: Log  # of every checkpoint
    finals: Log  # of the best, at every threshold
    advance: Advance

    @property
    def dagger_folder(self) -> Path:
        """Where the episodes are that the network drove and the expert labelled."""
        return self.folder / "dagger_rounds"

    def driven(self, episodes: int) -> None:
        """Tell of episodes that the network drove."""
        self.advance(DRIVEN_COST * episodes)

    def envs(self, cell: TrainingCell) -> CADVectorEnv:
        """Scenes as the network is to drive in them, as it is now."""
        return self._envs(cell, self.spec.environment(self.network))

    def replayed(self, cell: TrainingCell) -> CADVectorEnv:
        """Scenes to look at what was recorded in."""
        return self._envs(cell, self.spec.replayed(self.network))

    def taught(self, cell: TrainingCell) -> CADVectorEnv:
        """Scenes to record the teacher in, if it is not the expert that all networks share."""
        return self._envs(cell, {})

    def _envs(self, cell: TrainingCell, needs: dict[str, Any]) -> CADVectorEnv:
        config = self.config
        decided = condition_named(cell.condition).options(radio_config(config.radio))
        known = {"coverage": True} if config.waits else {}
        return CADVectorEnv(SIDE_BY_SIDE, scenario=cell.scenario, depth=config.depth, **decided, **{**known, **needs})

    def fitted(self, turn: int, segment: int) -> bool:
        """Whether a segment has its checkpoint."""
        return checkpoint(self.folder, turn, segment).exists()

    def load(self, turn: int, segment: int) -> float:
        """Go back to the network and the optimiser as they were after a segment; gives its loss."""
        return load_state(checkpoint(self.folder, turn, segment), self.network, self.optimiser)


def record_demonstrations(folder: str | Path, scenario: str, episodes: int, advance: Advance) -> list[Demonstrations]:
    """The expert's episodes of a scenario, kept in `folder`/<scenario>; it sees the truth, so nothing is sent."""
    folder = check_path("folder", folder)
    envs = CADVectorEnv(SIDE_BY_SIDE, scenario=scenario, radio="none")
    return record(folder / scenario, envs, None, range(EXPERT_SEEDS, EXPERT_SEEDS + episodes), advance)


def train_network(
    config: TrainingConfig,
    folder: str | Path,
    advance: Advance,
    demonstrations: str | Path | None = None,
) -> None:
    """Train one network into `folder` (the model and how it came about), resuming where it stopped.

    `demonstrations` is where the expert's episodes are, or are put; several networks may share it.
    """
    folder = check_path("folder", folder)
    shared = folder / "demonstrations" if demonstrations is None else check_path("demonstrations", demonstrations)
    torch.set_num_threads(1)  # the graphs are small: a second thread waits more than it works
    if (folder / "config.json").exists():
        load_model(folder)
        advance(config.work())
        return
    folder.mkdir(parents=True, exist_ok=True)
    spec = spec_named(config.spec)
    network = spec.build(config.network, seed=small_seed(config.seed))
    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    log, finals = Log(folder / CHECKPOINTS_LOG), Log(folder / FINALISTS_LOG)
    run = _Run(config, folder, shared, spec, network, optimiser, log, finals, advance)
    frames: dict[str, Frames] = {}
    known = 0  # rounds whose frames are in there
    for turn in range(config.dagger_rounds + 1):
        if not all(run.fitted(turn, segment) for segment in range(config.segments)):
            for missing in range(known, turn + 1):
                _learn_of(run, missing, frames)
            known = turn + 1
        _round(run, turn, frames)
    _keep_best(run)


def _learn_of(run: _Run, turn: int, frames: dict[str, Frames]) -> None:
    """Add the frames of a round, of every cell, as the network meets them."""
    for cell in run.config.cells():
        envs, parts, name = run.replayed(cell), [], str(cell)
        folder = (run.dagger_folder if turn else run.demonstrations) / cell.scenario / "frames"
        for recorded in _recorded(run, turn, cell):
            parts.append(frames_of(folder, recorded, envs, run.spec, run.network))
            run.advance(REPLAYED_COST * len(recorded))
        before = [frames.pop(name)] if name in frames else []
        first, *others = [*before, *parts]
        del before, parts
        frames[name] = first.joined(others) if others else first


def _recorded(run: _Run, turn: int, cell: TrainingCell) -> list[Demonstrations]:
    """The episodes of a round: driven by the teacher at first, then by the network as it was before the round."""
    config = run.config
    if turn == 0:
        return _demonstrated(run, cell)
    seeds = config.seeds_of(cell, DAGGER_SEEDS + turn * 10_000, config.dagger_episodes)
    shards = run.dagger_folder / cell.scenario / f"round_{turn}{_under(cell)}"
    policy = run.spec.policy(run.network, 0.5)
    return record(shards, run.envs(cell), policy, seeds, run.driven, config.mixing**turn, config.waits)


def _demonstrated(run: _Run, cell: TrainingCell) -> list[Demonstrations]:
    """The episodes that the teacher drives. Where it waits, they belong to the condition, and to these seeds of it."""
    config = run.config
    if config.learns_from_shared:
        return record_demonstrations(run.demonstrations, cell.scenario, config.episodes, lambda done: None)
    seeds = config.seeds_of(cell, EXPERT_SEEDS, config.episodes)
    folder = run.demonstrations / cell.scenario / f"{config.teacher}_{seeds.start}-{seeds.stop - 1}{_under(cell)}"
    return record(folder, run.taught(cell), None, seeds, lambda n: run.advance(REPLAYED_COST * n), waits=config.waits)


def _under(cell: TrainingCell) -> str:
    """What the name of a folder says of the condition."""
    return "" if cell.condition == NOMINAL else f"_{cell.condition}"


def _round(run: _Run, turn: int, frames: Mapping[str, Frames]) -> None:
    """Fit the network to the frames so far, in segments, each validated in closed loop in every cell."""
    config = run.config
    before, total = (sum(map(config.steps_of, range(rounds))) for rounds in (turn, config.dagger_rounds + 1))
    size = config.steps_of(turn) // config.segments
    for segment in range(config.segments):
        if run.fitted(turn, segment):
            loss = run.load(turn, segment)
            run.advance(size)
        else:
            run.log.forget(turn, segment)
            rng = np.random.default_rng([config.seed, turn, segment])
            steps = range(before + segment * size, before + (segment + 1) * size)
            loss = fit(run.spec, run.network, run.optimiser, frames, config, steps, total, rng, run.advance)
            save_state(checkpoint(run.folder, turn, segment), run.network, run.optimiser, loss)
        _validate(run, run.log, (turn, segment, VALIDATED_AT), loss, (VALIDATION_SEEDS, config.validation))


def _validate(run: _Run, log: Log, which: tuple[int, int, float], loss: float, episodes: tuple[int, int]) -> None:
    """Note what the network is worth in closed loop, in every cell of which that is not yet known.

    episodes: the first seed of a scenario, and how many.
    """
    turn, segment, threshold = which
    policy, rows = run.spec.policy(run.network, threshold), log.of(*which)
    known = {(row["scenario"], row["condition"]) for row in rows}
    for cell in run.config.cells():
        seeds = run.config.seeds_of(cell, *episodes)
        if cell in known:
            run.driven(len(seeds))
            continue
        found = summary(drive_episodes(policy, run.envs(cell), seeds, run.driven))
        kind = {"round": turn, "segment": segment, "loss": round(loss, 5), "threshold": threshold}
        log.add({**kind, **cell._asdict(), **found})


def _keep_best(run: _Run) -> None:
    """Validate the best checkpoints at every threshold on further seeds, and save the winner as the model."""
    config, log = run.config, run.finals
    finalists: list[tuple[int, int, float]] = []
    for turn, segment, _ in run.log.ranked()[:FINALISTS]:
        loss = run.load(turn, segment)
        for threshold in config.thresholds:
            finalists.append((turn, segment, threshold))
            _validate(run, log, finalists[-1], loss, (FINAL_SEEDS, config.final_validation))
    best, *_ = log.ranked()
    run.load(*best[:2])
    notes = {
        "config": json.loads(json.dumps(asdict(config))), "chosen": log.note(*best),
        "finalists": [log.note(*which) for which in finalists],
    }  # fmt: skip
    save_model(run.folder, SavedModel(run.network, best[2], notes, run.spec))


def checkpoint(folder: Path, turn: int, segment: int) -> Path:
    """Where the network is kept as it was after a segment."""
    return folder / "checkpoints" / f"round_{turn}_segment_{segment}.safetensors"
