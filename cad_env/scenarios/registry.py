"""Scenarios by name: those that ship, those that were registered, and those that installed packages bring."""

import sys
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym

from cad_env.checks import ConfigError, did_you_mean
from cad_env.scenarios.left_turn import LEFT_TURN
from cad_env.scenarios.overtaking import OVERTAKING
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.street_crossing import STREET_CROSSING
from cad_env.scenarios.unsignalised import UNSIGNALISED
from cad_env.types import COMMANDS, MAX_STEPS
from cad_env.version import PACKAGE, code_digest

GROUP = "cad_env.scenarios"  # entry points of installed packages: a scenario each, under its own name
ENVIRONMENT, VECTOR = "cad_env.envs.single:CADEnv", "cad_env.envs.vector:CADVectorEnv"

_STORIES = (LEFT_TURN, OVERTAKING, STREET_CROSSING)
_known: dict[str, Scenario] = {scenario.name: scenario for scenario in (*_STORIES, UNSIGNALISED)}
_found_at: dict[str, str] = {}  # name -> module:attribute, where a scenario came by such a reference
SHIPPED = tuple(scenario.name for scenario in _STORIES)  # what "all" scenarios are: those in which one ego decides
PACKAGED = tuple(_known)  # names of all that need no registration
SCENARIOS: Mapping[str, Scenario] = MappingProxyType(_known)  # live: the shipped ones, then as they were registered


def register(scenario: Scenario) -> Scenario:
    """Make a scenario known by its name and its Gymnasium id; ValueError, one line, if another one has either.

    To register the same one again changes nothing. Gives the one that is known.
    """
    if not isinstance(scenario, Scenario):
        raise ValueError(f"a scenario must be a cad_env.scenarios.scenario.Scenario, got {scenario!r}")
    name, gym_id = scenario.name, scenario.gym_id
    if name in _known:
        if _known[name] == scenario:
            return _known[name]
        raise ValueError(f"scenario {name!r} ({gym_id}) is known already, as another one: choose another name")
    taken = gym.registry.get(gym_id)
    if taken is not None and (taken.entry_point, taken.kwargs.get("scenario")) != (ENVIRONMENT, name):
        raise ValueError(f"another environment has the id {gym_id!r} already: choose another gym_id for {name!r}")
    if taken is None:
        # The object and not its name, so that a process to which this is handed on learns of it.
        gym.register(
            gym_id, ENVIRONMENT, max_episode_steps=MAX_STEPS, vector_entry_point=VECTOR, kwargs={"scenario": scenario}
        )
    _known[name] = scenario
    return scenario


def scenario_named(given: Any) -> Scenario:
    """A scenario by its name, by `module:attribute`, or as it is; ValueError that lists the choices otherwise.

    One that was not known is registered.
    """
    if isinstance(given, Scenario):
        return register(given)
    if isinstance(given, str) and given not in _known:
        if ":" in given:
            return _referred(given, given)
        if given in _installed():
            return _referred(_installed()[given].value, given)
    if not isinstance(given, str) or given not in _known:
        choices = scenario_names()
        near = did_you_mean(given, choices)
        raise ConfigError(f"unknown scenario {given!r}: choose among {', '.join(choices)}{near}")
    return _known[given]


def scenario_names() -> list[str]:
    """All names that `scenario_named` takes: those that are known, then those of installed packages."""
    return [*_known, *(name for name in _installed() if name not in _known)]


def scenario_of_id(gym_id: str) -> Scenario:
    """The scenario of a Gymnasium id; ValueError that lists the choices otherwise."""
    found = gym.registry.get(gym_id.removeprefix("cad_env:")) if isinstance(gym_id, str) else None
    scenario = found.kwargs.get("scenario") if found is not None and found.entry_point == ENVIRONMENT else None
    if scenario is None:
        ids = [spec.id for spec in gym.registry.values() if spec.entry_point == ENVIRONMENT and spec.kwargs["scenario"]]
        near = did_you_mean(gym_id, ids)
        raise ConfigError(f"unknown environment {gym_id!r}: choose among {', '.join(ids)}{near}")
    return scenario_named(scenario)


def commands_of(names: Iterable[str]) -> int:
    """How many commands some scenarios have; ValueError, one line, if their observations would not be of one shape."""
    counts = {name: scenario_named(name).command_count for name in names}
    if len(set(counts.values())) > 1:
        said = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise ValueError(f"scenarios side by side must have equally many commands, got {said}")
    return next(iter(counts.values()), COMMANDS)


def registered() -> tuple[str | Scenario, ...]:
    """What another process must hand to `scenario_named` to know all that is known here."""
    return tuple(_found_at.get(name, scenario) for name, scenario in _known.items() if name not in PACKAGED)


def outside_sources(name: str) -> dict[str, str]:
    """What results of a scenario are marked with beside the version of cad_env: a digest of its package's code.

    Nothing for one of this package, whose code that version covers.
    """
    if name in PACKAGED:
        return {}
    return {f"source of {name}": _source_of(scenario_named(name))}


@cache
def _installed() -> Mapping[str, EntryPoint]:
    """Scenarios of installed packages, by name; none is imported."""
    return {entry.name: entry for entry in entry_points(group=GROUP)}


def _referred(reference: str, asked: str) -> Scenario:
    """The scenario at `module:attribute`, registered; ValueError, one line, where there is none."""
    module, _, attribute = reference.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"scenario {asked!r} cannot be imported: {error}") from None
    if not isinstance(found, Scenario):
        raise ValueError(f"scenario {asked!r} is not a Scenario but {found!r}")
    if asked != reference and found.name != asked:
        raise ValueError(f"the entry point {asked!r} must have the name of its scenario, {found.name!r}")
    scenario = register(found)
    _found_at.setdefault(scenario.name, reference)
    return scenario


@cache
def _source_of(scenario: Scenario) -> str:
    parts = (scenario.ranges, scenario.network, scenario.actors, scenario.background, scenario.expert)
    names = {str(getattr(part, "__module__", "")).partition(".")[0] for part in parts if part is not None}
    return code_digest(sorted(place for name in names if (place := _folder_of(name)) not in (None, PACKAGE)))


def _folder_of(name: str) -> Path | None:
    """The folder of a top-level package or the file of a top-level module; None where there is no file."""
    source = getattr(sys.modules.get(name), "__file__", None)
    if source is None:
        return None
    return Path(source).parent if Path(source).name == "__init__.py" else Path(source)
