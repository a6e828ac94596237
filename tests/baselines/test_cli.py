"""Progress is shown on a terminal and without one."""

import itertools
import sys
import threading
from collections.abc import Callable
from io import StringIO
from queue import SimpleQueue
from types import SimpleNamespace

import pytest

from baselines import cli
from baselines.cli import Progress


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
