"""train.py: demonstrations, then every method and seed side by side, then their closed-loop table."""

import sys
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from baselines.cli import Progress, parsed, refused, say, stopped
from baselines.controls.names import BEST_BLIND
from baselines.evaluation.command import scored
from baselines.evaluation.settings import ALL_SCENARIOS, Settings, usual
from baselines.methods import LEARNED, REWARDED, choices, folder_of, learned_named, radio_of
from baselines.signals import import_whole, sigterm_as_ctrl_c
from baselines.training.config import (
    RewardTask,
    TrainingTask,
    claim_folder,
    perform_training,
    ppo_config,
    training_config,
)
from cad_env.checks import check_numbers, check_path, check_seed, check_several, check_switch, check_text, settle
from cad_env.config import radio_config
from policies.training.config import STEPS, TrainingConfig
from policies.training.ppo_config import PpoConfig

MAIN_METHODS = ("stgraph-motion", "stgraph-motion-own")
# Scored beside them; best-blind as far as it was chosen.
REFERENCE_METHODS = ("always-go", BEST_BLIND, "planner-own", "planner-shared", "expert")
# The others are those of the training config that they make; only `steps` would be rounded up to what it takes.
_LIMITS = {"score": (0, 1_000_000), "jobs": (1, 64), "steps": STEPS, "decisions": (1, 10**9)}
_ASKED = ("radio", "episodes", "dagger_rounds", "dagger_episodes", "mixing", "steps", "validation")


@dataclass(frozen=True)
class TrainSettings:
    """Train the paper's policy and print how often it collides, beside policies that share nothing or know everything.

    A network of your own is named as module:SPEC (docs/write-your-own.md).
    """

    scenario: tuple[str, ...] = ALL_SCENARIOS  # which scenarios one network learns: names, or all
    method: tuple[str, ...] = MAIN_METHODS  # which methods (baselines/methods.py), or module:SPEC of your own network
    out: Path | None = None  # folder of models, demonstrations and scores; default: runs/all, or runs/<scenario>
    radio: str = TrainingConfig.radio  # dsrc, cv2x or ideal; methods with larger messages have their own
    episodes: int = TrainingConfig.episodes  # of the expert, in each scenario
    dagger_rounds: int = TrainingConfig.dagger_rounds  # in which the network drives and the expert labels
    dagger_episodes: int = TrainingConfig.dagger_episodes  # in each DAgger round and scenario
    mixing: float = TrainingConfig.mixing  # share of decisions the expert takes in the first; of the n-th: to the n
    steps: int = TrainingConfig.steps  # optimiser steps of the first round; later rounds take half as many
    validation: int = TrainingConfig.validation  # closed-loop episodes per scenario after each third of a round
    seed: tuple[int, ...] = (0,)  # of training; with several, each method is trained once from each
    score: int = 200  # episodes per method and scenario at the end; 0 trains only
    jobs: int = 2  # processes
    decisions: int = 300_000  # of half a second each, that methods that learn by reward (ppo) learn from
    reward: str = PpoConfig.reward  # that they learn by: progress, safety-first or time-and-safety
    clone: Path | None = None  # model folder that ppo-from-clone begins with; default: the package's stgraph-motion
    velocity: bool = False  # a departure from the paper: nodes carry their velocity (StGraphConfig)

    def __post_init__(self) -> None:
        if radio_config(self.radio).budget == 0.0:
            raise ValueError(f"radio must be one that carries something, got {self.radio!r}")
        for what, check in (("scenario", check_text), ("method", check_text), ("seed", check_seed)):
            settle(self, what, check_several(what, getattr(self, what), check))
        settle(self, "out", None if self.out is None else check_path("out", self.out))
        settle(self, "clone", None if self.clone is None else check_path("clone", self.clone))
        settle(self, "velocity", check_switch("velocity", self.velocity))
        check_numbers(self, "", _LIMITS)
        for what in ("method", "seed"):
            given = getattr(self, what)
            if not given or len(set(given)) < len(given):
                raise ValueError(f"{what} must name at least one, each once, got {' '.join(map(str, given))!r}")
        for name in self.method:
            if self.velocity and learned_named(name).spec != "stgraph":
                raise ValueError(f"velocity is an option of the paper's network, which {name} is not")

    def folder(self) -> Path:
        """Where everything goes."""
        return self.out or Path("runs") / "+".join(name.rpartition(":")[-1] for name in self.scenario)

    def models(self, seed: int) -> Path:
        """The folder of the models of a training seed."""
        return self.folder() if len(self.seed) == 1 else self.folder() / f"seed_{seed}"

    def scenarios(self) -> tuple[str, ...]:
        """What the networks learn, in the same order however it was asked for; ValueError for what does not exist."""
        from cad_env.scenarios import SCENARIOS, SHIPPED, scenario_named

        chosen = [scenario_named(name).name for name in (SHIPPED if self.scenario == ALL_SCENARIOS else self.scenario)]
        return tuple(sorted(chosen, key=list(SCENARIOS).index))

    def tasks(self) -> list[TrainingTask | RewardTask]:
        """What is to be trained; ValueError for what is impossible."""
        self._check_clone()
        return [self._task(name, seed) for seed in self.seed for name in self.method]

    def _check_clone(self) -> None:
        if self.clone is not None and not any(learned_named(name).begins_with for name in self.method):
            raise ValueError(f"clone is what ppo-from-clone begins with, got {self.clone} for {' '.join(self.method)}")

    def _task(self, name: str, seed: int) -> TrainingTask | RewardTask:
        method, scenarios = learned_named(name), self.scenarios()
        folder = self.models(seed) / method.model
        if name in REWARDED:
            clone = str(self.clone) if self.clone is not None and method.begins_with else None
            config = ppo_config(method, radio=self.radio, reward=self.reward, clone=clone)
            return RewardTask(name, config, self.decisions, seed, scenarios, folder)
        asked = {"scenarios": scenarios, "seed": seed, **{name: getattr(self, name) for name in _ASKED}}
        demonstrated = training_config(method, asked, {"velocity": True} if self.velocity else {})
        return TrainingTask(name, demonstrated, folder, self.demonstrations())

    def demonstrations(self) -> Path:
        """Where the expert's episodes go."""
        return self.folder() / "demonstrations"

    def scoring(self) -> list[Settings]:
        """The closed-loop comparison at the end, one for each radio that methods were trained over.

        Other episodes or methods, and another version of the scenes, are scored anew.
        """
        from cad_env.version import version

        found = []
        for radio, methods in self._by_radio().items():
            asked = "" if methods == MAIN_METHODS else f"_{'+'.join(map(folder_of, methods))}"
            scores = self.folder() / f"scores_{self.score}{asked}_{version()}"
            found.append(
                Settings(
                    scenario=self.scenarios(), method=(*usual(REFERENCE_METHODS, self.scenarios()), *methods),
                    models=tuple(map(self.models, self.seed)),
                    episodes=max(self.score, 1), jobs=self.jobs, out=scores, radio=radio,
                )
            )  # fmt: skip
        return found

    def _by_radio(self) -> dict[str, tuple[str, ...]]:
        found: dict[str, tuple[str, ...]] = {}
        for name in self.method:
            radio = radio_of(name, self.radio)
            found[radio] = (*found.get(radio, ()), name)
        return found


