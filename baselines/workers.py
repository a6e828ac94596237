"""Worker processes: they ignore Ctrl-C and SIGTERM, and end with the process that started them, however it ends."""

import multiprocessing
import os
import queue
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.queues import Queue
from typing import Any

from baselines.signals import STOPPING, signals_held

_told: "Queue[Any] | None" = None  # in a worker: where `tell` puts its reports


@contextmanager
def workers(count: int) -> "Iterator[tuple[ProcessPoolExecutor, Queue[Any]]]":
    """A pool of processes, and the queue of what their tasks `tell`. An exception stops tasks that are running.

    A task must be a function of a module, as for any spawned process.
    """
    prefer_one_thread()
    context = multiprocessing.get_context("spawn")
    lifeline, held = context.Pipe(duplex=False)
    progress: Queue[Any] = context.Queue()
    pool = ProcessPoolExecutor(count, context, _start, (lifeline, progress, registered_scenarios()))
    try:
        with signals_held():
            for _ in range(count):
                pool.submit(int)  # nothing to do, but it starts a process
        yield pool, progress
    except BaseException:
        held.close()  # the workers stop at once, in the middle of a task
        raise
    finally:
        try:
            pool.shutdown(cancel_futures=True)
        finally:
            held.close()
            lifeline.close()


def registered_scenarios() -> tuple[Any, ...]:
    """The scenarios from outside that are registered in this process: tasks in other processes may need them."""
    if "cad_env.scenarios" not in sys.modules:  # nothing has been registered, and importing it takes a second
        return ()
    from cad_env.scenarios import registered

    return registered()


def register_scenarios(scenarios: Sequence[Any]) -> None:
    """Register them in another process."""
    if scenarios:
        from cad_env.scenarios import scenario_named

        for scenario in scenarios:
            scenario_named(scenario)


def prefer_one_thread() -> None:
    """Use one thread for numerics in new processes, and in this one if torch is not imported yet.

    The networks are small, so a second thread costs more than it gains. A value that the user has set is kept.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")


def tell(what: Any) -> None:
    """Called by a task: report something to the process that started it."""
    if _told is not None:
        _told.put(what)


def heard(progress: "Queue[Any]") -> list[Any]:
    """What tasks have reported since the last call; waits up to a tenth of a second for the first report."""
    try:
        found = [progress.get(timeout=0.1)]
        while not progress.empty():
            found.append(progress.get())
        return found
    except queue.Empty:
        return []


def _start(lifeline: Connection, progress: "Queue[Any]", scenarios: "Sequence[Any]") -> None:
    global _told
    _told = progress
    # Reports that nobody reads must not keep a worker from ending: its pipe is full after some hundred records. A task
    # returns everything anyway; reports only come earlier.
    progress.cancel_join_thread()
    register_scenarios(scenarios)
    for each in STOPPING:  # a terminal, docker and clusters send them to every process of a command
        signal.signal(each, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    """End this process when the other end of the lifeline is closed, which also happens when the parent dies."""
    try:
        lifeline.recv()
    except (EOFError, OSError):
        os._exit(1)
