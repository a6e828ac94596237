"""What counts as a number, a seed, a switch or a path, wherever a user gives one: the one rule of all packages.

numpy's numbers and bools are as good as Python's, and a path may be text. Every check returns what it let pass as
Python's own kind, because compiled code is compiled anew for each further kind of number. What does not pass is refused
with a ConfigError, one line that has the name, what is allowed, and the value.
"""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from difflib import get_close_matches
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Checked = TypeVar("Checked")


class ConfigError(ValueError):
    """A setting, an argument or a file that cannot be used; its message is one line."""


def did_you_mean(given: object, choices: Iterable[str]) -> str:
    """The end of a message about a name that is none of the choices: the nearest of them; empty if none is near.

    >>> did_you_mean("cv2v", ["dsrc", "cv2x"])
    '; did you mean cv2x?'
    """
    known = {name.casefold(): name for name in choices}
    # Longer names than any real one are cut: the time that the comparison takes grows with the square of their length.
    near = get_close_matches(given[:100].casefold(), known, 1) if isinstance(given, str) else []
    return f"; did you mean {known[near[0]]}?" if near else ""


def check_range(name: str, value: Any, low: float, high: float) -> float:
    """A number in [low, high] as a float. Bools, text, arrays and NaN are no numbers.

    >>> check_range("loss", np.float32(0.5), 0.0, 1.0)
    0.5
    """
    number: Any = value  # typeshed's Real cannot be compared
    if isinstance(value, bool) or not isinstance(value, Real) or not low <= number <= high:
        raise ConfigError(f"{name} must be a number from {low:g} to {high:g}, got {value!r}")
    return float(value)


def check_whole(name: str, value: Any, low: int, high: int | None = None) -> int:
    """A whole number in [low, high], or from low on, as an int. 3.0 is none: what counts is not a measurement.

    >>> check_whole("depth", np.int64(3), 1, 15)
    3
    """
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or value < low or (high is not None and value > high):
        limits = f"from {low} on" if high is None else f"from {low} to {high}"
        raise ConfigError(f"{name} must be a whole number {limits}, got {value!r}")
    return int(value)


def check_seed(name: str, value: Any) -> int:
    """A whole number from 0 on, of any size, as an int: Gymnasium's own default seeds have 128 bits.

    >>> check_seed("seed", 2**70) == 2**70
    True
    """
    return check_whole(name, value, 0)


def check_switch(name: str, value: Any) -> bool:
    """True or False. Nothing else is one, so that "no" is not taken for a yes.

    >>> check_switch("report", np.bool_(False))
    False
    """
    if not isinstance(value, bool | np.bool_):
        raise ConfigError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def check_path(name: str, value: Any) -> Path:
    """A path from text or from anything with a path; an empty text is none.

    >>> check_path("out", "results").name
    'results'
    """
    if not isinstance(value, str | os.PathLike) or not os.fspath(value) or isinstance(os.fspath(value), bytes):
        raise ConfigError(f"{name} must be a path, got {value!r}")
    return Path(value)


def check_text(name: str, value: Any) -> str:
    """A text that is not empty."""
    if not isinstance(value, str) or not value:
        raise ConfigError(f"{name} must be a text, got {value!r}")
    return value


def check_several(name: str, value: Any, check: Callable[[str, Any], Checked]) -> tuple[Checked, ...]:
    """A tuple of what a check lets pass each; a single one counts as a tuple of it, and a text is a single one.

    >>> check_several("method", "expert", check_text)
    ('expert',)
    """
    several = isinstance(value, Sequence) and not isinstance(value, str | bytes)
    return tuple(check(name, each) for each in (value if several else (value,)))


def check_mapping(name: str, value: Any, of: str) -> dict[str, Any]:
    """A dict as a new one; `of` says in the message what it is a dict of."""
    if not isinstance(value, Mapping):
        raise ConfigError(f"{name} must be a dict of {of}, got {value!r}")
    return dict(value)


def check_numbers(record: Any, what: str, limits: Mapping[str, tuple[float, float]]) -> None:
    """Check fields of a frozen dataclass, and keep them as Python's own numbers: whole ones where they are ints.

    what: goes before the names in messages, empty for nothing. None passes where the field's type has it.
    """
    for field in fields(record):
        value = getattr(record, field.name)
        if field.name not in limits or (value is None and field.type in (int | None, float | None)):
            continue
        check: Any = check_whole if field.type in (int, int | None) else check_range
        settle(record, field.name, check(f"{what} {field.name}".lstrip(), value, *limits[field.name]))


def plain(value: Any) -> Any:
    """numpy's numbers, bools and arrays as Python's own, lists and arrays as tuples; anything else as it is."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(plain(each) for each in value) if isinstance(value, list | tuple) else value


def settle(record: Any, name: str, value: Any) -> None:
    """Give a field of a frozen dataclass its final value, while the record is being made."""
    object.__setattr__(record, name, value)
