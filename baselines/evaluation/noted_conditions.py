"""What is met in the episodes of a run, as its settings.json notes it: for whoever prints its numbers."""

from collections.abc import Mapping
from typing import Any

from cad_env.conditions import Condition

_DECIDING = ("traffic", "penetration", "collaborators")


def noted_conditions(settings: Mapping[str, Any]) -> dict[str | None, Condition]:
    """The conditions of a run by their names; under None what its settings say, if none was named.

    >>> noted_conditions({"penetration": 0.1})[None].words
    'light traffic; each vehicle connected by itself with probability 0.1'
    """
    if named := settings.get("condition"):
        return {name: Condition(name, "noted", **values) for name, values in named.items()}
    said = {name: settings[name] for name in _DECIDING if settings.get(name) is not None}
    return {None: Condition("unnamed", "noted", **said)}


def met_in_words(settings: Mapping[str, Any]) -> list[str]:
    """A line for each condition of a run, with who is connected: no number of it should stand without."""
    return [f"{name or 'In every episode'}: {each.words}." for name, each in noted_conditions(settings).items()]
