"""train.py: demonstrations, then every method and seed side by side, then their closed-loop table."""

import sys
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.cli import Progress, parsed, refused, stopped
from baselines.evaluation.command import scored
from baselines.evaluation.settings import ALL_SCENARIOS, Settings
from baselines.methods import learned_named, radio_of
from baselines.training.config import Budget, Lesson, claim_course, course_of, learn
from cad_env.config import check_range, radio_config

MAIN_METHODS = ("stgraph", "stgraph-own")


RULES = ("always-go", "always-brake", "planner-own", "planner-shared", "expert")  # whom the rows are scored beside


@dataclass(frozen=True)
class TrainSettings:
    """Train the paper's policy and print how often it crashes, next to who sees everything and who shares nothing."""

    scenario: tuple[str, ...] = ALL_SCENARIOS  # which scenarios one network learns: names, or all
    method: tuple[str, ...] = MAIN_METHODS  # which rows of the table (baselines/methods.py)
    out: Path | None = None  # folder of models, data and scores; default: runs/all, or runs/<scenario>
    radio: str = "dsrc"  # dsrc, cv2x or ideal: what is trained and scored on; rows that need another have their own
    episodes: int = 1500  # of each scenario, driven by the expert
    dagger_rounds: int = 2  # rounds in which the network drives and the expert labels (DAgger)
    mixing: float = 0.0  # share of the decisions that the expert takes in the first of these; of the n-th: to the n
    steps: int = 2400  # optimiser steps of the first round; later rounds take half as many
    validation: int = 60  # closed-loop episodes of each scenario after each third of a round, to choose a checkpoint
    seed: tuple[int, ...] = (0,)  # of the networks and of all that is drawn while training; several: one run for each
    score: int = 300  # episodes per method and scenario at the end; 0 trains only
    jobs: int = 2  # processes
    velocity: bool = False  # a departure from the paper: nodes carry their velocity (StGraphConfig)

    def __post_init__(self) -> None:
        if radio_config(self.radio).budget == 0.0:
            raise ValueError(f"radio must be one that carries something, got {self.radio!r}")
        for what in ("method", "seed"):
            given = getattr(self, what)
            if not given or len(set(given)) < len(given):
                raise ValueError(f"{what} must name at least one, each once, got {' '.join(map(str, given))!r}")
        for name in self.method:
            if self.velocity and learned_named(name).spec != "stgraph":
                raise ValueError(f"velocity is for rows of the paper's network, and {name} is not one")
        check_range("score", self.score, 0, 1_000_000)
        check_range("jobs", self.jobs, 1, 64)

    def folder(self) -> Path:
        """Where everything goes."""
        return self.out or Path("runs") / "+".join(self.scenario)

    def models(self, seed: int) -> Path:
        """The folder of the models of a training seed."""
        return self.folder() if len(self.seed) == 1 else self.folder() / f"seed_{seed}"

    def scenarios(self) -> tuple[str, ...]:
        """What the networks learn, in the same order however it was asked for; ValueError for what does not exist."""
        from cad_env.scenarios import SCENARIOS, SHIPPED, scenario_named

        chosen = [scenario_named(name).name for name in (SHIPPED if self.scenario == ALL_SCENARIOS else self.scenario)]
        return tuple(sorted(chosen, key=list(SCENARIOS).index))

    def budget(self) -> Budget:
        """What every row may cost."""
        return Budget(
            self.scenarios(), self.radio, self.episodes, self.dagger_rounds, self.steps, self.validation,
            mixing=self.mixing,
        )  # fmt: skip

    def lessons(self) -> list[tuple[Lesson, Any]]:
        """Every row and seed, with its course; ValueError for one that is impossible."""
        knobs = {"velocity": True} if self.velocity else {}
        demonstrations, budget = self.folder() / "demonstrations", self.budget()
        return [
            (
                Lesson(method, seed, self.models(seed), demonstrations),
                course_of(learned_named(method), seed, budget, knobs),
            )
            for seed in self.seed
            for method in self.method
        ]

    def scoring(self) -> list[Settings]:
        """The closed-loop comparison at the end, one for each radio that rows were trained over.

        Other episodes, rows or another version of the scenes score anew.
        """
        from cad_env.version import version

        found = []
        for radio, rows in self._rows_by_radio().items():
            asked = "" if rows == MAIN_METHODS else f"_{'+'.join(rows)}"
            scores = self.folder() / f"scores_{self.score}{asked}_{version()}"
            found.append(
                Settings(
                    scenario=self.scenarios(), method=(*RULES, *rows), models=tuple(map(self.models, self.seed)),
                    episodes=max(self.score, 1), jobs=self.jobs, out=scores, radio=radio,
                )
            )  # fmt: skip
        return found

    def _rows_by_radio(self) -> dict[str, tuple[str, ...]]:
        found: dict[str, tuple[str, ...]] = {}
        for name in self.method:
            radio = radio_of(name, self.radio)
            found[radio] = (*found.get(radio, ()), name)
        return found


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    try:
        settings = parsed(TrainSettings, argv)
        lessons = settings.lessons()
        for lesson, course in lessons:
            claim_course(lesson.folder, course)
        scoring = settings.scoring() if settings.score else []
        train_all(settings, lessons)
    except (ValueError, OSError) as error:
        return refused(error)
    except (KeyboardInterrupt, BrokenExecutor) as error:
        return stopped(error)
    print(f"The trained models are in {settings.folder()}.", file=sys.stderr)
    for each in scoring:
        if len(scoring) > 1 or each.radio != settings.radio:
            print(f"Over the radio {each.radio}:")
        if code := scored(each):
            return code
    return 0


def train_all(settings: TrainSettings, lessons: Sequence[tuple[Lesson, Any]]) -> None:
    """Record the expert once, then train side by side, with one progress bar over all the work."""
    from baselines.workers import workers

    scenes, folder = settings.scenarios(), settings.folder() / "demonstrations"
    total = settings.episodes * len(scenes) + sum(course.work() for _, course in lessons)
    with (
        workers(min(settings.jobs, max(len(lessons), len(scenes)))) as (pool, progress),
        Progress(total, "training") as bar,
    ):
        _wait_for([pool.submit(_record, folder, scene, settings.episodes) for scene in scenes], progress, bar)
        _wait_for([pool.submit(_learn, lesson, course) for lesson, course in lessons], progress, bar)


def _wait_for(running: "Sequence[Future[None]]", progress: Any, bar: Any) -> None:
    from baselines.workers import heard

    while not all(future.done() for future in running):
        bar.update(sum(heard(progress)))
        _raise_if_failed(running)
    bar.update(sum(heard(progress)))
    _raise_if_failed(running)


def _raise_if_failed(running: Sequence[Future[None]]) -> None:
    for future in running:
        if future.done():
            future.result()


def _record(folder: Path, scenario: str, episodes: int) -> None:
    from baselines.workers import tell
    from policies.training.dagger import record_demonstrations

    record_demonstrations(folder, scenario, episodes, tell)


def _learn(lesson: Lesson, course: Any) -> None:
    from baselines.workers import tell

    learn(lesson, course, tell)
