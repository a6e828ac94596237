"""SIGTERM is as Ctrl-C, and neither cuts through what must be whole."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from baselines.cli import stopped
from baselines.signals import (
    INTERRUPTED,
    ONE_REQUEST,
    STOPPING,
    TERMINATED,
    Terminated,
    signals_held,
    sigterm_as_ctrl_c,
    sigterm_handler_kept,
)
from cad_env.files import replace_file


def ignored(*_: object) -> None:
    """A handler of somebody's own."""


@sigterm_as_ctrl_c()
def terminated(times: int = 1) -> None:
    for _ in range(times):
        signal.raise_signal(signal.SIGTERM)


def test_sigterm_interrupts_and_is_as_before_afterwards() -> None:
    with pytest.raises(Terminated):
        terminated()
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


@pytest.mark.parametrize(("apart", "raised"), [(0.9 * ONE_REQUEST, 1), (1.1 * ONE_REQUEST, 2)])
def test_another_one_at_once_is_the_same_request(apart: float, raised: int, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    found = 0
    with sigterm_as_ctrl_c():
        for _ in range(2):
            try:
                signal.raise_signal(signal.SIGTERM)
            except Terminated:
                found += 1
            now[0] += apart
    assert found == raised


def test_a_program_with_its_own_way_keeps_it(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.signal(signal.SIGTERM, ignored)
    try:
        terminated()
        assert signal.getsignal(signal.SIGTERM) is ignored
        with sigterm_handler_kept():
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        assert signal.getsignal(signal.SIGTERM) is ignored
    finally:
        signal.signal(signal.SIGTERM, before)


def test_another_thread_changes_no_handler() -> None:
    found: list[object] = []

    def elsewhere() -> None:
        with sigterm_as_ctrl_c(), signals_held(), sigterm_handler_kept():
            found.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert found == [signal.SIG_DFL]


@pytest.mark.parametrize(("number", "kind"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)])
def test_what_must_be_whole_is_done_before_a_signal_is_heard(number: int, kind: type[BaseException]) -> None:
    done = []
    with pytest.raises(kind), sigterm_as_ctrl_c():  # noqa: PT012  the signal must come inside
        with signals_held():
            os.kill(os.getpid(), number)
            # Any other thread may take a signal that is sent to the process: it must wait all the same.
            thread = threading.Thread(target=signal.raise_signal, args=(number,))
            thread.start()
            thread.join()
            done.append("whole")
        done.append("not reached")
    assert done == ["whole"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interruption_right_after_a_file_is_there_is_still_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(here: str, there: Path) -> None:
        rename(here, there)
        raise KeyboardInterrupt

    rename = os.replace
    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        replace_file(tmp_path / "file", b"whole")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"whole"]


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="masks as POSIX has them")
def test_masks_are_as_before_afterwards() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with signals_held():
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before | set(STOPPING)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


@pytest.mark.parametrize(("stop", "code"), [(KeyboardInterrupt(), INTERRUPTED), (Terminated(), TERMINATED)])
def test_a_line_says_how_to_resume(stop: KeyboardInterrupt, code: int, capsys: pytest.CaptureFixture[str]) -> None:
    assert stopped(stop, " after 3 of 4 episodes") == code
    assert capsys.readouterr().err == "stopped after 3 of 4 episodes; run the same command to resume\n"
    assert (INTERRUPTED, TERMINATED) == (128 + signal.SIGINT, 128 + signal.SIGTERM)
