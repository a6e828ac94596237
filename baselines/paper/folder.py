"""The folder of a run -> everything the tables and plots are made of. What is not there is simply absent.

closed/<radio>/<training seed>/       results of evaluate.py (settings.json, episodes.jsonl)
open/<training seed>/<scenario>_<method>.json
sweeps/<name>/<value>/                results of evaluate.py
costs.json                            what networks cost, row by row
notes.md                              what people wrote about it
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.controls.names import BEST_BLIND
from baselines.evaluation.store import EPISODES, SETTINGS, read_records, read_settings
from baselines.paper.open_loop import OpenLoop, read_open_loop
from baselines.paper.sweeps import SWEEPS
from cad_env.files import read_json, read_text
from cad_env.scoring.scorecard import Record

NOTES, COSTS = "notes.md", "costs.json"
TABLE_ORDER = (
    "always-go", "always-brake", BEST_BLIND, "command-only", "planner-own", "cautious-own", "planner-shared",
    "planner-coverage", "expert", "ppo", "gat", "collab-gat", "stgraph-own", "raw-points", "compressed",
    "stgraph-no-edges", "stgraph-bc", "stgraph", "stgraph-velocity", "stgraph-motion-own", "stgraph-motion",
    "stgraph-coverage",
)  # fmt: skip

Drives = Mapping[int, Mapping[int, Record]]  # training seed -> seed of the episode -> what came of it


@dataclass(frozen=True)
class Run:
    """What was measured."""

    closed: Mapping[str, Mapping[str, Mapping[str, Drives]]]  # radio -> scenario -> method, as TABLE_ORDER go
    open: Mapping[str, Mapping[str, Mapping[int, OpenLoop]]]  # scenario -> method -> training seed
    sweeps: Mapping[str, Mapping[str, Mapping[str, Mapping[str, Mapping[int, Record]]]]]
    # name -> value, as SWEEPS go -> scenario -> method -> seed of the episode
    commands: Mapping[str, str]  # folder below that of the run -> the command that fills it
    costs: Any  # of JSON; None if nobody measured them
    notes: str

    def expert(self, scenario: str) -> Mapping[int, Record]:
        """The expert's episodes of a scenario by seed, over whatever radio: it needs none."""
        found: dict[int, Record] = {}
        for scenarios in self.closed.values():
            for records in scenarios.get(scenario, {}).get("expert", {}).values():
                found.update(records)
        return found


def read_run(folder: Path) -> Run:
    """Everything in a folder; FileError, one line, for a file that is damaged."""
    costs, notes = folder / COSTS, folder / NOTES
    return Run(
        {radio.name: _closed(radio) for radio in _folders(folder / "closed")},
        _open(folder / "open"),
        {name: found for name in SWEEPS if (found := _sweep(folder / "sweeps" / name, name))},
        dict(_commands(folder)),
        read_json(costs) if costs.exists() else None,
        read_text(notes).strip() if notes.exists() else "",
    )


def _closed(radio: Path) -> dict[str, dict[str, dict[int, dict[int, Record]]]]:
    found: dict[str, dict[str, dict[int, dict[int, Record]]]] = {}
    for training_seed, records in sorted((int(part.name), _records(part)) for part in _folders(radio, numbers=True)):
        for record in records:
            drives = found.setdefault(record.scenario, {}).setdefault(record.method, {})
            drives.setdefault(training_seed, {})[record.seed] = record
    return {scenario: in_table_order(methods) for scenario, methods in found.items()}


def _open(folder: Path) -> dict[str, dict[str, dict[int, OpenLoop]]]:
    found: dict[str, dict[str, dict[int, OpenLoop]]] = {}
    for part in sorted(_folders(folder, numbers=True), key=lambda part: int(part.name)):
        for path in sorted(part.glob("*.json")):
            loop = read_open_loop(path)
            found.setdefault(loop.scenario, {}).setdefault(loop.method, {})[int(part.name)] = loop
    return {scenario: in_table_order(methods) for scenario, methods in found.items()}


def _sweep(folder: Path, name: str) -> dict[str, dict[str, dict[str, dict[int, Record]]]]:
    places = {point.value: place for place, point in enumerate(SWEEPS[name].points)}
    values: dict[str, dict[str, dict[str, dict[int, Record]]]] = {}
    for part in sorted(_folders(folder), key=lambda part: places.get(part.name, len(places))):
        for record in _records(part):
            methods = values.setdefault(part.name, {}).setdefault(record.scenario, {})
            methods.setdefault(record.method, {})[record.seed] = record
    return values


def in_table_order(methods: Mapping[str, Any]) -> dict[str, Any]:
    """By method, in the order of the tables; methods that are not in them come last."""
    places = {name: place for place, name in enumerate(TABLE_ORDER)}
    return {name: methods[name] for name in sorted(methods, key=lambda name: (places.get(name, 99), name))}


def _folders(folder: Path, numbers: bool = False) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(part for part in folder.iterdir() if part.is_dir() and (part.name.isdecimal() or not numbers))


def _records(folder: Path) -> list[Record]:
    return read_records(folder) if (folder / EPISODES).exists() else []


def _commands(folder: Path) -> Iterator[tuple[str, str]]:
    for path in sorted([*folder.glob(f"closed/*/*/{SETTINGS}"), *folder.glob(f"sweeps/*/*/{SETTINGS}")]):
        command = read_settings(path.parent).get("command")
        if isinstance(command, str):
            yield path.parent.relative_to(folder).as_posix(), command
