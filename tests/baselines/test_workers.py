"""Other processes do the work, and end with this one."""

import os
import threading
import time

import pytest

from baselines.workers import tell, workers


def half(number: float) -> float:
    tell(number)
    return number / 2


def tell_much(count: int) -> int:
    for _ in range(count):
        tell("." * 400)
    return count


def test_tasks_come_back_and_tell_how_far_they_are() -> None:
    with workers(2) as (pool, told):
        assert sorted(pool.map(half, [2.0, 4.0, 6.0])) == [1.0, 2.0, 3.0]
        assert sorted(told.get(timeout=10) for _ in range(3)) == [2.0, 4.0, 6.0]


def test_telling_nobody_is_harmless() -> None:
    assert half(3.0) == 1.5


def test_an_exception_here_ends_a_task_there_at_once() -> None:
    with pytest.raises(ZeroDivisionError), workers(1) as (pool, told):  # noqa: PT012  the task must be under way
        pool.submit(os.getpid).result()
        pool.submit(time.sleep, 60)
        started = time.monotonic()
        raise ZeroDivisionError
    assert time.monotonic() - started < 10
    assert told.empty()


def test_what_nobody_hears_keeps_no_worker_from_ending() -> None:
    def told_too_much() -> None:
        with workers(1) as (pool, _):
            assert pool.submit(tell_much, 400).result() == 400

    working = threading.Thread(target=told_too_much, daemon=True)
    working.start()
    working.join(timeout=30)
    assert not working.is_alive()


def test_workers_use_one_thread_each_unless_the_user_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for wish, wanted in (("3", "3"), (None, "1")):
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
        if wish:
            monkeypatch.setenv("OMP_NUM_THREADS", wish)
        with workers(1) as (pool, _):
            assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == wanted
