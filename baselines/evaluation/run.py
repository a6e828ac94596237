"""Methods x seeds -> records of episodes -> scores: in this process or in several, with the same result."""

import hashlib
import json
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from baselines.cli import Progress
from baselines.controls.names import BEST_BLIND, best_control, is_control
from baselines.evaluation.grid import Key, Task
from baselines.evaluation.job import digest_of_method, job_of
from baselines.evaluation.ray_backend import on_ray
from baselines.evaluation.settings import HAZARDS, OF_CONDITIONS, Settings
from baselines.evaluation.store import Store, key_of
from baselines.folder_note import MAY_DIFFER
from baselines.methods import method_named
from baselines.references import is_reference
from baselines.workers import heard, prefer_one_thread, tell, workers
from cad_env.envs.vector import CADVectorEnv
from cad_env.scenarios import outside_sources
from cad_env.scoring.rollout import BatchPolicy, rollouts
from cad_env.scoring.scorecard import Record, Scorecard, record_of, scorecards
from cad_env.version import version

_ABREAST = 16  # episodes side by side, for a policy that decides in batches


def score(settings: Settings) -> list[Scorecard]:
    """Score every method on every scenario and seed; resumes an earlier run with these settings."""
    return completed(settings, opened_store(settings))


def opened_store(settings: Settings) -> Store:
    """The results so far. ValueError or OSError, one line, for methods, models or a folder that cannot be used."""
    prefer_one_thread()
    for scenario in settings.scenarios():
        for name in settings.method:
            job_of(settings, scenario, name, settings.conditions()[0])
    return Store(settings.folder(), identity(settings))


def completed(settings: Settings, store: Store, advance: Callable[[int], object] | None = None) -> list[Scorecard]:
    """Drive the episodes that are missing, then return the scores, and write them unless they are of a shard only.

    `advance` is called with the number of newly finished episodes; without it, progress is shown.
    """
    keys = [key for task in settings.tasks() for key in task.episodes()]
    if advance is None:
        to_drive = sum(len(task.seeds) for task in _missing(settings, store, _twins(settings, keys)))
        with Progress(len(store.records) + to_drive, "scoring", len(store.records)) as bar:
            _drive_missing(settings, store, bar.update)
    else:
        _drive_missing(settings, store, advance)
    rows = scorecards(store.put_in_order(keys))
    if settings.shard is None:
        store.write_scores(rows)
    return rows


def _drive_missing(settings: Settings, store: Store, advance: Callable[[int], object]) -> None:
    wanted = [key for task in settings.tasks() for key in task.episodes()]
    twin = _twins(settings, wanted)
    with closing(_driven(settings, _missing(settings, store, twin))) as finished:
        for records in finished:
            if new := [record for record in records if key_of(record) not in store.records]:
                store.append(new)
                advance(len(new))
    known = {key: store.records.get(twin[key]) for key in wanted if key in twin and key not in store.records}
    copies = [replace(record, condition=key[0]) for key, record in known.items() if record is not None]
    store.append(copies)


def _twins(settings: Settings, wanted: Sequence[Key]) -> dict[Key, Key]:
    """Episodes that need not be driven -> another of this run that is the same but for the name of its condition.

    A method that shares nothing meets a condition in its traffic only, so it drives once for each density.
    """
    first: dict[tuple[str, str, str, int], Key] = {}
    twins: dict[Key, Key] = {}
    traffic = {name: settings.met(name).traffic for name in settings.conditions()}
    for condition, scenario, method, seed in wanted:
        key = condition, scenario, method, seed
        if not method_named(method).shares:
            same = first.setdefault((traffic[condition], scenario, method, seed), key)
            if same != key:
                twins[key] = same
    return twins