@sigterm_as_ctrl_c()
def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    try:
        settings = parsed(TrainSettings, argv, partial(choices, (*LEARNED, *REWARDED)))
        import_whole("policies.model_folder")
        tasks = settings.tasks()
        for task in tasks:
            claim_folder(task)
        scoring = settings.scoring() if settings.score else []
        train_all(settings, tasks)
        print(f"The trained models are in {settings.folder()}.", file=sys.stderr)
        return _all_scored(settings, scoring)
    except (ValueError, OSError) as error:
        return refused(error)
    except (KeyboardInterrupt, BrokenExecutor) as error:
        return stopped(error)


def _all_scored(settings: TrainSettings, scoring: Sequence[Settings]) -> int:
    """Score, over one radio after the other; the exit code."""
    for each in scoring:
        if len(scoring) > 1 or each.radio != settings.radio:
            say(f"Over the radio {each.radio}:")
        if code := scored(each):
            return code
    return 0


def train_all(settings: TrainSettings, tasks: Sequence[TrainingTask | RewardTask]) -> None:
    """Record the expert once for all that learn from it, then train side by side, with one progress bar."""
    from baselines.workers import workers

    shared, folder = any(task.learns_from_shared for task in tasks), settings.demonstrations()
    scenarios = settings.scenarios() if shared else ()
    total = settings.episodes * len(scenarios) + sum(task.work() for task in tasks)
    with (
        workers(min(settings.jobs, max(len(tasks), len(scenarios)))) as (pool, progress),
        Progress(total, "training") as bar,
    ):
        _wait_for([pool.submit(_record, folder, name, settings.episodes) for name in scenarios], progress, bar)
        _wait_for([pool.submit(_train, task) for task in tasks], progress, bar)


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


def _train(task: TrainingTask | RewardTask) -> None:
    from baselines.workers import tell

    perform_training(task, tell)
