"""Episodes of a scoring run as GIFs: driven again, drawn, and compared with their records."""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import as_completed
from functools import partial
from pathlib import Path

from baselines.cli import Progress
from baselines.evaluation.job import job_of
from baselines.evaluation.settings import HAZARDS, Settings
from baselines.evaluation.store import gif_name
from baselines.workers import workers
from cad_env.animation import filmed, write_gif
from cad_env.envs.single import CADEnv
from cad_env.rendering.danger import danger
from cad_env.rendering.framing import screen
from cad_env.scenarios import scenario_named
from cad_env.scoring.scorecard import Record

_SIZE = 2.0 / 3.0  # of the size of a picture


def write_gifs(settings: Settings, records: Iterable[Record], folder: Path, count: int) -> list[Path]:
    """A GIF (`gif_name`) in `folder` for `count` episodes of each condition, scenario, method and outcome; their paths.

    They are made by `settings.jobs` processes, and progress is shown. ValueError if an episode does not end as its
    record says: it was made with other settings, models or code.
    """
    chosen = first_of_each(records, count)
    with Progress(len(chosen), "drawing") as bar:
        for done in _drawn(settings, chosen, folder):
            bar.update(done)
    return [folder / gif_name(record) for record in chosen]


def _drawn(settings: Settings, records: Sequence[Record], folder: Path) -> Iterator[int]:
    """Write the GIFs; a one for each."""
    draw = partial(write_film, settings, folder=folder)
    if settings.jobs == 1 or len(records) <= 1:
        for record in records:
            draw(record)
            yield 1
        return
    with workers(min(settings.jobs, len(records))) as (pool, _):
        for drawn in as_completed([pool.submit(draw, record) for record in records]):
            drawn.result()
            yield 1


def first_of_each(records: Iterable[Record], count: int) -> list[Record]:
    """Of each condition, scenario, method and outcome `count` records: with a hazard first, then the lowest seeds."""
    kinds: dict[tuple[str, str, str, str], list[Record]] = {}
    for record in sorted(records, key=lambda record: (not record.hazard, record.seed)):
        kind = record.condition or "", record.scenario, record.method, record.outcome
        kinds.setdefault(kind, []).append(record)
    return [record for kind in sorted(kinds) for record in kinds[kind][:count]]


def write_film(settings: Settings, record: Record, folder: Path) -> Path:
    """The GIF of one recorded episode."""
    job = job_of(settings, record.scenario, record.method, record.condition)
    env = CADEnv(**job.options, config=screen(scenario_named(record.scenario).map, _SIZE))  # a small picture
    episode, frames = filmed(env, job.policy, record.seed, record.method, HAZARDS[settings.hazard], (danger,))
    env.close()
    if episode.outcome != record.outcome:
        raise ValueError(
            f"the episode of seed {record.seed} with {record.method} ends in {episode.outcome}, "
            f"but was recorded as {record.outcome}: it was made with other settings, models or code"
        )
    return write_gif(frames, folder / gif_name(record))
