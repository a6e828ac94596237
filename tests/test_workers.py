"""Other processes do the work, and end with this one."""

import os
import time

import pytest

from baselines.workers import tell, workers


def half(number: float) -> float:
    tell(number)
    return number / 2


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


def test_workers_use_one_thread_each() -> None:
    with workers(1) as (pool, _):
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == os.environ["OMP_NUM_THREADS"]
