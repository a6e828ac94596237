"""Stories about something hidden: those that ship, one a file, and those that are registered from outside."""

import sys
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any

import gymnasium as gym

from cad_env.scenarios.left_turn import LEFT_TURN
from cad_env.scenarios.overtaking import OVERTAKING
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.street_crossing import STREET_CROSSING

ENTRY_POINTS = "cad_env.scenarios"  # the group in which an installed package names its scenarios
_known: dict[str, Scenario] = {scenario.name: scenario for scenario in (LEFT_TURN, OVERTAKING, STREET_CROSSING)}

SHIPPED = tuple(_known)  # what "all scenarios" means, whatever else is installed
SCENARIOS: Mapping[str, Scenario] = MappingProxyType(_known)  # a live view: shipped ones, then as they were registered


def register(scenario: Scenario) -> None:
    """Make a scenario known by its name, and its gym id to `gym.make`, in this process.

    Registering an equal one again does nothing; ValueError for another one of the same name or gym id.
    """
    if not isinstance(scenario, Scenario):
        raise ValueError(f"a scenario must be a cad_env.scenarios.scenario.Scenario, got {scenario!r}")
    if _known.get(scenario.name) == scenario:
        return
    for known in _known.values():
        if scenario.name == known.name or scenario.gym_id == known.gym_id:
            raise ValueError(f"scenario {scenario.name!r} ({scenario.gym_id}) is known already: choose other names")
    _known[scenario.name] = scenario
    gym.register(
        scenario.gym_id,
        entry_point="cad_env.envs.single:CADEnv",
        vector_entry_point="cad_env.envs.vector:CADVectorEnv",
        kwargs={"scenario": scenario.name},
    )


def scenario_named(scenario: Any) -> Scenario:
    """A scenario by its name, as `module:attribute`, or as the object itself, which is registered on the way.

    A name that is not known yet is looked for among the entry points of installed packages. ValueError that lists the
    choices for anything else.
    """
    if isinstance(scenario, Scenario):
        register(scenario)
        return scenario
    if not isinstance(scenario, str):
        raise ValueError(f"unknown scenario {scenario!r}: choose among {', '.join(SCENARIOS)} or give a Scenario")
    if ":" in scenario:
        return scenario_named(_imported(scenario))
    if scenario not in _known:
        for found in entry_points(group=ENTRY_POINTS):
            if found.name == scenario:
                register(found.load())
    if scenario not in _known:
        installed = {found.name for found in entry_points(group=ENTRY_POINTS)} - set(_known)
        raise ValueError(f"unknown scenario {scenario!r}: choose among {', '.join([*SCENARIOS, *sorted(installed)])}")
    return _known[scenario]


def registered() -> tuple[Scenario, ...]:
    """The scenarios from outside, to be registered in a worker process too."""
    return tuple(scenario for name, scenario in _known.items() if name not in SHIPPED)


def source_of(scenario: Scenario) -> str | None:
    """The file that draws a scenario from outside; None for one that ships, whose code `version()` covers."""
    return None if scenario.name in SHIPPED else sys.modules[scenario.actors.__module__].__file__


def _imported(reference: str) -> Scenario:
    module, _, name = reference.partition(":")
    try:
        found = getattr(import_module(module), name, None)
    except ImportError as error:
        raise ValueError(f"scenario {reference!r}: {error}") from None
    if not isinstance(found, Scenario):
        raise ValueError(f"scenario {reference!r}: {module} has no Scenario of the name {name!r}")
    return found
