"""Other processes do the work, and end with this one."""

import os
import signal
import threading
from collections.abc import Callable

import pytest
from patience import PATIENCE

from baselines.workers import tell, workers


def half(number: float) -> float:
    tell(number)
    return number / 2


def tell_much(count: int) -> int:
    for _ in range(count):
        tell("." * 400)
    return count


def wait_for_ever() -> None:
    tell("begun")
    threading.Event().wait()


def stop_myself(number: int) -> str:
    os.kill(os.getpid(), number)
    return "still here"


def test_tasks_come_back_and_tell_how_far_they_are() -> None:
    with workers(2) as (pool, told):
        assert sorted(pool.map(half, [2.0, 4.0, 6.0])) == [1.0, 2.0, 3.0]
        assert sorted(told.get(timeout=PATIENCE) for _ in range(3)) == [2.0, 4.0, 6.0]


def test_telling_nobody_is_harmless() -> None:
    assert half(3.0) == 1.5


def test_an_exception_here_ends_a_task_there_that_would_never_end() -> None:
    def failed() -> None:
        with pytest.raises(ZeroDivisionError), workers(1) as (pool, told):  # noqa: PT012  the task must be under way
            pool.submit(wait_for_ever)
            assert told.get(timeout=PATIENCE) == "begun"
            raise ZeroDivisionError
        ended.append(True)

    ended: list[bool] = []
    _ends(failed)
    assert ended


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_stops_a_command_is_for_its_first_process_only(number: int) -> None:
    with workers(1) as (pool, _):
        assert pool.submit(stop_myself, number).result() == "still here"


def test_what_nobody_hears_keeps_no_worker_from_ending() -> None:
    def told_too_much() -> None:
        with workers(1) as (pool, _):
            assert pool.submit(tell_much, 400).result() == 400

    _ends(told_too_much)


def test_workers_use_one_thread_each_unless_the_user_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for wish, wanted in (("3", "3"), (None, "1")):
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
        if wish:
            monkeypatch.setenv("OMP_NUM_THREADS", wish)
        with workers(1) as (pool, _):
            assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == wanted


def _ends(act: Callable[[], object]) -> None:
    """Do it in a thread, so that the test fails where it would hang."""
    working = threading.Thread(target=act, daemon=True)
    working.start()
    working.join(timeout=PATIENCE)
    assert not working.is_alive()
