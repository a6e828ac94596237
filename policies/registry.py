"""Kinds of network by name, one module each with its `FAMILY`; torch comes with the first one that is asked for."""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from policies.spec import Family

FAMILIES: Mapping[str, str] = MappingProxyType(  # name -> module
    {
        "stgraph": "policies.stgraph.spec",
        "command": "policies.command",
        "point_transformer": "policies.points.point_transformer",
        "compressed": "policies.points.compressed",
    }
)


def family_named(name: str) -> "Family":
    """The family called `name`; ValueError that lists the choices otherwise."""
    if name not in FAMILIES:
        raise ValueError(f"unknown family {name!r}: choose among {', '.join(FAMILIES)}")
    family: Family = import_module(FAMILIES[name]).FAMILY
    return family
