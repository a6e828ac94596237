"""How a command is stopped: SIGTERM (kill, timeout, docker stop, a cluster's time limit) ends it as Ctrl-C does."""

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType

STOPPING = (signal.SIGINT, signal.SIGTERM)
INTERRUPTED, TERMINATED = 130, 143  # the exit codes that shells give to commands that these two have ended
ONE_REQUEST = 1.0  # s in which another SIGTERM is the same request: `timeout` sends two at once


class Terminated(KeyboardInterrupt):
    """SIGTERM has come: whatever cleans up after Ctrl-C cleans up after it."""


@contextmanager
def sigterm_as_ctrl_c() -> Iterator[None]:
    """Inside, or in a function that this decorates, SIGTERM raises Terminated in the main thread.

    Nothing changes in another thread, or where the program has its own way with SIGTERM or ignores it.
    """
    if not _in_main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    asked = -ONE_REQUEST

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        before, asked = asked, time.monotonic()
        if asked - before >= ONE_REQUEST:
            raise Terminated

    signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def signals_held() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait for the end of what is inside; processes that are started inside never see them."""
    came: list[int] = []
    handlers = {each: signal.getsignal(each) for each in STOPPING if _in_main_thread()}
    for each in handlers:  # the mask below is of this thread only, and another one may take the signal
        signal.signal(each, lambda number, frame: came.append(number))
    masks = hasattr(signal, "pthread_sigmask")  # not on Windows
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING) if masks else set()
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for each, handler in handlers.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)
        for number in came:
            signal.raise_signal(number)


def import_whole(module: str) -> None:
    """Import a module that brings torch: an exception in the middle of that would end the process with C++ errors."""
    if module not in sys.modules:
        with signals_held():
            import_module(module)


@contextmanager
def sigterm_handler_kept() -> Iterator[None]:
    """What handles SIGTERM before does so afterwards, whatever libraries that start inside would have instead."""
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if _in_main_thread() and handler is not None:
            signal.signal(signal.SIGTERM, handler)


def exit_code(stop: KeyboardInterrupt) -> int:
    """Of a command that was stopped."""
    return TERMINATED if isinstance(stop, Terminated) else INTERRUPTED


def _in_main_thread() -> bool:
    """Only there can handlers be set."""
    return threading.current_thread() is threading.main_thread()
