"""reproduce.py: demonstrations, all methods, their scores and sweeps, and the tables and plots of them."""

import sys
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from baselines.cli import Progress, parsed, refused, say, stopped
from baselines.folder_note import claim
from baselines.paper.presets import PRESETS
from baselines.signals import sigterm_as_ctrl_c
from cad_env.checks import (
    ConfigError,
    check_numbers,
    check_path,
    check_several,
    check_switch,
    check_text,
    did_you_mean,
    settle,
)
from cad_env.files import replace_text
from cad_env.version import version

NOTE, FAILURES = "reproduce.json", "failures.txt"


Failure = tuple[str, str]  # what failed, and why: a line with the reason, then the traceback


@dataclass(frozen=True)
class ReproduceSettings:
    """Train and score every method of the paper's tables, and write results.md, results.json and plots."""

    preset: str = "quick"  # quick, hour or full: how many seeds, steps and episodes (baselines/paper/presets.py)
    out: Path = Path("runs/paper")  # folder of everything
    jobs: int = 2  # processes
    shard: str | None = None  # i/n: only the i-th of n parts; the last step is a run without it, or with --merge
    merge: bool = False  # nothing but the tables of what is finished
    method: tuple[str, ...] = ()  # only these methods; default: all of the tables

    def __post_init__(self) -> None:
        settle(self, "preset", check_text("preset", self.preset))
        if self.preset not in PRESETS:
            near = did_you_mean(self.preset, PRESETS)
            raise ConfigError(f"preset must be one of {', '.join(PRESETS)}, got {self.preset!r}{near}")
        settle(self, "out", check_path("out", self.out))
        settle(self, "method", check_several("method", self.method, check_text))
        settle(self, "merge", check_switch("merge", self.merge))
        check_numbers(self, "", {"jobs": (1, 64)})
        if self.shard and self.merge:
            raise ValueError("merge is of all shards: leave out --shard")
        if self.merge and not (self.out / NOTE).is_file():
            raise ValueError(f"merge is of a run that was begun: there is no {NOTE} in {self.out}")

    def command(self) -> str:
        """The command that makes the whole run."""
        return f"python reproduce.py --preset {self.preset} --out {self.out}"


@sigterm_as_ctrl_c()
def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    try:
        settings = parsed(ReproduceSettings, argv, _choices)
        plan = plan_of(settings)
        note = {**asdict(plan.preset), "version of cad_env": version()}
        claim(plan.out / NOTE, note, "use another --out or delete it")
        failures = [] if settings.merge else _run(plan, settings.jobs, settings.shard)
        if settings.shard is None:
            _put_together(plan, settings.command())
    except (ValueError, OSError) as error:
        return refused(error)
    except (KeyboardInterrupt, BrokenExecutor) as error:
        return stopped(error)
    return 1 if failures else 0


def _choices() -> str:
    from baselines.methods import choices
    from baselines.paper.tasks import in_table

    return choices(in_table())


def plan_of(settings: ReproduceSettings) -> Any:
    """What to do; ValueError for methods or shards that do not exist."""
    from baselines.evaluation.grid import shard_of
    from baselines.paper.tasks import Plan, in_table
    from cad_env.scenarios import SHIPPED

    if settings.shard is not None:
        shard_of(settings.shard)
    if unknown := [name for name in settings.method if name not in in_table()]:
        choices = f"choose among {', '.join(in_table())}{did_you_mean(unknown[0], in_table())}"
        raise ConfigError(f"unknown method {unknown[0]!r}: {choices}")
    rows = tuple(name for name in in_table() if not settings.method or name in settings.method)
    return Plan(settings.out, PRESETS[settings.preset], SHIPPED, rows)


