"""What marks the answers of a network, beside `cad_env.version.version()`: a digest of the code that it is made of."""

import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from cad_env.version import code_digest

POLICIES = Path(__file__).parent
# What networks of every kind are built from, beside what stands in the package of their own.
SHARED_CODE = ("layers.py", "observation_spec.py", "spec.py", "threshold_policy.py")


@cache
def network_version(module: str) -> str:
    """Twelve letters that change when the code of networks in a module does, e.g. policies.stgraph.spec.

    Covered are all of its package, or the file alone where it is in none, and what networks share.
    """
    if module in sys.modules:
        source = Path(str(sys.modules[module].__file__))
    else:  # found without importing it: tables are made without torch
        found = find_spec(module)
        source = Path(str(found.origin if found else None))
    own = source.parent if (source.parent / "__init__.py").exists() and source.parent != POLICIES else source
    return code_digest([own, *(POLICIES / part for part in SHARED_CODE)])
