"""What all commands share: a record from the command line, errors in one line, and progress."""

import contextlib
import io
import re
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Protocol, TypeVar

import tyro

INTERRUPTED = 130  # the exit code that shells give to a command ended by Ctrl-C
BAR = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"
EVERY = 30.0  # s between two lines of progress where there is no terminal

Parsed = TypeVar("Parsed")


def parsed(kind: type[Parsed], argv: Sequence[str] | None) -> Parsed:
    """A record from the command line. ValueError, one line, for arguments that are refused; `--help` exits."""
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
    """Print one line about a command that was interrupted or lost a process; returns its exit code."""
    interrupted = isinstance(error, KeyboardInterrupt)
    what = "stopped" if interrupted else "error: a worker process died"
    print(f"{what}{where}; run the same command to resume", file=sys.stderr)
    return INTERRUPTED if interrupted else 1


def refused(error: Exception) -> int:
    """Print in one line why a command is refused; returns its exit code."""
    reason = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        reason = f"{error.filename}: {error.strerror}"
    print("error:", " ".join(reason.split()), file=sys.stderr)
    return 2


class Progress(Protocol):
    """What shows how much of some work is done."""

    def update(self, n: float) -> object:
        """So much more is done."""

    def set_description(self, desc: str) -> None:
        """Another part of the work begins."""


@contextlib.contextmanager
def progress(total: float, what: str, done: float = 0) -> Iterator[Progress]:
    """Show progress on standard error: a bar on a terminal, otherwise a line every 30 s."""
    if not sys.stderr.isatty():
        yield ProgressLines(total, what, done)
        return
    from tqdm import tqdm

    with tqdm(total=total, desc=what, initial=done, bar_format=BAR, smoothing=0.1) as bar:
        yield bar


class ProgressLines:
    """Progress in a log: now and then a line, such as `scoring 42 %, 3 min left`."""

    def __init__(self, total: float, what: str, done: float = 0) -> None:
        self._total, self._what, self._done, self._before = total, what, done, done
        self._start = self._last = time.monotonic()

    def update(self, n: float) -> None:
        """So much more is done; prints a line if the last one is long ago."""
        self._done += n
        now = time.monotonic()
        if now - self._last >= EVERY:
            self._last = now
            print(self._line(now - self._start), file=sys.stderr, flush=True)

    def set_description(self, desc: str) -> None:
        """Another part of the work begins."""
        self._what = desc

    def _line(self, seconds: float) -> str:
        line = f"{self._what} {100 * self._done / self._total:.0f} %"
        new = self._done - self._before
        if new <= 0:
            return line
        left = seconds * max(self._total - self._done, 0.0) / new
        return f"{line}, {left:.0f} s left" if left < 90 else f"{line}, {left / 60:.0f} min left"
