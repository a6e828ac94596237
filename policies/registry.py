"""Kinds of network by name, one module each with its `SPEC`; torch comes with the first one that is asked for."""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from policies.spec import NetworkSpec

SPECS: Mapping[str, str] = MappingProxyType(  # name -> module
    {
        "stgraph": "policies.stgraph.spec",
        "command": "policies.command",
        "point_transformer": "policies.points.point_transformer",
        "compressed": "policies.points.compressed",
    }
)


def spec_named(name: str) -> "NetworkSpec":
    """The spec called `name`; ValueError that lists the choices otherwise."""
    if name not in SPECS:
        raise ValueError(f"unknown spec {name!r}: choose among {', '.join(SPECS)}")
    spec: NetworkSpec = import_module(SPECS[name]).SPEC
    return spec
