"""A method in a scenario, resolved: its policy and its environment, made once in each process that drives it."""

import hashlib
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from baselines.controls import names
from baselines.controls.names import BEST_BLIND, best_control, is_control
from baselines.evaluation.settings import Settings
from baselines.methods import Method, how_to_train, method_named, shipped_models
from baselines.references import is_reference, module_source
from baselines.signals import import_whole
from cad_env.checks import ConfigError
from cad_env.config import RADIO_PRESETS
from cad_env.files import MOST_DATA_BYTES, read_file
from cad_env.types import Command, Policy
from cad_env.version import code_digest

MODEL_FILES = ("model.safetensors", "config.json")
CACHED = 16  # jobs that a process keeps


@dataclass(frozen=True)
class Job:
    """One method in one scenario."""

    scenario: str
    method: Method
    radio: str  # the preset it drives over: none if nothing is sent to it
    options: dict[str, Any]  # of the environment
    policy: Policy


def job_of(settings: Settings, scenario: str, name: str, condition: str | None = None) -> Job:
    """A method as it drives in a scenario. ValueError for an unknown method, and for a missing or damaged model.

    It is made anew only when its model or source has changed. condition: one of `settings.conditions()`.
    """
    return _job(settings, scenario, name, condition, digest_of_method(settings, name))


def digest_of_method(settings: Settings, name: str) -> str | None:
    """What a method's decisions depend on beside the settings: its model, and its source if it is from outside.

    Of a control it is its code, and of the best one what was chosen. None for other rules that ship: `version()` covers
    them.
    """
    method, known = method_named(name), hashlib.sha256()
    if name == BEST_BLIND or is_control(name):
        chosen = [best_control(scenario) for scenario in settings.scenarios()] if name == BEST_BLIND else []
        return hashlib.sha256(" ".join([code_of_controls(), *chosen]).encode()).hexdigest()[:16]
    if method.model is None and not is_reference(name):
        return None
    if method.model is not None:
        import_whole("policies.model_folder")
        folder = settings.models_folder() / method.model
        if not folder.is_dir():
            raise ConfigError(_untrained(settings, name, folder))
        for file in MODEL_FILES:
            known.update(read_file(folder / file, MOST_DATA_BYTES) if (folder / file).exists() else b"")
        known.update(_code_of_network(method).encode())
    if is_reference(name):
        known.update(module_source(name))
    return known.hexdigest()[:16]


@cache
def code_of_controls() -> str:
    """Digest of the code of the controls."""
    return code_digest([Path(names.__file__).parent])


def _untrained(settings: Settings, name: str, folder: Path) -> str:
    """Why a method cannot drive that has no model, and what to do."""
    from cad_env.scenarios import SHIPPED

    scenarios = settings.scenarios()
    if settings.models and (shipped_models() / folder.name).is_dir():
        how = "leave out --models for the model that ships"
    else:
        how = how_to_train(name, () if set(scenarios) <= set(SHIPPED) else scenarios)
    return f"{name} needs training, and {folder.parent} has no model of it: {how}"


def _code_of_network(method: Method) -> str:
    """Digest of the code of a learned method's network; that of one from outside is its module's, beside."""
    from policies.registry import SPECS
    from policies.version import network_version

    spec = "" if method.learned is None else method.learned.spec
    return network_version(SPECS[spec]) if spec in SPECS else ""


@lru_cache(CACHED)
def _job(settings: Settings, scenario: str, name: str, condition: str | None, _: str | None) -> Job:
    method = method_named(name)
    radio = settings.radio if method.shares else "none"
    options = settings.environment(scenario, condition)
    options["depth"] = min(settings.depth, method.depth)
    if method.coverage:
        options["coverage"] = True
    if not method.shares:
        options["radio"] = RADIO_PRESETS["none"]
        if condition is not None:  # whoever else is connected has nothing to say to it
            options |= {"penetration": 0.0, "ranges": {}}
    if method.make_policy is not None:
        return Job(scenario, method, radio, options, method.make_policy(scenario))
    from cad_env.scenarios import scenario_named
    from policies.model_folder import load_model  # here, because torch takes a second that the others need not wait

    assert method.model is not None
    model = load_model(settings.models_folder() / method.model)
    known, asked = getattr(model.network.config, "commands", len(Command)), scenario_named(scenario).command_count
    if known != asked:
        raise ValueError(f"the model of {name} knows {known} commands, and {scenario} has {asked}: train one for it")
    policy = model.policy()
    if settings.threshold is not None and hasattr(policy, "threshold"):
        policy.threshold = settings.threshold
    return Job(scenario, method, radio, {**options, **model.environment()}, policy)
