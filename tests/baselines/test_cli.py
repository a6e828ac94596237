"""Progress is shown on a terminal and without one; help names the choices; what is said fits any locale."""

import ast
import io
import itertools
import sys
import threading
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from queue import SimpleQueue
from types import ModuleType, SimpleNamespace

import pytest

import reproduce
import train
from baselines import cli
from baselines.cli import Progress
from cad_env.scenarios import scenario_names


class Terminal(StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


class Hand:
    """In place of the event that a `Progress` waits for: half a minute passes when the test says so."""

    def __init__(self) -> None:
        self.asked: SimpleQueue[float] = SimpleQueue()  # how long it is to wait
        self.answers: SimpleQueue[bool] = SimpleQueue()  # whether all is over

    def wait(self, time: float) -> bool:
        self.asked.put(time)
        return self.answers.get()

    def set(self) -> None:
        self.answers.put(True)


def told(work: Callable[[Progress], object], progress: Progress, hand: Hand) -> None:
    """Do it, then let half a minute pass until its line is there."""
    assert hand.asked.get() == cli.LINE_EVERY == 30.0
    work(progress)
    hand.answers.put(False)
    hand.asked.put(hand.asked.get())  # it waits again: the line has been printed


@pytest.fixture
def hand(monkeypatch: pytest.MonkeyPatch) -> Hand:
    hand, now = Hand(), itertools.count(0.0, cli.LINE_EVERY)
    monkeypatch.setattr(cli, "threading", SimpleNamespace(Event=lambda: hand, Thread=threading.Thread))
    monkeypatch.setattr(cli, "time", SimpleNamespace(monotonic=lambda: next(now)))
    return hand


def test_without_a_terminal_there_is_a_line_every_half_minute(hand: Hand, capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(200, "training") as progress:
        told(lambda progress: None, progress, hand)  # something that takes long has just begun
        for _ in range(3):
            told(lambda progress: progress.update(60), progress, hand)
    assert capsys.readouterr().err.splitlines() == [
        "training 0 %",
        "training 30 %, about 3 min left",
        "training 60 %, about 1 min left",
        "training 90 %, about 1 min left",
    ]


def test_what_was_done_before_says_nothing_of_the_pace(hand: Hand, capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(100, "record", done=80) as progress:
        progress.describe("scoring")
        told(lambda progress: progress.update(10), progress, hand)
    assert capsys.readouterr().err == "scoring 90 %, about 1 min left\n"


def test_on_a_terminal_there_is_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    with Progress(4, "training") as progress:
        progress.update(4)
    assert "training 100%|" in screen.getvalue()


@pytest.mark.parametrize("command", [train, reproduce])
def test_help_lists_methods_and_scenarios(command: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        command.main(["--help"])
    assert stopped.value.code == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "collab-gat, " in shown
    assert f"Scenarios: {', '.join(scenario_names())}." in shown
    assert ("expert" in shown.partition("Scenarios:")[0]) == (command is reproduce)


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "utf-8"])
@pytest.mark.parametrize("text", ["results_训练", "a ≤ b", "bytes that were no name: \udce8", "", "plain"])
def test_what_is_said_is_written_in_any_locale(text: str, encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    stream = io.TextIOWrapper(written, encoding=encoding, newline="\n")
    monkeypatch.setattr("sys.stdout", stream)
    cli.say(text)
    stream.flush()
    expected = text.encode(encoding, "backslashreplace").decode(encoding)
    assert written.getvalue().decode(encoding) == expected + "\n"


def test_bytes_that_a_locale_keeps_are_written_as_they_came(monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    stream = io.TextIOWrapper(written, encoding="ascii", errors="surrogateescape", newline="\n")
    monkeypatch.setattr("sys.stdout", stream)
    cli.say(b"\xe8\xae\xad".decode("ascii", "surrogateescape"))
    stream.flush()
    assert written.getvalue() == b"\xe8\xae\xad\n"


def said_without_help(path: Path) -> list[str]:
    """Where a source file prints to standard output by itself."""
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    bare = [call for call in calls if getattr(call.func, "id", "") == "print" and not call.keywords]
    return [f"{path.name}:{call.lineno}" for call in bare]


def test_commands_print_by_say_only() -> None:
    package = Path(cli.__file__).parent
    found = [place for path in package.rglob("*.py") if path.name != "cli.py" for place in said_without_help(path)]
    assert found == []
    assert len(said_without_help(package / "cli.py")) == 1