def identity(settings: Settings) -> dict[str, Any]:
    """Everything that the episodes depend on: settings, models, code of the scenes; with the command, as a note."""
    digests = {name: digest_of_method(settings, name) for name in settings.method}
    return {
        "scenario": list(settings.scenarios()),
        "method": list(settings.method),
        **{name: _setting(settings, name) for name in _NOTED if not settings.condition or name not in OF_CONDITIONS},
        **_conditions(settings),
        "radio": {name: str(value) for name, value in asdict(settings.radio_config()).items()},
        **{f"{_what_decides(name)} of {name}": digest for name, digest in digests.items() if digest is not None},
        **_choice(settings),
        **{f"knowledge of {name}": method_named(name).knows for name in settings.method if is_reference(name)},
        **{what: digest for name in settings.scenarios() for what, digest in outside_sources(name).items()},
        "version of cad_env": version(),
        "command": settings.command(),
        **({} if settings.shard is None else {"shard": settings.shard}),
    }


_NOTED = (
    "episodes", "first_seed", "hazard", "traffic", "penetration", "sensor_noise", "gnss_noise", "gnss_yaw_noise",
    "collaborators", "depth", "threshold",
)  # fmt: skip


def _setting(settings: Settings, name: str) -> Any:
    return settings.met().traffic if name == "traffic" else getattr(settings, name)


def _conditions(settings: Settings) -> dict[str, Any]:
    """What each named condition sets."""
    found = {name: settings.met(name).settings for name in settings.condition}
    return {"condition": found} if found else {}


def _what_decides(name: str) -> str:
    return "code" if name == BEST_BLIND or is_control(name) else "model"


def _choice(settings: Settings) -> dict[str, Any]:
    """Which controls best-blind is, by scenario."""
    if BEST_BLIND not in settings.method:
        return {}
    return {f"choice of {BEST_BLIND}": {name: best_control(name) for name in settings.scenarios()}}


def digest_of(settings: Settings) -> str:
    """The identity in 16 hexadecimal digits."""
    known = {name: value for name, value in identity(settings).items() if name not in MAY_DIFFER}
    return hashlib.sha256(json.dumps(known).encode()).hexdigest()[:16]


def _missing(settings: Settings, store: Store, twins: Mapping[Key, Key]) -> list[Task]:
    """What is still to be driven."""
    rest = [
        task._replace(seeds=[key[-1] for key in task.episodes() if key not in store.records and key not in twins])
        for task in settings.tasks()
    ]
    return [task for task in rest if task.seeds]


def drive_task(settings: Settings, task: Task) -> Iterator[Record]:
    """The records of one method on some seeds of one scenario, as the episodes end."""
    job = job_of(settings, task.scenario, task.method, task.condition)
    side_by_side = min(_ABREAST, len(task.seeds)) if isinstance(job.policy, BatchPolicy) else 1
    envs = CADVectorEnv(side_by_side, **job.options)
    episodes = rollouts(envs, job.policy, task.seeds, task.method, HAZARDS[settings.hazard])
    return (record_of(episode, task.condition) for episode in episodes)


def _driven(settings: Settings, tasks: list[Task]) -> Generator[list[Record], None, None]:
    """Records as episodes end; from several processes, some come twice."""
    work = partial(_drive_and_tell, settings)
    if settings.backend == "ray" and tasks:
        yield from on_ray(work, tasks, settings.jobs)
    elif settings.jobs == 1 or len(tasks) <= 1:
        for task in tasks:
            for record in drive_task(settings, task):
                yield [record]
    else:
        with workers(min(settings.jobs, len(tasks))) as (pool, told):
            running = {pool.submit(work, task) for task in tasks}
            while running:
                yield heard(told)
                finished = {future for future in running if future.done()}
                for future in finished:
                    yield future.result()  # all of a task: what it told last may still be on its way
                running -= finished


def _drive_and_tell(settings: Settings, task: Task) -> list[Record]:
    """What a worker does: it sends each record as its episode ends, so that a kill loses no finished episode."""
    records = []
    for record in drive_task(settings, task):
        tell(record)
        records.append(record)
    return records
