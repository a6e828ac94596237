"""Contenders x seeds -> records of episodes -> scores: in this process or in several, with the same result."""

import hashlib
import math
from collections.abc import Generator, Sequence
from concurrent.futures import as_completed
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tqdm import tqdm

from baselines.contenders import MODEL_FILES, contender_named
from baselines.settings import HAZARDS, Settings
from baselines.store import Store
from baselines.workers import prefer_one_thread, workers
from cad_env.compiled import version
from cad_env.env import CADEnv
from cad_env.rollout import BatchPolicy, Episode, rollouts
from cad_env.score import Record, Scorecard, scorecards

CHUNK = 25  # episodes that an interruption can cost a process
ABREAST = 16  # episodes side by side, for a policy that decides in batches

Task = tuple[str, Sequence[int]]  # contender, seeds


def score(settings: Settings) -> list[Scorecard]:
    """Score every contender on every seed, going on where an earlier run with the same settings stopped."""
    return completed(settings, opened(settings))


def opened(settings: Settings) -> Store:
    """The results so far. ValueError or OSError, one line, for models or a folder that cannot be used."""
    prefer_one_thread()
    for name in settings.contender:
        contender_named(name).make_policy(settings.models())
    return Store(settings.folder(), identity(settings))


def completed(settings: Settings, store: Store) -> list[Scorecard]:
    """Drive the episodes that are missing, then write and return the scores."""
    total = len(settings.contender) * settings.episodes
    with (
        tqdm(total=total, initial=len(store.records), unit="episode", smoothing=0.1, disable=None) as bar,
        closing(_driven(settings, _tasks(settings, store))) as finished,
    ):
        for records in finished:
            store.append(records)
            bar.update(len(records))
    ordered = [store.records[name, seed] for name in settings.contender for seed in settings.seeds()]
    rows = scorecards(ordered)
    store.finish(ordered, rows)
    return rows


def identity(settings: Settings) -> dict[str, Any]:
    """All that the episodes depend on: settings, models and the code of the scenes."""
    names = ("scenario", "contender", "episodes", "first_seed", "sensor_noise", "gnss_noise", "hazard", "depth")
    models = {name: contender_named(name).model for name in settings.contender}
    return {
        **{name: getattr(settings, name) for name in names},
        "contender": list(settings.contender),
        "radio": {name: str(value) for name, value in asdict(settings.radio_config()).items()},
        **{f"model of {name}": _digest(settings.models() / model) for name, model in models.items() if model},
        "version of cad_env": version(),
    }


def _digest(folder: Path) -> str:
    data = b"".join((folder / name).read_bytes() for name in MODEL_FILES)
    return hashlib.sha256(data).hexdigest()[:16]


def _tasks(settings: Settings, store: Store) -> list[Task]:
    tasks: list[Task] = []
    for name in settings.contender:
        missing = [seed for seed in settings.seeds() if (name, seed) not in store.records]
        tasks += [(name, missing[start : start + CHUNK]) for start in range(0, len(missing), CHUNK)]
    return tasks


def drive(settings: Settings, task: Task) -> list[Record]:
    """The records of one contender on some seeds, in their order."""
    name, seeds = task
    contender = contender_named(name)
    policy = contender.make_policy(settings.models())
    abreast = min(ABREAST, len(seeds)) if isinstance(policy, BatchPolicy) else 1
    envs = [CADEnv(**settings.environment(contender.shares)) for _ in range(abreast)]
    episodes = rollouts(envs, policy, seeds, name, HAZARDS[settings.hazard])
    records = {episode.seed: _record(episode) for episode in episodes}
    return [records[seed] for seed in seeds]


def _record(episode: Episode) -> Record:
    messages = int(episode.messages_sent.sum())
    return Record(
        episode.scenario, episode.contender, episode.seed, episode.hazard, episode.outcome, round(episode.time, 6),
        episode.brakes, round(episode.bytes_per_message, 3) if messages else None,
        int(episode.largest_message.max()) if messages else None, messages,
        int(episode.messages_lost.sum()), int(episode.bytes_sent.sum()),
        round(episode.min_ttc, 6) if episode.min_ttc < math.inf else None,
    )  # fmt: skip


def _driven(settings: Settings, tasks: list[Task]) -> Generator[list[Record], None, None]:
    if settings.jobs == 1 or len(tasks) <= 1:
        yield from (drive(settings, task) for task in tasks)
        return
    with workers(min(settings.jobs, len(tasks))) as (pool, _):
        for finished in as_completed([pool.submit(drive, settings, task) for task in tasks]):
            yield finished.result()
