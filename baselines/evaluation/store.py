"""A folder of results that survives an interruption at any moment: finished episodes are never lost.

`episodes.jsonl` grows by whole lines that are on the disk before the next ones are computed. `settings.json` says
what the episodes were made with, so that runs with different settings never mix.
"""

import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from baselines.evaluation.grid import MOST_EPISODES, NO_CONDITION, Key, grid
from baselines.folder_note import claim, difference
from baselines.methods import KNOWLEDGE, folder_of
from cad_env.checks import ConfigError, check_path, check_several, check_switch, settle
from cad_env.conditions import Condition
from cad_env.files import (
    MOST_DATA_BYTES,
    FileError,
    check_regular,
    read_file,
    read_json_object,
    replace_text,
    shortened,
)
from cad_env.scoring.scorecard import Record, Scorecard, parse_record, scorecards

EPISODES, SETTINGS, SCORES = "episodes.jsonl", "settings.json", "scores.json"
_NEEDED = ("scenario", "method", "first_seed", "episodes")  # settings that say which episodes there are
GIFS = "gifs"  # the folder of animations in a folder of results


class Store:
    """The results in a folder."""

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        """Open or make the folder; ConfigError or OSError if it is damaged, of other settings or not writable."""
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / EPISODES).exists() and not (folder / SETTINGS).exists():
            raise ConfigError(f"{folder} has episodes but no {SETTINGS}: use another folder")
        claim(folder / SETTINGS, settings, "use another folder or delete that one")
        _make_appendable(folder / EPISODES)
        self.records = {key_of(record): record for record in read_records(folder)}

    def append(self, records: Iterable[Record]) -> None:
        """Add episodes: when this returns they are on the disk."""
        records = list(records)
        with open(self.folder / EPISODES, "ab") as file:
            file.write("".join(record.line() + "\n" for record in records).encode())
            file.flush()
            os.fsync(file.fileno())
        self.records.update({key_of(record): record for record in records})

    def put_in_order(self, keys: Iterable[Key]) -> list[Record]:
        """Rewrite the file with these episodes only, in this order, and return them."""
        records = [self.records[key] for key in keys]
        replace_text(self.folder / EPISODES, "".join(record.line() + "\n" for record in records))
        return records

    def write_scores(self, scores: Iterable[Scorecard]) -> None:
        """Write the rows of the table."""
        rows = ",\n".join(json.dumps(vars(row), allow_nan=False) for row in scores)
        replace_text(self.folder / SCORES, f"[\n{rows}\n]\n")


def key_of(record: Record) -> Key:
    """What identifies an episode in a run."""
    return record.condition, record.scenario, record.method, record.seed


def gif_of(folder: Path, record: Record) -> Path:
    """Where the animation of an episode is, if there is one."""
    return folder / GIFS / gif_name(record)


def gif_name(record: Record) -> str:
    """`<scenario>_<method>_<outcome>_<seed>.gif`, behind `<condition>_` if one was named."""
    condition = "" if record.condition is None else f"{folder_of(record.condition)}_"
    return f"{condition}{record.scenario}_{folder_of(record.method)}_{record.outcome}_{record.seed}.gif"


def read_settings(folder: Path, needed: Sequence[str] = ()) -> dict[str, Any]:
    """What the episodes of a folder were made with; it must say what is `needed`.

    FileError, one line with the setting, if it is missing or damaged.
    """
    path = folder / SETTINGS
    settings = read_json_object(path)
    for name in needed:
        if name not in settings:
            raise FileError(path, f"{name} is missing")
    for name, value in settings.items():
        _check_setting(path, name, name.partition(" of ")[0], value)  # "knowledge of stgraph" is one
    return settings


def _check_setting(path: Path, field: str, kind: str, value: object) -> None:
    """Refuse what tables and reports cannot work with; `kind` is the key of what is known about it."""
    sound, wanted = _SETTINGS.get(kind, (None, ""))
    if sound is not None and not sound(value):
        raise FileError(path, f"{field} must be {wanted}, got {shortened(repr(value))}")
    for name, part in value.items() if isinstance(value, dict) else ():
        _check_setting(path, f"{field}.{name}", name if name == "rate" else "", part)


def _is_names(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)


