"""Joins the parts of a reproduction, one for each method, into the folders that its report is made of."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from baselines.evaluation.grid import grid
from baselines.evaluation.run import identity
from baselines.evaluation.settings import Settings
from baselines.evaluation.store import (
    EPISODES,
    SCORES,
    SETTINGS,
    Store,
    key_of,
    read_records,
    read_settings,
)
from baselines.folder_note import difference
from baselines.methods import SHIPPED_METHODS
from baselines.paper.tasks import PaperTask, Plan, answered, every_unit, measuring, scoring, table_of
from cad_env.files import replace_text
from cad_env.scoring.scorecard import scorecards


def gather(plan: Plan) -> int:
    """Fill closed/ and sweeps/ with all that is finished; returns how many parts, also of open loop, are not.

    ValueError for open-loop answers of another model than the one that is there now.
    """
    tables: dict[str, list[PaperTask]] = {}
    lacking = 0
    for unit in every_unit(plan):
        for task in measuring(plan, unit):
            if task.stage == "open":
                lacking += not answered(plan, task)
            else:
                tables.setdefault(table_of(task), []).append(task)
    for name, tasks in tables.items():
        parts = [scoring(plan, task) for task in tasks]
        finished = [part for part in parts if _is_finished(part)]
        lacking += len(parts) - len(finished)
        if finished:
            _join(finished, plan.out / name)
        elif any((part.out / SCORES).exists() for part in parts):
            for file in (EPISODES, SETTINGS, SCORES):  # copies of what other models did; the parts themselves stay
                (plan.out / name / file).unlink(missing_ok=True)
    return lacking


def _is_finished(part: Settings) -> bool:
    """Whether all episodes are there and belong to the present model."""
    there = all((part.out / name).exists() for name in (SCORES, SETTINGS))
    return there and not difference(read_settings(part.out), identity(part))


def commands(parts: Sequence[Settings]) -> str:
    """The commands that give the episodes of these parts: one for all parts that differ only in the method."""
    models = next((part.models for part in parts if part.models), ())  # of one training seed; rules do not look at it
    groups: dict[Settings, list[str]] = {}
    for part in parts:
        alike = replace(part, method=SHIPPED_METHODS, models=models, out=parts[0].out)
        groups.setdefault(alike, []).append(part.method[0])
    return "\n".join(replace(alike, method=tuple(names)).command() for alike, names in groups.items())


def _side_by_side(notes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The settings of each method in one mapping; where they differ, as `<setting> of <method>`."""
    first = next(iter(notes.values()))
    shared = {name: value for name, value in first.items() if all(note.get(name) == value for note in notes.values())}
    return shared | {
        f"{name.removesuffix(f' of {who}')} of {who}": value  # that of a model says so already
        for who, note in notes.items()
        for name, value in note.items()
        if name not in {*shared, "method", "command"}
    }


def _join(parts: Sequence[Settings], into: Path) -> None:
    """As if all methods had been scored in one run."""
    whole = replace(parts[0], method=tuple(part.method[0] for part in parts), out=into)
    settings = _side_by_side({part.method[0]: read_settings(part.out) for part in parts})
    settings |= {"method": list(whole.method), "command": commands(parts)}
    into.mkdir(parents=True, exist_ok=True)
    replace_text(into / SETTINGS, json.dumps(settings, indent=2) + "\n")
    store = Store(into, settings)
    store.records = {key_of(record): record for part in parts for record in read_records(part.out)}
    tasks = grid(whole.scenarios(), whole.method, whole.seeds())
    store.write_scores(scorecards(store.put_in_order([key for task in tasks for key in task.episodes()])))
