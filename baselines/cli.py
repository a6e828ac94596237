"""TODO."""

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING, TypeVar

import tyro

if TYPE_CHECKING:
    pass


INTERRUPTED = 130  # the exit code that shells give to a command ended by Ctrl-C


Parsed = TypeVar("Parsed")


def parsed(kind: type[Parsed], argv: Sequence[str] | None) -> Parsed:
    """A record from the command line; ValueError, one line, for what it does not take. `--help` exits."""
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            return tyro.cli(kind, args=argv)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise ValueError(_first_part(box.getvalue(), kind.__name__)) from None


def _first_part(box: str, kind: str) -> str:
    """tyro's message without the frame around it, the title above and the advice below, each behind a rule."""
    lines = [line.strip("│ ") for line in box.splitlines()[1:]]
    parts = [list(part) for said, part in groupby(lines, lambda line: bool(re.search(r"\w", line))) if said]
    return " ".join(parts[0]).removeprefix(f"Error parsing {kind}: ") if parts else box


def stopped(error: BaseException, where: str = "") -> int:
    """Say in one line how to go on with a command that was interrupted or lost a process; its exit code."""
    interrupted = isinstance(error, KeyboardInterrupt)
    how = "stopped" if interrupted else "error: a worker process died"
    print(f"{how}{where}; the same command goes on from there", file=sys.stderr)
    return INTERRUPTED if interrupted else 1


def refused(error: Exception) -> int:
    """Say in one line why a command is not carried out; its exit code."""
    reason = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        reason = f"{error.filename}: {error.strerror}"
    print("error:", " ".join(reason.split()), file=sys.stderr)
    return 2


BAR = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
