"""How a method is trained in a run: its training config, and what is noted in its folder."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from baselines.folder_note import claim
from baselines.methods import LearnedMethod, learned_named, shipped_models
from baselines.references import is_reference, module_source
from cad_env.checks import ConfigError, check_whole, did_you_mean
from cad_env.files import MOST_DATA_BYTES, read_file
from policies.registry import spec_named
from policies.training.config import STEPS, VALIDATION, Advance, TrainingConfig
from policies.training.ppo_config import PpoConfig

NOTE_OF_TRAINING = "training.json"  # in the folder of a model: what it is trained with
DECISION = 0.05  # work of a decision that is learned from by reward; an optimiser step of cloning is 1


@dataclass(frozen=True)
class TrainingTask:
    """One method, trained from one seed."""

    method: str
    config: TrainingConfig
    folder: Path  # of its model
    demonstrations: Path  # of the expert, shared by all tasks

    @property
    def scenarios(self) -> tuple[str, ...]:
        """What the network learns."""
        return self.config.scenarios

    @property
    def learns_from_shared(self) -> bool:
        """Whether it needs the demonstrations that methods share."""
        return self.config.learns_from_shared

    def work(self) -> float:
        """All that `perform` tells of."""
        return self.config.work()

    def noted(self) -> dict[str, Any]:
        """What its model is trained with."""
        return asdict(self.config)

    def perform(self, advance: Advance) -> None:
        """Train, or resume where that stopped."""
        from policies.training.dagger import train_network  # here, because torch takes a second that --help need not

        train_network(self.config, self.folder, advance, self.demonstrations)


@dataclass(frozen=True)
class RewardTask:
    """One method that learns by reward, from one seed."""

    method: str
    config: PpoConfig
    decisions: int  # to learn from
    seed: int
    scenarios: tuple[str, ...]
    folder: Path  # of its model
    learns_from_shared: bool = False

    def work(self) -> float:
        """All that `perform` tells of, but for what rounding up to whole parts adds."""
        return DECISION * self.decisions

    def noted(self) -> dict[str, Any]:
        """What its model is trained with."""
        told = {"decisions": self.decisions, "seed": self.seed, "scenarios": self.scenarios}
        clone = None if self.config.clone is None else _weights_of(self.config.clone)  # wherever they are kept
        return {**asdict(self.config), **told, "clone": clone}

    def perform(self, advance: Advance) -> None:
        """Train, or resume where that stopped."""
        from policies.training.ppo import train_ppo  # here, because torch takes a second that --help need not wait

        def advanced(done: float) -> None:
            advance(DECISION * done)

        train_ppo(self.folder, self.decisions, self.seed, self.scenarios, advanced, self.config)


def _weights_of(folder: str) -> str:
    """Digest of the weights of a model."""
    from policies.model_folder import WEIGHTS

    return hashlib.sha256(read_file(Path(folder) / WEIGHTS, MOST_DATA_BYTES)).hexdigest()[:16]


def ppo_config(method: LearnedMethod, **settings: Any) -> PpoConfig:
    """How a method that learns by reward is trained, by the settings of PpoConfig that a run is asked for."""
    network = spec_named(method.spec).config_type(**method.config)
    if method.begins_with is not None and settings.get("clone") is None:
        settings["clone"] = str(shipped_models() / method.begins_with)
    elif method.begins_with is None and settings.get("clone") is not None:
        raise ConfigError(f"{method.name} begins with no clone, got clone={settings['clone']}: use ppo-from-clone")
    return PpoConfig(network=network, **settings)


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


def claim_folder(task: TrainingTask | RewardTask) -> None:
    """Note in the folder what its model is trained with; ValueError if it was begun with something else."""
    from cad_env.scenarios.registry import outside_sources
    from cad_env.version import version

    sources = {what: digest for name in task.scenarios for what, digest in outside_sources(name).items()}
    if is_reference(task.method):
        sources[f"source of {task.method}"] = hashlib.sha256(module_source(task.method)).hexdigest()[:16]
    wanted = {**task.noted(), "version of cad_env": version(), **sources}
    claim(task.folder / NOTE_OF_TRAINING, wanted, "use another --out or delete it")


def perform_training(task: TrainingTask | RewardTask, advance: Advance) -> None:
    """Train the method into its folder, or resume where that stopped."""
    learned_named(task.method)  # makes a network spec from outside known in this process
    claim_folder(task)
    task.perform(advance)
