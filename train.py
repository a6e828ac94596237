"""Record the expert, clone it with and without sharing, score both in closed loop, print the table.

python train.py                                      the main job, some minutes on two cores
python train.py --scenario left_turn                 networks that know this scenario only
python train.py --episodes 200 --corrections 0 --steps 600 --score 50 --out runs/quick     a quick look

Interrupt it as you like: the same command goes on where it stopped.
"""

import json
import queue
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Future
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from baselines.settings import Settings
from cad_env.config import check_range, radio_config
from cad_env.files import replace_file
from evaluate import parsed, refused, scored, stopped

ALL = ("all",)
SCORED = ("always-go", "always-brake", "planner-own", "planner-shared", "expert", "stgraph", "stgraph-own")


@dataclass(frozen=True)
class TrainSettings:
    """Train the paper's policy and print how often it crashes, next to who sees everything and who shares nothing."""

    scenario: tuple[str, ...] = ALL  # which scenarios one network learns: names, or all
    out: Path | None = None  # folder of models, data and scores; default: runs/all, or runs/<scenario>
    radio: str = "dsrc"  # dsrc, cv2x or ideal: what the sharing network is trained and scored on
    episodes: int = 600  # of each scenario, driven by the expert
    corrections: int = 2  # rounds in which the network drives and the expert labels (DAgger)
    steps: int = 2400  # optimiser steps of the first round; later rounds take half as many
    validation: int = 60  # closed-loop episodes of each scenario after each third of a round, to choose a checkpoint
    seed: int = 0  # of the networks and of everything drawn while training
    score: int = 300  # episodes per contender and scenario at the end; 0 trains only
    jobs: int = 2  # processes
    velocity: bool = False  # a departure from the paper: nodes carry their velocity (StGraphConfig)

    def __post_init__(self) -> None:
        if radio_config(self.radio).budget == 0.0:
            raise ValueError(f"radio must be one that carries something, got {self.radio!r}")
        check_range("score", self.score, 0, 1_000_000)
        check_range("jobs", self.jobs, 1, 64)

    def folder(self) -> Path:
        """Where everything goes."""
        return self.out or Path("runs") / "+".join(self.scenario)

    def scenarios(self) -> tuple[str, ...]:
        """What the networks learn, in the same order however it was asked for; ValueError for what does not exist."""
        from cad_env.scenarios import SCENARIOS, scenario_named

        chosen = [scenario_named(name).name for name in (SCENARIOS if self.scenario == ALL else self.scenario)]
        return tuple(sorted(chosen, key=list(SCENARIOS).index))

    def scoring(self) -> Settings:
        """The closed-loop comparison at the end; other episodes or another version of the scenes score anew."""
        from cad_env.compiled import version

        scores = self.folder() / f"scores_{self.score}_{version()}"
        return Settings(
            scenario=self.scenarios(), contender=SCORED, policy=self.folder(), episodes=max(self.score, 1),
            jobs=self.jobs, out=scores, radio=self.radio,
        )  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    try:
        settings = parsed(TrainSettings, argv)
        courses(settings)
        claim(settings)
        train_all(settings)
    except (ValueError, OSError) as error:
        return refused(error)
    except (KeyboardInterrupt, BrokenExecutor) as error:
        return stopped(error)
    print(f"The trained models are in {settings.folder()}.", file=sys.stderr)
    return scored(settings.scoring()) if settings.score else 0


def courses(settings: TrainSettings) -> dict[str, Any]:
    """The two networks to train, by the name of their folder: the same course, with sharing and without.

    ValueError for a scenario that does not exist or a course that is impossible.
    """
    from policies.stgraph import StGraphConfig
    from policies.training import Course

    def course(radio: str) -> Course:
        return Course(
            scenarios=settings.scenarios(), radio=radio, seed=settings.seed, episodes=settings.episodes,
            corrections=settings.corrections, steps=settings.steps, validation=settings.validation,
            final_validation=settings.validation * 5 // 3, network=StGraphConfig(velocity=settings.velocity),
        )  # fmt: skip

    return {"shared": course(settings.radio), "own": course("none")}


def claim(settings: TrainSettings) -> None:
    """Note in the folder what it is for; ValueError if it holds a run of other settings."""
    from cad_env.compiled import version

    folder, path = settings.folder(), settings.folder() / "settings.json"
    wanted = json.loads(json.dumps({name: asdict(course) for name, course in courses(settings).items()}))
    wanted["shared"]["version of cad_env"] = version()
    if path.exists():
        try:
            found = json.loads(path.read_text())
        except ValueError:
            raise ValueError(f"{path} is damaged: use another folder or delete that one") from None
        if found != wanted:
            raise ValueError(f"{folder} holds a run with {_difference(found, wanted)}: use another --out or delete it")
        return
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(path, (json.dumps(wanted, indent=2) + "\n").encode())


def _difference(found: Any, wanted: Mapping[str, Any]) -> str:
    before = found.get("shared", {}) if isinstance(found, dict) else {}
    for name, value in wanted["shared"].items():
        if before.get(name) != value:
            return f"{name}={before.get(name)!r}, now {value!r}"
    return "other settings"


def train_all(settings: TrainSettings) -> None:
    """Train both networks side by side, with one progress bar over all their work."""
    from tqdm import tqdm

    from baselines.workers import workers

    plan = courses(settings)
    total = sum(course.work() for course in plan.values())
    with workers(min(settings.jobs, len(plan))) as (pool, told):
        running = [pool.submit(_train_one, course, settings.folder() / name) for name, course in plan.items()]
        with tqdm(total=total, desc="training", bar_format=BAR, disable=None) as bar:
            while not all(future.done() for future in running):
                bar.update(_heard(told))
                _raise_if_failed(running)
            bar.update(_heard(told))
        _raise_if_failed(running)


BAR = "{desc} {percentage:3.0f}%|{bar}| {elapsed}<{remaining}{postfix}"


def _heard(told: Any) -> float:
    try:
        work = float(told.get(timeout=0.5))
        while not told.empty():
            work += float(told.get())
        return work
    except queue.Empty:
        return 0.0


def _raise_if_failed(running: Sequence[Future[None]]) -> None:
    for future in running:
        if future.done():
            future.result()


def _train_one(course: Any, folder: Path) -> None:
    from baselines.workers import tell
    from policies.training import train

    advance: Callable[[float], object] = tell
    train(course, folder, advance)


if __name__ == "__main__":
    sys.exit(main())
