"""The shards of one run -> one folder, as if it had been one run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.evaluation.grid import Key, grid
from baselines.evaluation.store import Store, difference, key_of, read_records, read_settings
from cad_env.scoring.scorecard import Scorecard, scorecards


@dataclass(frozen=True)
class Merging:
    """Put the finished shards of one run together and print the table, as the whole run would have done."""

    merge: tuple[Path, ...]  # the folders of the shards
    out: Path = Path("results")  # folder to write to
    report: bool = True  # write report.html

    def __post_init__(self) -> None:
        if not self.merge:
            raise ValueError("merge must name at least one folder")


def merged(merging: Merging) -> list[Scorecard]:
    """The scores of all shards together, written to `out`. ValueError or OSError, one line, if they are not one run."""
    settings = _one_run(merging.merge)
    keys = _keys(merging.merge[0], settings)
    records = {key_of(record): record for folder in merging.merge for record in read_records(folder)}
    missing = [key for key in keys if key not in records]
    if missing:
        scenario, contender, seed = missing[0]
        which = f"{len(missing)} of {len(keys)} episodes, such as seed {seed} of {contender} in {scenario}"
        raise ValueError(f"these folders lack {which}: finish every shard and name them all")
    store = Store(merging.out, settings)
    store.records = records
    rows = scorecards(store.put_in_order(keys))
    store.write_scores(rows)
    return rows


def _one_run(folders: Sequence[Path]) -> dict[str, Any]:
    """The settings that all folders agree on, but for the shard."""
    settings = [{**read_settings(folder), "shard": None} for folder in folders]
    for folder, other in zip(folders, settings, strict=True):
        change = difference(settings[0], other)
        if change:
            raise ValueError(f"{folder} is of another run than {folders[0]}: {change}")
    return {name: value for name, value in settings[0].items() if name != "shard"}


def _keys(folder: Path, settings: dict[str, Any]) -> list[Key]:
    try:
        seeds = range(settings["first_seed"], settings["first_seed"] + settings["episodes"])
        tasks = grid(settings["scenario"], settings["contender"], seeds)
    except (KeyError, TypeError) as error:
        raise ValueError(f"the settings.json of {folder} is damaged ({error!r})") from None
    return [key for task in tasks for key in task.episodes()]
