"""A folder of results that survives an interruption at any moment: finished episodes are never lost.

`episodes.jsonl` grows by whole lines that are on the disk before the next ones are computed. `settings.json` says
what the episodes were made with, so that runs with different settings never mix.
"""

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from baselines.evaluation.grid import Key
from cad_env.files import replace_file
from cad_env.scoring.scorecard import Record, Scorecard, parse_record

EPISODES, SETTINGS, SCORES = "episodes.jsonl", "settings.json", "scores.json"
GIFS = "gifs"  # the folder of animations in a folder of results
NOTES = ("command",)  # in settings.json: may differ between runs of the same episodes


class Store:
    """The results in a folder."""

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        """Open or make the folder; ValueError or OSError if it is damaged, of other settings or not writable."""
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._agree_on(settings)
        _make_appendable(folder / EPISODES)
        self.records = {key_of(record): record for record in read_records(folder)}

    def append(self, records: Iterable[Record]) -> None:
        """Keep episodes: when this returns they are on the disk."""
        records = list(records)
        with open(self.folder / EPISODES, "ab") as file:
            file.write("".join(record.line() + "\n" for record in records).encode())
            file.flush()
            os.fsync(file.fileno())
        self.records.update({key_of(record): record for record in records})

    def put_in_order(self, keys: Iterable[Key]) -> list[Record]:
        """These episodes, and no others, in this order, in the file too."""
        records = [self.records[key] for key in keys]
        replace_file(self.folder / EPISODES, "".join(record.line() + "\n" for record in records).encode())
        return records

    def write_scores(self, scores: Iterable[Scorecard]) -> None:
        """Write the rows of the table."""
        rows = ",\n".join(json.dumps(vars(row), allow_nan=False) for row in scores)
        replace_file(self.folder / SCORES, f"[\n{rows}\n]\n".encode())

    def _agree_on(self, settings: Mapping[str, Any]) -> None:
        path = self.folder / SETTINGS
        if not path.exists():
            if (self.folder / EPISODES).exists():
                raise ValueError(f"{self.folder} has episodes but no {SETTINGS}: use another folder")
            replace_file(path, (json.dumps(settings, indent=2) + "\n").encode())
            return
        change = difference(read_settings(self.folder), settings)
        if change:
            raise ValueError(f"{self.folder} has episodes with {change}: use another folder or delete that one")


def key_of(record: Record) -> Key:
    """What tells an episode from all others of a run."""
    return record.scenario, record.contender, record.seed


def gif_of(folder: Path, record: Record) -> Path:
    """Where the animation of an episode is, if there is one."""
    return folder / GIFS / gif_name(record)


def gif_name(record: Record) -> str:
    """`<scenario>_<contender>_<outcome>_<seed>.gif`."""
    return f"{record.scenario}_{record.contender}_{record.outcome}_{record.seed}.gif"


def read_settings(folder: Path) -> dict[str, Any]:
    """What the episodes of a folder were made with. OSError if it does not say, ValueError if that is damaged."""
    path = folder / SETTINGS
    try:
        settings = json.loads(path.read_text())
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({error}): use another folder") from None
    return settings if isinstance(settings, dict) else {}


def difference(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The first setting that differs, in words; empty if none does.

    >>> difference({"depth": 15}, {"depth": 2})
    'another depth (15, now 2)'
    """
    for name in [*now, *before]:
        if before.get(name) != now.get(name) and name not in NOTES:
            return f"another {name} ({_brief(before.get(name))}, now {_brief(now.get(name))})"
    return ""


def read_records(folder: Path) -> list[Record]:
    """The episodes of a folder in the order of its file; a last line without its end does not count."""
    path = folder / EPISODES
    data = path.read_bytes()
    records = []
    for number, line in enumerate(data[: data.rfind(b"\n") + 1].splitlines(), 1):
        try:
            records.append(parse_record(line.decode()))
        except ValueError as error:
            raise ValueError(f"{path} line {number}: {error}") from None
    return records


def _make_appendable(path: Path) -> None:
    with open(path, "a+b") as file:  # made if it is not there, so that a folder that refuses does so at once
        file.seek(0)
        data = file.read()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):  # an interrupted write left a piece of a line
            file.truncate(whole)


def _brief(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."
