"""What the folder of a table notes is what the episodes in it were made with."""

from dataclasses import replace
from pathlib import Path

import pytest

from baselines.cli import parsed
from baselines.evaluation.job import MODEL_FILES
from baselines.evaluation.run import completed, identity
from baselines.evaluation.settings import Settings
from baselines.evaluation.store import EPISODES, Store, read_settings
from baselines.folder_note import difference
from baselines.methods import method_named
from baselines.paper import command as reproduce
from baselines.paper.folder import read_run
from baselines.paper.gathering import gather
from baselines.paper.tasks import Plan, measuring, scoring, table_of, units
from cad_env.scoring.scorecard import Record


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    """All rows; the models cannot be loaded, but only a digest of them is noted."""
    full: Plan = reproduce.plan_of(reproduce.ReproduceSettings(preset="full", out=tmp_path / "run"))
    plan = replace(full, scenarios=("left_turn",), preset=replace(full.preset, seeds=(0, 1), scored=2, swept=1))
    _write_models(plan, "learned")
    return plan


@pytest.fixture
def tables(plan: Plan) -> dict[Path, list[Settings]]:
    """The parts of every table, after they are gathered."""
    found: dict[Path, list[Settings]] = {}
    for unit in units(plan):
        for task in measuring(plan, unit):
            if task.stage != "open":
                found.setdefault(plan.out / table_of(task), []).append(scoring(plan, task))
    for part in (part for parts in found.values() for part in parts):
        store = Store(part.out, identity(part))
        keys = [key[1:] for task in part.tasks() for key in task.episodes()]  # without a condition
        store.append(Record(*key, False, "success", 9.0, 0, None, None, 0, 0, 0, None, None, 3, 0.0) for key in keys)
        completed(part, store, lambda episodes: None)
    gather(plan)
    return found


def _write_models(plan: Plan, weights: str) -> None:
    for row, seed in units(plan):
        if model := method_named(row).model:
            folder = plan.models(seed) / model
            folder.mkdir(parents=True, exist_ok=True)
            for name in MODEL_FILES:
                (folder / name).write_text(f"{weights} {row} {seed}")


def test_every_noted_command_makes_the_episodes_of_its_methods(tables: dict[Path, list[Settings]]) -> None:
    for folder, parts in tables.items():
        noted = [parsed(Settings, line.split()[2:]) for line in read_settings(folder)["command"].splitlines()]
        makes = {name: run for run in noted for name in run.method}
        assert len(makes) == sum(len(run.method) for run in noted) == len(parts)
        for part in parts:
            again = replace(makes[part.method[0]], method=part.method)
            assert not difference(identity(part), identity(again)), folder


def test_a_table_notes_the_settings_of_each_method(tables: dict[Path, list[Settings]]) -> None:
    for folder, parts in tables.items():
        noted = read_settings(folder)
        for part in parts:
            (who,) = part.method
            for name, value in read_settings(part.out).items():
                if name not in ("method", "command"):
                    assert noted.get(f"{name} of {who}", noted.get(name)) == value, (folder, who, name)


def test_a_table_of_models_that_are_replaced_is_withdrawn(plan: Plan, tables: dict[Path, list[Settings]]) -> None:
    _write_models(plan, "learned again")
    gather(plan)
    run = read_run(plan.out)
    rules = {name for name in plan.rows if not method_named(name).model}
    assert set(run.closed["dsrc"]["left_turn"]) == rules
    assert not run.closed["ideal"]
    assert not run.sweeps
    assert set(run.commands) == {"closed/dsrc/0"}
    assert all((part.out / EPISODES).exists() for parts in tables.values() for part in parts)