def _run(plan: Any, jobs: int, shard: str | None) -> list[Failure]:
    """Record, then train and measure one training seed after the other, then sweep; with one progress bar.

    Returns what failed. After every stage failures are printed, and written to a file with their tracebacks, so that
    an interrupted run has them too. A run that is stopped has finished whole seeds.
    """
    from baselines.evaluation.grid import shard_of
    from baselines.paper import tasks as of

    mine = of.units(plan, shard)
    stages: list[tuple[str, list[Any]]] = []
    sweeps: list[Any] = []
    for seed in plan.preset.seeds:
        units = [unit for unit in mine if unit[1] == seed]
        measured = [task for unit in units for task in of.measuring(plan, unit)]
        stages += [
            (f"train, seed {seed}", [task for unit in units for task in of.training(plan, unit)]),
            (f"measure, seed {seed}", [task for task in measured if task.stage != "sweep"]),
        ]
        sweeps += [task for task in measured if task.stage == "sweep"]
    stages.append(("sweep", sweeps))
    demonstrations = float(plan.preset.episodes * len(plan.scenarios))
    total = demonstrations + sum(of.work_of(plan, task) for _, tasks in stages for task in tasks)
    notes = plan.out / (FAILURES if shard is None else "failures_{}_of_{}.txt".format(*shard_of(shard)))
    with Progress(total, "record") as bar:
        found = _all(partial(_record, plan), list(plan.scenarios), jobs, bar)
        failures = [(f"record {scenario}", story) for scenario, story in found]
        _note(notes, failures, failures)
        for name, tasks in stages if not failures else ():
            bar.describe(name)
            found = _all(partial(_perform, plan), _possible(tasks, failures), jobs, bar)
            failures += found
            _note(notes, failures, found)
    return failures


def _possible(tasks: Sequence[Any], failures: Sequence[Failure]) -> list[Any]:
    """Those whose method did not fail in training."""
    lost = {what for what, _ in failures}
    return [task for task in tasks if f"train {task.row} seed {task.seed}" not in lost]


def _note(path: Path, failures: Sequence[Failure], new: Sequence[Failure]) -> None:
    """Write all failures so far to a file with their tracebacks, and print a line for each new one."""
    from tqdm import tqdm

    path.unlink(missing_ok=True)
    if failures:
        replace_text(path, "\n\n".join(f"{what}\n{story}" for what, story in failures) + "\n")
    for what, story in new:
        tqdm.write(f"failed: {what}: {_reason(story)}", file=sys.stderr)


def _reason(story: str) -> str:
    return story.splitlines()[0]


def _all(work: Callable[[Any], str], tasks: Sequence[Any], jobs: int, bar: Progress) -> list[Failure]:
    """Do all tasks in several processes; returns those that failed, with their tracebacks."""
    from baselines.workers import heard, workers

    if not tasks:
        return []
    with workers(min(jobs, len(tasks))) as (pool, told):
        running = {pool.submit(work, task): task for task in tasks}
        while not all(future.done() for future in running):
            bar.update(sum(heard(told)))
        bar.update(sum(heard(told)))
        return [(str(task), future.result()) for future, task in running.items() if future.result()]


def _record(plan: Any, scenario: str) -> str:
    from baselines.paper.tasks import DEMONSTRATIONS
    from baselines.workers import tell
    from policies.training.dagger import record_demonstrations

    return _attempt(lambda: record_demonstrations(plan.out / DEMONSTRATIONS, scenario, plan.preset.episodes, tell))


def _perform(plan: Any, task: Any) -> str:
    from baselines.paper.tasks import perform
    from baselines.workers import tell

    return _attempt(lambda: perform(plan, task, tell))


def _attempt(act: Callable[[], object]) -> str:
    """Why it failed, in one line, and the traceback; empty if it did not."""
    try:
        act()
    except Exception as error:  # a row that fails, however it does, must not stop the others
        reason = " ".join(f"{type(error).__name__}: {error}".split())  # those of torch and numba have many lines
        return f"{reason}\n{traceback.format_exc()}"
    return ""


def _put_together(plan: Any, command: str) -> None:
    """Write tables and plots of all that is finished."""
    from baselines.paper.gathering import gather
    from baselines.paper.report import write_results

    if lacking := gather(plan):
        print(f"{lacking} parts are not finished: the tables are without them", file=sys.stderr)
    say(f"The tables and plots: {write_results(plan.out, command)}")
