"""A method in a scenario, resolved: what a process needs to drive it, made once however many tasks it gets."""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from baselines.evaluation.settings import Settings
from baselines.methods import Method, method_named
from baselines.references import is_reference, source_of
from cad_env.types import Command, Policy

MODEL_FILES = ("model.safetensors", "config.json")


@dataclass(frozen=True)
class Job:
    """One method in one scenario."""

    scenario: str
    method: Method
    options: dict[str, Any]  # of the environment: what is shared, and what its network needs
    policy: Policy


def job_of(settings: Settings, scenario: str, name: str) -> Job:
    """A method as it drives in a scenario. ValueError for models that are not there or are damaged."""
    return _job(settings, scenario, name, digest_of_method(settings, name))


def digest_of_method(settings: Settings, name: str) -> str | None:
    """What a method's decisions depend on beside the settings: its model, its source if it is from outside.

    None for rules that ship: `version()` covers them.
    """
    method, known = method_named(name), hashlib.sha256()
    if method.model is None and not is_reference(name):
        return None
    if method.model is not None:
        folder = settings.models_folder() / method.model
        if not folder.is_dir():
            raise ValueError(
                f"no trained model for {name}: there is no folder {folder}; train.py --method {name} trains it"
            )
        for file in MODEL_FILES:
            known.update((folder / file).read_bytes() if (folder / file).exists() else b"")
    if is_reference(name):
        known.update(source_of(name))
    return known.hexdigest()[:16]


@lru_cache(maxsize=16)
def _job(settings: Settings, scenario: str, name: str, _: str | None) -> Job:
    method = method_named(name)
    options = settings.environment(scenario, method)
    if method.make_policy is not None:
        return Job(scenario, method, options, method.make_policy(scenario))
    assert method.learned is not None
    from cad_env.scenarios import scenario_named
    from policies.model_folder import load_model  # here, because torch takes a second that the others need not wait

    model = load_model(settings.models_folder() / method.learned.model)
    known, asked = getattr(model.network.config, "commands", len(Command)), scenario_named(scenario).command_count
    if known != asked:
        raise ValueError(f"the model of {name} knows {known} commands, and {scenario} has {asked}: train one for it")
    if method.learned.shares in ("points", "features"):
        options = {**options, **model.environment()}
    policy = model.policy()
    if settings.threshold is not None and hasattr(policy, "threshold"):
        policy.threshold = settings.threshold
    return Job(scenario, method, options, policy)
