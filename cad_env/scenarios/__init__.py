"""One occlusion story a file: a map, its routes, and a draw of the actors and the traffic around it from a seed."""

from cad_env.scenarios.registry import (
    SCENARIOS,
    SHIPPED,
    outside_sources,
    register,
    registered,
    scenario_named,
    scenario_names,
)

__all__ = ["SCENARIOS", "SHIPPED", "outside_sources", "register", "registered", "scenario_named", "scenario_names"]
