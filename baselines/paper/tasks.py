"""The tasks behind the paper's tables: record, train every method and seed, test it in open and closed loop, sweep.

A task reads and writes files of its own, each whole or resuming where it stopped, so that tasks can be shared out
among processes and, by shards, among machines with one file system.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from baselines.evaluation.grid import Key, shard_of
from baselines.evaluation.settings import Settings
from baselines.evaluation.store import EPISODES, key_of, read_records, read_settings
from baselines.folder_note import difference
from baselines.methods import LEARNED, METHODS, REWARDED, method_named, radio_of
from baselines.paper.folder import TABLE_ORDER
from baselines.paper.open_loop import FIRST_SEED, measure, open_path, read_open_loop, write_open_loop
from baselines.paper.presets import END_POINTS, Preset
from baselines.paper.sweeps import SweepPoint, points
from baselines.training.config import RewardTask, TrainingTask, perform_training, ppo_config, training_config
from cad_env.scoring.scorecard import Record
from policies.training.config import Advance

USUAL_RADIO = "dsrc"
SPARE = "ideal"  # what rows are scored over as well whose messages are too large for the other
LARGE = ("points", "features")
DEMONSTRATIONS, MODELS, PARTS = "demonstrations", "models", "parts"
EPISODE = 1.6  # work of an episode that is driven; an optimiser step is 1


@dataclass(frozen=True)
class Plan:
    """A reproduction in a folder."""

    out: Path
    preset: Preset
    scenarios: tuple[str, ...]
    rows: tuple[str, ...]  # methods, in the order of the tables

    def training(self, method: str, seed: int) -> TrainingTask | RewardTask:
        """How a method is trained."""
        if method in REWARDED:
            learned, decisions = REWARDED[method], self.preset.ppo_steps
            config = ppo_config(learned, radio=USUAL_RADIO)
            return RewardTask(method, config, decisions, seed, self.scenarios, self.models(seed) / learned.model)
        learned = LEARNED[method]
        overrides = {"scenarios": self.scenarios, "radio": USUAL_RADIO, "seed": seed, **self.preset.training}
        demonstrated = training_config(learned, overrides)
        return TrainingTask(method, demonstrated, self.models(seed) / learned.model, self.out / DEMONSTRATIONS)

    def models(self, seed: int) -> Path:
        """The models of a training seed."""
        return self.out / MODELS / f"seed_{seed}"

    def settings(self, row: str, seed: int, out: Path, **overrides: object) -> Settings:
        """A run of evaluate.py of one method."""
        options = {"radio": USUAL_RADIO, "episodes": self.preset.scored, **overrides}
        return Settings(
            scenario=self.scenarios, method=(row,), out=out, report=False,
            models=(self.models(seed),) if method_named(row).model else (), **options,  # type: ignore[arg-type]
        )  # fmt: skip


@dataclass(frozen=True)
class PaperTask:
    """A piece of work of one method and training seed."""

    stage: str  # of STAGES
    row: str
    seed: int
    what: str = ""  # the scenario, the radio or the point of a sweep

    def __str__(self) -> str:
        return " ".join(str(part) for part in (self.stage, self.row, f"seed {self.seed}", self.what) if part)


def in_table() -> tuple[str, ...]:
    """All methods that have a line in the tables, in their order."""
    return tuple(name for name in TABLE_ORDER if name in METHODS)


def every_unit(plan: Plan) -> list[tuple[str, int]]:
    """Every method and training seed, as the tables go; one that is not trained comes once."""
    seeds = plan.preset.seeds
    return [(name, seed) for name in plan.rows for seed in (seeds if method_named(name).model else seeds[:1])]


def units(plan: Plan, shard: str | None = None) -> list[tuple[str, int]]:
    """The same, or those of a shard `i/n`.

    Those that cost most come first, so that processes end at about the same time, and each goes to the shard that has
    least to do so far.
    """
    number, count = (1, 1) if shard is None else shard_of(shard)
    work = {unit: _work(plan, unit) for unit in every_unit(plan)}
    shards: list[list[tuple[str, int]]] = [[] for _ in range(count)]
    loads = [0.0] * count
    for unit in sorted(work, key=lambda unit: -work[unit]):
        least = loads.index(min(loads))
        shards[least].append(unit)
        loads[least] += work[unit]
    return shards[number - 1]


def _work(plan: Plan, unit: tuple[str, int]) -> float:
    return sum(work_of(plan, task) for stage in (training, measuring) for task in stage(plan, unit))


def training(plan: Plan, unit: tuple[str, int]) -> Iterator[PaperTask]:
    """What must be done before a method can drive."""
    if method_named(unit[0]).model:
        yield PaperTask("train", *unit)


def measuring(plan: Plan, unit: tuple[str, int]) -> Iterator[PaperTask]:
    """What is measured of a method; sweeps are of the first training seed."""
    row, seed = unit
    for radio in (USUAL_RADIO, SPARE) if _is_large(row) else (USUAL_RADIO,):
        yield PaperTask("closed", row, seed, radio)
    for scenario in plan.scenarios:
        yield PaperTask("open", row, seed, scenario)
    if seed == plan.preset.seeds[0] and plan.preset.swept:
        for point in swept(plan.preset):
            if row in point.methods:
                yield PaperTask("sweep", row, seed, point.folder)


def swept(preset: Preset) -> list[SweepPoint]:
    """The points of all sweeps that a preset asks for."""
    return list(points(preset.sweep_points == END_POINTS))


def _is_large(row: str) -> bool:
    return row in LEARNED and LEARNED[row].shares in LARGE


def work_of(plan: Plan, task: PaperTask) -> float:
    """What `perform` tells its `advance`, about."""
    if task.stage == "train":
        return _cost(task.row) * plan.training(task.row, task.seed).work()
    made, scenes = plan.preset, len(plan.scenarios)
    episodes = {"open": made.open_loop, "closed": made.scored * scenes, "sweep": made.swept * scenes}
    return _cost(task.row) * EPISODE * episodes[task.stage]


def _cost(row: str) -> float:
    return LEARNED[row].cost if row in LEARNED else 1.0


def perform(plan: Plan, task: PaperTask, advance: Advance) -> None:
    """Do it, or as much of it as is still to do."""
    STAGES[task.stage](plan, task, lambda work: advance(_cost(task.row) * work))


def _train(plan: Plan, task: PaperTask, advance: Advance) -> None:
    perform_training(plan.training(task.row, task.seed), advance)


def answered(plan: Plan, task: PaperTask) -> bool:
    """Whether the answers of a task of stage open are there; ValueError for those of another model or version."""
    from baselines.evaluation.run import digest_of

    path = open_path(plan.out, task.seed, task.what, task.row)
    if not path.exists():
        return False
    if read_open_loop(path).made_with != digest_of(_asking(plan, task)):
        raise ValueError(f"{path} is of another model or another version of the scenes: delete it")
    return True


def _asking(plan: Plan, task: PaperTask) -> Settings:
    return plan.settings(
        task.row, task.seed, plan.out, radio=radio_of(task.row, USUAL_RADIO), episodes=plan.preset.open_loop
    )


def _open(plan: Plan, task: PaperTask, advance: Advance) -> None:
    from baselines.evaluation.run import digest_of

    if not answered(plan, task):
        settings, seeds = _asking(plan, task), range(FIRST_SEED, FIRST_SEED + plan.preset.open_loop)
        found = measure(method_named(task.row), settings, task.what, seeds)
        path = open_path(plan.out, task.seed, task.what, task.row)
        write_open_loop(path, replace(found, made_with=digest_of(settings)))
    advance(EPISODE * plan.preset.open_loop)


def table_of(task: PaperTask) -> str:
    """The folder, below that of the run, in which the methods of such a task stand side by side."""
    return f"closed/{task.what}/{task.seed}" if task.stage == "closed" else task.what


def scoring(plan: Plan, task: PaperTask) -> Settings:
    """The run of evaluate.py that a task of stage closed or sweep is."""
    out = plan.out / PARTS / table_of(task) / task.row
    if task.stage == "closed":
        return plan.settings(task.row, task.seed, out, radio=task.what)
    point = next(point for point in swept(plan.preset) if point.folder == task.what)
    options = {"radio": radio_of(task.row, USUAL_RADIO), "episodes": plan.preset.swept, **point.overrides}
    return plan.settings(task.row, task.seed, out, **options)


def _score(plan: Plan, task: PaperTask, advance: Advance) -> None:
    from baselines.evaluation.run import completed, opened_store

    settings = scoring(plan, task)
    store = opened_store(settings)
    wanted = {key for part in settings.tasks() for key in part.episodes()}
    missing = wanted - store.records.keys()
    if known := [record for record in _driven_elsewhere(plan, task, settings) if key_of(record) in missing]:
        store.append(known)
    advance(EPISODE * len(store.records))
    completed(settings, store, lambda episodes: advance(EPISODE * episodes))


def _driven_elsewhere(plan: Plan, task: PaperTask, settings: Settings) -> list[Record]:
    """Episodes that another part has driven with the same settings: sweeps meet where they change nothing."""
    from baselines.evaluation.run import identity

    ours, found = identity(settings), dict[Key, Record]()
    for other in measuring(plan, (task.row, task.seed)):
        if other.stage == "open" or other == task:
            continue
        folder = scoring(plan, other).out
        alike = {"episodes": ours["episodes"]}  # how many were asked for does not matter
        if (folder / EPISODES).exists() and not difference({**read_settings(folder), **alike}, ours):
            found |= {key_of(record): record for record in read_records(folder)}
    return list(found.values())


STAGES: Mapping[str, Callable[[Plan, PaperTask, Advance], None]] = MappingProxyType(
    {"train": _train, "open": _open, "closed": _score, "sweep": _score}
)
