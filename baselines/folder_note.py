"""A note in a folder that says what its files are made with, so that results of different settings never mix."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cad_env.checks import ConfigError
from cad_env.files import FileError, read_json_object, replace_text, shortened

MAY_DIFFER = ("command",)  # it is for readers: several commands give the same results


def claim(path: Path, wanted: Mapping[str, Any], advice: str) -> None:
    """Write the note, or compare it with the one that is there.

    ConfigError, one line that ends in `advice`, if they differ or that one is damaged.
    """
    wanted = json.loads(json.dumps(wanted))  # as it is when it is read back
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_text(path, json.dumps(wanted, indent=2) + "\n")
        return
    try:
        found = read_json_object(path)
    except FileError as error:
        raise FileError(path, f"{error.args[1]}: {advice}") from None
    if change := difference(found, wanted):
        raise ConfigError(f"{path.parent} holds a run with {change}: {advice}")


def difference(before: Mapping[str, Any], now: Mapping[str, Any], may_differ: Sequence[str] = MAY_DIFFER) -> str:
    """The first setting that differs, in words; empty if none does.

    >>> difference({"depth": 15}, {"depth": 2})
    'another depth (15, now 2)'
    """
    for name in [*now, *before]:
        if before.get(name) != now.get(name) and name not in may_differ:
            return f"another {name} ({_short(before.get(name))}, now {_short(now.get(name))})"
    return ""


def _short(value: object) -> str:
    return shortened(json.dumps(value), 120)
