"""Progress is shown on a terminal and without one."""

import sys
import time
from io import StringIO

import pytest

from baselines import cli
from baselines.cli import Progress


class Terminal(StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_without_a_terminal_there_is_a_line_every_half_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    with Progress(200, "training") as progress:
        for _ in range(200):
            now[0] += 0.5
            progress.update(1)
    assert capsys.readouterr().err.splitlines() == [
        "training 30 %, about 2 min left",
        "training 60 %, about 1 min left",
        "training 90 %, about 1 min left",
    ]


def test_what_was_done_before_says_nothing_of_the_pace(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    with Progress(100, "record", done=80) as progress:
        progress.describe("scoring")
        now[0] = cli.LINE_EVERY
        progress.update(10)
    assert capsys.readouterr().err == "scoring 90 %, about 1 min left\n"


def test_on_a_terminal_there_is_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    with Progress(4, "training") as progress:
        progress.update(4)
    assert "training 100%|" in screen.getvalue()