def _are_conditions(value: object) -> bool:
    """Whether it maps names to what conditions set."""
    if not isinstance(value, dict) or not value:
        return False
    try:
        return bool([Condition(name, "noted", **settings) for name, settings in value.items()])
    except (TypeError, ValueError):
        return False


def _is_seed(value: object) -> bool:
    return type(value) is int and value >= 0


def _is_number_of_episodes(value: object) -> bool:
    return type(value) is int and 1 <= value <= MOST_EPISODES


def _is_rate(value: object) -> bool:
    """Whether a number can be read of it, as text or not."""
    try:
        return isinstance(value, str | float) and not math.isnan(float(value))
    except ValueError:
        return False


_SETTINGS: Mapping[str, tuple[Callable[[Any], bool], str]] = MappingProxyType(
    {
        "scenario": (_is_names, "a list of names"),
        "method": (_is_names, "a list of names"),
        "condition": (_are_conditions, "what each condition sets, by its name"),
        "first_seed": (_is_seed, "a whole number from 0 on"),
        "episodes": (_is_number_of_episodes, f"a whole number from 1 to {MOST_EPISODES}"),
        "knowledge": (KNOWLEDGE.__contains__, f"one of {', '.join(KNOWLEDGE)}"),
        "rate": (_is_rate, "a number"),
    }
)


def read_records(folder: Path) -> list[Record]:
    """The episodes of a folder in the order of its file; a last line without its end does not count.

    FileError, with the line and the field, if the file is missing or damaged.
    """
    path = folder / EPISODES
    data = read_file(path, MOST_DATA_BYTES)
    records = []
    for number, line in enumerate(data[: data.rfind(b"\n") + 1].splitlines(), 1):
        try:
            records.append(parse_record(line))
        except ConfigError as error:
            raise FileError(path, f"line {number}: {error}") from None
    return records


def _make_appendable(path: Path) -> None:
    check_regular(path)
    with open(path, "a+b") as file:  # made if it is not there, so that a folder that refuses does so at once
        file.seek(0)
        data = file.read()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):  # an interrupted write left a piece of a line
            file.truncate(whole)


@dataclass(frozen=True)
class Merging:
    """Merge the finished shards of one run and print its table."""

    merge: tuple[Path, ...]  # the folders of the shards
    out: Path = Path("results")  # folder to write to
    report: bool = True  # write report.html

    def __post_init__(self) -> None:
        settle(self, "merge", check_several("merge", self.merge, check_path))
        settle(self, "out", check_path("out", self.out))
        settle(self, "report", check_switch("report", self.report))
        if not self.merge:
            raise ConfigError("merge must name at least one folder")


def merged(merging: Merging) -> list[Scorecard]:
    """The scores of all shards, written to `out`. ConfigError or OSError, one line, if they are not of one run."""
    settings = _one_run(merging.merge)
    keys = _keys(settings)
    records = {key_of(record): record for folder in merging.merge for record in read_records(folder)}
    missing = [key for key in keys if key not in records]
    if missing:
        condition, scenario, method, seed = missing[0]
        under = "" if condition is None else f" under {condition}"
        which = f"{len(missing)} of {len(keys)} episodes, such as seed {seed} of {method} in {scenario}{under}"
        raise ConfigError(f"these folders lack {which}: finish every shard and name them all")
    store = Store(merging.out, settings)
    store.records = records
    rows = scorecards(store.put_in_order(keys))
    store.write_scores(rows)
    return rows


def _one_run(folders: Sequence[Path]) -> dict[str, Any]:
    """The settings that all folders share, without the shard."""
    settings = [{**read_settings(folder, _NEEDED), "shard": None} for folder in folders]
    for folder, other in zip(folders, settings, strict=True):
        change = difference(settings[0], other)
        if change:
            raise ConfigError(f"{folder} is of another run than {folders[0]}: {change}")
    return {name: value for name, value in settings[0].items() if name != "shard"}


def _keys(settings: Mapping[str, Any]) -> list[Key]:
    seeds = range(settings["first_seed"], settings["first_seed"] + settings["episodes"])
    conditions = settings.get("condition", NO_CONDITION)
    tasks = grid(settings["scenario"], settings["method"], seeds, conditions=conditions)
    return [key for task in tasks for key in task.episodes()]
