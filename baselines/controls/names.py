"""The names of the controls: `blind-D`, `stop-D` and `slow-V` with a number, and the best of them for each scenario."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BEST_BLIND = "best-blind"
CHOICE = Path(__file__).parent / "best_blind.json"  # made by baselines/evaluation/best_blind.py
CHOOSE = f"python -m {__name__.removesuffix('.controls.names')}.evaluation.best_blind"


@dataclass(frozen=True)
class ControlKind:
    """A kind of control: what the number in its name is, from where to where it may go, and the grid to choose from."""

    name: str
    form: str  # as people write it
    quantity: str
    low: float
    high: float
    grid: tuple[float, ...]


_WAITS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0)
CONTROL_KINDS = (
    ControlKind("blind", "blind-D", "a number of seconds", 0.0, 60.0, _WAITS),  # brakes for the first D s, then goes
    ControlKind(
        "stop", "stop-D", "a number of seconds", 0.0, 60.0, _WAITS
    ),  # stops before the conflict, waits D s, then goes
    ControlKind("slow", "slow-V", "a speed in m/s", 1.0, 50.0, (4.0, 5.0, 6.0, 7.0, 8.0)),  # is never faster than V
)
FORMS = tuple(kind.form for kind in CONTROL_KINDS)
EVERY_CONTROL = "controls"  # the word for all of the grid
GRID = tuple(f"{kind.name}-{number:g}" for kind in CONTROL_KINDS for number in kind.grid)
_KIND = {kind.name: kind for kind in CONTROL_KINDS}
_NAME = re.compile(rf"({'|'.join(_KIND)})-(.*)", re.DOTALL)


def is_control(name: str) -> bool:
    """Whether a name has the form of a control's; its number may still be wrong.

    >>> is_control("blind-0.5"), is_control("best-blind"), is_control("blind")
    (True, False, False)
    """
    return _NAME.fullmatch(name) is not None


def parsed_control(name: str) -> tuple[str, float]:
    """The kind of a control and the number in its name; ValueError, one line, for a wrong one.

    >>> parsed_control("slow-7")
    ('slow', 7.0)
    >>> parsed_control("stop-soon")
    Traceback (most recent call last):
    ValueError: stop-D needs a number of seconds from 0 to 60, such as stop-0.5, got 'stop-soon'
    """
    found = _NAME.fullmatch(name)
    if found is None:
        raise ValueError(f"a control must be named {', '.join(FORMS)}, got {name!r}")
    kind, text = _KIND[found[1]], found[2]
    number = float(text) if re.fullmatch(r"\d{1,4}(\.\d{1,4})?", text, re.ASCII) else -1.0
    if not kind.low <= number <= kind.high:
        example = f"{kind.name}-{kind.grid[1]:g}"
        raise ValueError(
            f"{kind.form} needs {kind.quantity} from {kind.low:g} to {kind.high:g}, such as {example}, got {name!r}"
        )
    return kind.name, number


def read_choice(path: Path = CHOICE) -> dict[str, Any]:
    """What the choice is made of (see baselines/evaluation/best_blind.py). OSError or ValueError, one line."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(found, dict) and all(isinstance(each["chosen"], str) for each in found.values()):
            return found
    except (ValueError, TypeError, KeyError):
        pass
    raise ValueError(f"{path} is damaged: delete it, and {CHOOSE} makes it anew")


def best_control(scenario: str) -> str:
    """The control that was chosen for a scenario; ValueError, one line, if none was."""
    chosen = read_choice()
    if scenario not in chosen:
        raise ValueError(
            f"no {BEST_BLIND} is chosen for scenario {scenario!r}: choose one with {CHOOSE} --scenario, or leave it out"
        )
    name: str = chosen[scenario]["chosen"]
    parsed_control(name)
    return name


def has_best_control(scenarios: Sequence[str]) -> bool:
    """Whether a control was chosen for each of these scenarios."""
    return set(scenarios) <= set(read_choice())
