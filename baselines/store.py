"""A folder of results that survives an interruption at any moment: finished episodes are never lost.

`episodes.jsonl` grows by whole lines that are on the disk before the next ones are computed. `settings.json` says
what the episodes were made with, so that runs with different settings never mix.
"""

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from cad_env.files import replace_file
from cad_env.score import Record, Scorecard, parse_record

EPISODES, SETTINGS, SCORES = "episodes.jsonl", "settings.json", "scores.json"


class Store:
    """The results in a folder."""

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        """Open or make the folder; ValueError or OSError if it is damaged, of other settings or not writable."""
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._agree_on(settings)
        self.records = {(record.contender, record.seed): record for record in self._read()}

    def append(self, records: Iterable[Record]) -> None:
        """Keep episodes: when this returns they are on the disk."""
        records = list(records)
        with open(self.folder / EPISODES, "ab") as file:
            file.write("".join(record.line() + "\n" for record in records).encode())
            file.flush()
            os.fsync(file.fileno())
        self.records.update({(record.contender, record.seed): record for record in records})

    def finish(self, records: Iterable[Record], scores: Iterable[Scorecard]) -> None:
        """Put the episodes in their order and write the scores."""
        replace_file(self.folder / EPISODES, "".join(record.line() + "\n" for record in records).encode())
        rows = ",\n".join(json.dumps(vars(row), allow_nan=False) for row in scores)
        replace_file(self.folder / SCORES, f"[\n{rows}\n]\n".encode())

    def _agree_on(self, settings: Mapping[str, Any]) -> None:
        path = self.folder / SETTINGS
        if not path.exists():
            if (self.folder / EPISODES).exists():
                raise ValueError(f"{self.folder} has episodes but no {SETTINGS}: use another folder")
            replace_file(path, (json.dumps(settings, indent=2) + "\n").encode())
            return
        try:
            before = json.loads(path.read_text())
        except ValueError as error:
            raise ValueError(f"{path} is damaged ({error}): use another folder") from None
        before = before if isinstance(before, dict) else {}
        for name in [*settings, *before]:
            if before.get(name) != settings.get(name):
                raise ValueError(
                    f"{self.folder} has episodes with another {name} ({_brief(before.get(name))}, now "
                    f"{_brief(settings.get(name))}): use another folder or delete that one"
                )

    def _read(self) -> list[Record]:
        path = self.folder / EPISODES
        with open(path, "a+b") as file:  # made if it is not there, so that a folder that refuses does so at once
            file.seek(0)
            data = file.read()
            whole = data[: data.rfind(b"\n") + 1]
            if len(whole) < len(data):  # an interrupted write left a piece of a line
                file.truncate(len(whole))
        records = []
        for number, line in enumerate(whole.splitlines(), 1):
            try:
                records.append(parse_record(line.decode()))
            except ValueError as error:
                raise ValueError(f"{path} line {number}: {error}") from None
        return records


def _brief(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."
