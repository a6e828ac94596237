"""A note in a folder that says what its files are made with, so that results of different settings never mix."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cad_env.files import replace_file

MAY_DIFFER = ("command",)  # it is for readers: several commands give the same results


def claim(path: Path, wanted: Mapping[str, Any], advice: str) -> None:
    """Write the note, or compare it with the one that is there. ValueError, ending in `advice`, if they differ."""
    wanted = json.loads(json.dumps(wanted))  # as it is when it is read back
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, (json.dumps(wanted, indent=2) + "\n").encode())
    elif change := difference(read_note(path), wanted):
        raise ValueError(f"{path.parent} holds a run with {change}: {advice}")


def read_note(path: Path) -> dict[str, Any]:
    """The note in a file. OSError if there is none, ValueError if it is damaged."""
    try:
        found = json.loads(path.read_text())
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise ValueError(f"{path} is damaged: use another folder or delete that one")
    return found


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
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."
