"""How a method is trained in a run: its training config, and what is noted in its folder."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from baselines.folder_note import claim
from baselines.methods import LearnedMethod, learned_named
from baselines.references import is_reference, module_source
from cad_env.checks import ConfigError, check_whole, did_you_mean
from policies.registry import spec_named
from policies.training.config import STEPS, VALIDATION, Advance, TrainingConfig

NOTE_OF_TRAINING = "training.json"  # in the folder of a model: what it is trained with


@dataclass(frozen=True)
class TrainingTask:
    """One method, trained from one seed."""

    method: str
    config: TrainingConfig
    folder: Path  # of its model
    demonstrations: Path  # of the expert, shared by all tasks


def training_config(
    method: LearnedMethod, overrides: Mapping[str, Any], network: Mapping[str, Any] | None = None
) -> TrainingConfig:
    """The training config of a method in a run: its own overrides go before those of the run.

    `network` are settings of its network, which go before those of the method. ValueError for what is impossible.
    """
    steps, validation = (overrides.get(name, getattr(TrainingConfig, name)) for name in ("steps", "validation"))
    steps, validation = check_whole("steps", steps, *STEPS), check_whole("validation", validation, *VALIDATION)
    if method.most_validated is not None:
        validation = min(validation, method.most_validated)
    given = {
        **overrides, "spec": method.spec, "steps": max(round(method.pace * steps), 3), "validation": validation,
        "final_validation": validation * 5 // 3, **method.training,
    }  # fmt: skip
    if method.shares == "nothing":
        given["radio"] = "none"
    known = [each.name for each in fields(TrainingConfig)]
    if unknown := [name for name in given if name not in known]:
        choices = f"choose among {', '.join(known)}{did_you_mean(unknown[0], known)}"
        raise ConfigError(f"unknown training setting {unknown[0]!r} of {method.name}: {choices}")
    settings = {**method.config, **(network or {})}
    if settings:
        given["network"] = spec_named(method.spec).config_type(**settings)
    return TrainingConfig(**given)


def claim_folder(task: TrainingTask) -> None:
    """Note in the folder what its model is trained with; ValueError if it was begun with something else."""
    from cad_env.scenarios.registry import outside_sources
    from cad_env.version import version

    sources = {what: digest for name in task.config.scenarios for what, digest in outside_sources(name).items()}
    if is_reference(task.method):
        sources[f"source of {task.method}"] = hashlib.sha256(module_source(task.method)).hexdigest()[:16]
    wanted = {**asdict(task.config), "version of cad_env": version(), **sources}
    claim(task.folder / NOTE_OF_TRAINING, wanted, "use another --out or delete it")


def perform_training(task: TrainingTask, advance: Advance) -> None:
    """Train the method into its folder, or resume where that stopped."""
    from policies.training.dagger import train_network  # here, because torch takes a second that --help need not wait

    learned_named(task.method)  # makes a network spec from outside known in this process
    claim_folder(task)
    train_network(task.config, task.folder, advance, task.demonstrations)
