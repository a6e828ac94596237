"""What all commands share: reading the command line, progress, and how they end."""

import contextlib
import inspect
import io
import math
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from itertools import groupby, pairwise
from typing import Any, TypeVar

import tyro

from baselines.signals import exit_code
from cad_env.checks import ConfigError, did_you_mean

Parsed = TypeVar("Parsed")


def parsed(
    kind: type[Parsed], argv: Sequence[str] | None, choices: Callable[[], str] = lambda: "", more: Sequence[str] = ()
) -> Parsed:
    """A record from the command line; ConfigError, one line, for what it does not take. `--help` exits.

    `choices`, called for `--help` only, gives the names that some options take. `more` are options that another record
    takes: one that is misspelt may have meant them.
    """
    words = sys.argv[1:] if argv is None else argv
    _refuse_empty(words)
    about = _writable(f"{inspect.getdoc(kind)}\n\n{choices()}") if {"-h", "--help"} & set(words) else None
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            return tyro.cli(kind, args=words, description=about)
    except SystemExit as stop:
        if not stop.code:
            raise
        said = _first_part(box.getvalue(), kind.__name__)
        raise ConfigError(said + next(_meant(words, [*_options(kind), *more]), "")) from None


def _options(kind: Any) -> Iterator[str]:
    """The options of a record, as they are written on a command line."""
    for field in fields(kind):
        name = field.name.replace("_", "-")
        yield f"--{name}"
        if isinstance(field.default, bool):
            yield f"--no-{name}"


def _meant(words: Sequence[str], options: Sequence[str]) -> Iterator[str]:
    """The nearest option to each word that looks like one and is none, as the end of a message."""
    for word in words:
        option = word.partition("=")[0].replace("_", "-")
        if option.startswith("--") and option not in options and (near := did_you_mean(option, options)):
            yield near


def say(text: object = "") -> None:
    """Print to standard output, what it cannot write as escapes: no locale ends a run that is finished.

    Standard error needs no such help: Python escapes there by itself.
    """
    print(_writable(str(text)))


def _writable(text: str) -> str:
    """A text with escapes for what standard output cannot write; as it is if there is nothing of the kind."""
    encoding, errors = (getattr(sys.stdout, name, None) for name in ("encoding", "errors"))
    try:
        text.encode(encoding or "utf-8", errors or "strict")
    except UnicodeEncodeError:
        return text.encode(encoding or "utf-8", "backslashreplace").decode(encoding or "utf-8")
    return text


def _refuse_empty(words: Sequence[str]) -> None:
    """Refuse an option whose value is an empty text, which as a path would be the current folder."""
    for before, word in pairwise(["", *words]):
        option, equals, value = word.partition("=")
        if not word or (equals and not value and option.startswith("--")):
            raise ConfigError(f"{(option or before or 'an argument').removeprefix('--')} must not be empty, got ''")


def _first_part(box: str, kind: str) -> str:
    """tyro's message without the frame around it, the title above and the advice below, each behind a rule."""
    lines = [line.strip("│ ") for line in box.splitlines()[1:]]
    parts = [list(part) for said, part in groupby(lines, lambda line: bool(re.search(r"\w", line))) if said]
    return " ".join(parts[0]).removeprefix(f"Error parsing {kind}: ") if parts else box


def stopped(error: BaseException, where: str = "") -> int:
    """Print how to resume; return the exit code."""
    how = "stopped" if isinstance(error, KeyboardInterrupt) else "error: a worker process died"
    print(f"{how}{where}; run the same command to resume", file=sys.stderr)
    return exit_code(error) if isinstance(error, KeyboardInterrupt) else 1


def refused(error: Exception) -> int:
    """Print in one line why a command is refused; return the exit code."""
    reason = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        reason = f"{error.filename}: {error.strerror}"
    print("error:", " ".join(reason.split()), file=sys.stderr)
    return 2


LINE_EVERY = 30.0  # s between two lines of progress without a terminal
BAR = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"


class Progress:
    """How far a command is: a bar on a terminal, else a line on standard error every 30 s."""

    def __init__(self, total: float, what: str, done: float = 0.0) -> None:
        from tqdm import tqdm  # here, so that --help is quick

        self._total, self._what, self._done = total, what, done
        self._begun = time.monotonic()
        self._first = done
        terminal = sys.stderr.isatty()
        self._bar = tqdm(total=total, initial=done, desc=what, bar_format=BAR, disable=not terminal)
        self._over = threading.Event()
        self._teller = None if terminal else threading.Thread(target=self._tell, daemon=True)

    def __enter__(self) -> "Progress":
        if self._teller is not None:
            self._teller.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._teller is not None:
            self._teller.join()  # no line comes after the end
        self._bar.close()

    def update(self, done: float) -> None:
        """So much more has been done."""
        self._done += done
        self._bar.update(done)

    def describe(self, what: str) -> None:
        """Another stage begins."""
        self._what = what
        self._bar.set_description(what)

    def _tell(self) -> None:
        """In a thread of its own, because a piece of work may take longer than the time between two lines."""
        while not self._over.wait(LINE_EVERY):
            print(self._line(), file=sys.stderr, flush=True)

    def _line(self) -> str:
        """E.g. `training 42 %, about 3 min left`."""
        now = time.monotonic()
        share = min(self._done / self._total, 1.0) if self._total else 1.0
        here = self._done - self._first
        rest = (self._total - self._done) * (now - self._begun) / here if here >= 0.01 * self._total else math.inf
        left = f", about {math.ceil(rest / 60):.0f} min left" if rest < math.inf else ""
        return f"{self._what} {100 * share:.0f} %{left}"
