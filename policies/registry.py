"""Network specs by name, one module each with its `SPEC`; torch comes with the first one that is asked for."""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

from cad_env.checks import ConfigError, did_you_mean

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
_registered: "dict[str, NetworkSpec]" = {}


def register_spec(spec: "NetworkSpec", name: str = "") -> None:
    """Make a network spec from outside known in this process, by its own name or another.

    ValueError for a name that is one of those that ship.
    """
    name = name or spec.name
    if name in SPECS:
        raise ValueError(f"network spec {name!r} ships with the project: choose another name")
    _registered[name] = spec


def spec_named(name: str) -> "NetworkSpec":
    """The network spec called `name`; ValueError that lists the choices otherwise.

    A model folder names its spec, and a file must not make this process import anything: specs from outside are found
    only after `register_spec`, which naming them on a command line does.
    """
    if name in _registered:
        return _registered[name]
    if name not in SPECS:
        known = [*SPECS, *_registered]
        hint = f"; name it as a method ({name}) to use it" if ":" in name else did_you_mean(name, known)
        raise ConfigError(f"unknown spec {name!r}: choose among {', '.join(known)}{hint}")
    spec: NetworkSpec = import_module(SPECS[name]).SPEC
    return spec
