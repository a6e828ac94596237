"""A control by its name."""

from baselines.controls.names import parsed_control
from cad_env.rules.blind import BEFORE, Blind, Control, Slow, Stop, conflict_of


def control(name: str, scenario: str) -> Control:
    """The control of this name in a scenario; ValueError, one line, for a wrong number."""
    kind, number = parsed_control(name)
    if kind == "blind":
        return Blind(number)
    return Slow(number) if kind == "slow" else Stop(conflict_of(scenario) - BEFORE, number)
