"""One occlusion story a file: a map, its routes, and a draw of a actors and the traffic around it from a seed."""

from collections.abc import Mapping
from types import MappingProxyType

from cad_env.scenarios.left_turn import LEFT_TURN
from cad_env.scenarios.overtaking import OVERTAKING
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.street_crossing import STREET_CROSSING

SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {scenario.name: scenario for scenario in (LEFT_TURN, OVERTAKING, STREET_CROSSING)}
)


def scenario_named(name: str) -> Scenario:
    """The scenario called `name`; ValueError that lists the choices otherwise."""
    if not isinstance(name, str) or name not in SCENARIOS:
        raise ValueError(f"unknown scenario {name!r}: choose among {', '.join(SCENARIOS)}")
    return SCENARIOS[name]
