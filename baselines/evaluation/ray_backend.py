"""Tasks on ray: the cores of this machine, or the cluster that RAY_ADDRESS names."""

import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import BrokenExecutor
from importlib.util import find_spec
from typing import TypeVar

from baselines.signals import sigterm_handler_kept
from baselines.workers import register_scenarios, registered_scenarios

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


def check_ray() -> None:
    """ValueError, one line, if ray is not installed."""
    if find_spec("ray") is None:
        raise ValueError("backend ray needs ray, which is not installed: pip install 'cad-env[ray]'")


def on_ray(work: Callable[[_Task], _Result], tasks: Sequence[_Task], jobs: int) -> Generator[_Result, None, None]:
    """Yield results as they come. Ray is shut down afterwards if it was started here.

    Ray repeats a task whose worker has died; BrokenExecutor if that happens again and again. `jobs` is the number of
    cores to use on this machine; on a cluster every task takes one.
    """
    with sigterm_handler_kept():
        import ray
    from ray.exceptions import RayError, RayTaskError

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    started_here = not ray.is_initialized()
    if started_here:
        cores = None if os.environ.get("RAY_ADDRESS") else jobs
        with sigterm_handler_kept():  # ray sets its own, which ends the process where it is
            ray.init(num_cpus=cores, include_dashboard=False, log_to_driver=False, logging_level="error")
    try:
        scenarios = registered_scenarios()

        def there(task: _Task) -> _Result:
            register_scenarios(scenarios)
            return work(task)

        remote = ray.remote(there)
        waiting = [remote.remote(task) for task in tasks]
        while waiting:
            (done,), waiting = ray.wait(waiting)
            yield ray.get(done)
    except RayTaskError:
        raise  # the work itself failed
    except RayError as error:
        raise BrokenExecutor(str(error)) from error
    finally:
        if started_here:
            ray.shutdown()
