"""The settings of a scoring run: the command line of evaluate.py."""

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from baselines.controls.names import BEST_BLIND, EVERY_CONTROL, GRID, has_best_control
from baselines.evaluation.grid import MOST_EPISODES, NO_CONDITION, Task, grid, shard_of
from baselines.evaluation.ray_backend import check_ray
from baselines.methods import SHIPPED_METHODS, shipped_models
from baselines.references import is_reference, resolved
from cad_env.checks import (
    ConfigError,
    check_numbers,
    check_path,
    check_seed,
    check_several,
    check_switch,
    check_text,
    did_you_mean,
    plain,
    settle,
)
from cad_env.config import RadioConfig, SensorConfig, radio_config
from cad_env.scoring.time_lost import EXPERT
from cad_env.types import FRAMES, STEP

if TYPE_CHECKING:
    from cad_env.conditions import Condition

HAZARDS = {"all": None, "yes": True, "no": False}
ALL_SCENARIOS = ("all",)
BACKENDS = ("processes", "ray")
_LIMITS = {  # of the numbers that are no part of an environment, or are named otherwise there
    "episodes": (1, MOST_EPISODES), "jobs": (1, 256), "gif": (0, 1000), "threshold": (0.0, 1.0),
    "budget": (0.0, 1e12 * STEP / 8.0), "gnss_yaw_noise": (0.0, 180.0), "collaborators": (0, 20),
}  # fmt: skip
OF_CONDITIONS = ("traffic", "penetration", "collaborators", "loss", "burst", "delay")  # what every condition sets
HOW = ("jobs", "backend", "out", "shard", "report", "gif")  # settings that change nothing about an episode


def scenarios_chosen(chosen: tuple[str, ...]) -> tuple[str, ...]:
    """The names of the scenarios that a command is asked for, which may be ALL_SCENARIOS; ConfigError for others."""
    from cad_env.scenarios import SHIPPED, scenario_named  # here, because it brings numba: --help need not wait

    return SHIPPED if chosen == ALL_SCENARIOS else tuple(scenario_named(name).name for name in chosen)


@dataclass(frozen=True)
class Settings:
    """Score methods in closed loop, all on the same seeds of every scenario, and the expert beside them.

    Methods with closed eyes: always-go, always-brake; blind-D brakes for the first D seconds, stop-D stops 1 m before
    the conflict and waits D seconds, slow-V never drives over V m/s; best-blind is the best of these in each scenario,
    chosen on training seeds; `controls` is all that it is chosen from. Time lost: against the expert on the same seed.
    A condition is a named set of traffic, penetration, collaborators, loss, burst and delay, and every method is scored
    under each. Without one the options of these names count; by default a witness is always connected.
    Writes episodes.jsonl (one line an episode), scores.json (rates with 95 % Wilson intervals) and report.html (tables
    and plots), and prints the table. If it is stopped, run the same command again to resume.
    `--merge FOLDER FOLDER ... --out FOLDER`, without the options below, merges the finished shards of one run.
    """

    scenario: tuple[str, ...] = ALL_SCENARIOS  # names of scenarios, in the order of the table, or all
    method: tuple[str, ...] = SHIPPED_METHODS  # names (blind-0.5, slow-7, ...), or module:Policy of your own, in order
    models: tuple[Path, ...] = ()  # folder of trained models, or one for each training seed; default: the package's
    episodes: int = 500  # per scenario and method
    first_seed: int = 1_000_000  # training never uses seeds from a million on
    jobs: int = 1  # processes
    backend: str = "processes"  # or ray: on the cores of this machine, or on the cluster that RAY_ADDRESS names
    shard: str | None = None  # i/n: only the i-th of n parts of the run, into <out>/shard_i_of_n
    out: Path = Path("results")  # folder to write to
    report: bool = True  # write report.html
    gif: int = 0  # animations of each scenario, method and outcome, into <out>/gifs and the report
    condition: tuple[str, ...] = ()  # names of conditions, or all; module:CONDITION is one of your own
    traffic: str | None = None  # none, light or dense: how much is on the road around the story; default: light
    penetration: float | None = None  # probability that a vehicle is connected; default: two to four are
    radio: str = "dsrc"  # none, dsrc, cv2x or ideal, for the methods that share
    loss: float | None = None  # probability that the ego misses a message; default: the radio's own
    burst: float | None = None  # mean slots in a row that the ego misses of a sender; default: each by itself
    delay: float | None = None  # s until a message arrives, rounded up to 0.1 s; default: the radio's own
    budget: float | None = None  # bytes of one sender in 0.1 s; a message above is refused whole; default: the radio's
    sensor_noise: float = SensorConfig.noise  # m, standard deviation of each coordinate of a detection
    gnss_noise: float = SensorConfig.gnss_noise  # m, standard deviation of a vehicle's own position
    gnss_yaw_noise: float = 0.0  # degrees, standard deviation of a vehicle's own heading
    collaborators: int | None = None  # connected vehicles besides the ego; default: two to four
    hazard: str = "all"  # yes or no: only episodes with or without one; all: as the seed decides
    depth: int = FRAMES  # newest frames in a message
    threshold: float | None = None  # P(brake) from which a learned method brakes; default: its model's own

    def __post_init__(self) -> None:
        for field in fields(self):  # what numpy says is written to JSON too
            settle(self, field.name, plain(getattr(self, field.name)))
        settle(self, "method", with_every_control(check_several("method", self.method, check_text)))
        for what in ("scenario", "method"):
            settle(self, what, check_several(what, getattr(self, what), check_text))
            names = getattr(self, what)
            if not names or len(set(names)) < len(names):
                raise ValueError(f"{what} must name at least one, each once, got {' '.join(names)!r}")
        self._check_condition()
        settle(self, "models", check_several("models", self.models, check_path))
        settle(self, "out", check_path("out", self.out))
        settle(self, "report", check_switch("report", self.report))
        if len({folder.name for folder in self.models}) < len(self.models):
            raise ValueError(f"models folders must have different names, got {' '.join(map(str, self.models))}")
        settle(self, "first_seed", check_seed("first-seed", self.first_seed))
        check_numbers(self, "", _LIMITS)
        if self.backend not in BACKENDS:
            near = did_you_mean(self.backend, BACKENDS)
            raise ConfigError(f"backend must be one of {', '.join(BACKENDS)}, got {self.backend!r}{near}")
        if self.backend == "ray":
            check_ray()
        if self.shard is not None:
            shard_of(check_text("shard", self.shard))
            if self.gif:
                raise ValueError("gif is for a whole run: merge the shards first")
        if not isinstance(self.hazard, str) or self.hazard not in HAZARDS:
            near = did_you_mean(self.hazard, HAZARDS)
            raise ConfigError(f"hazard must be one of {', '.join(HAZARDS)}, got {self.hazard!r}{near}")
        from cad_env.simulation.setup import setup_from

        for condition in self.conditions():
            for scenario in self.scenarios():
                setup_from(self.environment(scenario, condition))

    def _check_condition(self) -> None:
        """Settle the names; refuse a setting that the conditions set too."""
        given = check_several("condition", self.condition, check_text)
        settle(self, "condition", with_every_condition(given))
        if len(set(self.condition)) < len(self.condition):
            raise ConfigError(f"condition must name each once, got {' '.join(given)!r}")
        for name in self.condition:
            condition = condition_called(name)
            for what in OF_CONDITIONS:
                if (mine := getattr(self, what)) is not None:
                    its = getattr(condition, what)
                    sets = f"sets {what} to {'its default' if its is None else its}"
                    raise ConfigError(
                        f"condition {name} {sets}, and --{what} {mine} is given too: leave out one of them"
                    )

    def conditions(self) -> tuple[str | None, ...]:
        """The names of the conditions, in the order of the table; one without a name if none is asked for."""
        return self.condition or NO_CONDITION

    def met(self, condition: str | None = None) -> "Condition":
        """The condition of a name; without one, what these settings say."""
        from cad_env.conditions import Condition  # here, because it takes a second that --help need not wait

        if condition is not None:
            return condition_called(condition)
        said = {name: value for name in OF_CONDITIONS if (value := getattr(self, name)) is not None}
        return Condition("unnamed", "what the settings say", **said)

    def scenarios(self) -> tuple[str, ...]:
        """The names of the scenarios, in the order of the table."""
        return scenarios_chosen(self.scenario)

    def environment(self, scenario: str, condition: str | None = None) -> dict[str, Any]:
        """The options of the environment, for a method that shares all it can."""
        sensor = SensorConfig(
            noise=self.sensor_noise, gnss_noise=self.gnss_noise, gnss_yaw_noise=math.radians(self.gnss_yaw_noise)
        )
        return {"scenario": scenario, "depth": self.depth, **self.met(condition).options(self._radio(), sensor)}

    def radio_config(self) -> RadioConfig:
        """The preset with what these settings override."""
        return self.met().radio(self._radio())

    def _radio(self) -> RadioConfig:
        """The preset with its budget."""
        preset = radio_config(self.radio)
        return preset if self.budget is None else replace(preset, rate=8.0 * self.budget / STEP)

    def seeds(self) -> range:
        """The same for every scenario and method."""
        return range(self.first_seed, self.first_seed + self.episodes)

    def tasks(self) -> list[Task]:
        """Every episode of this run, or of this shard of it."""
        return grid(self.scenarios(), self.method, self.seeds(), self.shard, self.conditions())

    def models_folder(self) -> Path:
        """The folder of trained models; of the first training seed, where there are several."""
        return self.models[0] if self.models else shipped_models()

    def folder(self) -> Path:
        """Where the results go."""
        return self.out if self.shard is None else self.out / "shard_{}_of_{}".format(*shard_of(self.shard))

    def command(self) -> str:
        """A command that gives these results, in one process and without shards."""
        words = ["python", "evaluate.py"]
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name not in HOW and value != field.default:
                values = value if isinstance(value, tuple) else (value,)
                words += ["--" + field.name.replace("_", "-"), *map(str, values)]
        return shlex.join(words)


def with_every_control(methods: Sequence[str]) -> tuple[str, ...]:
    """The methods with all controls of the grid in the place of the word for them."""
    return tuple(each for name in methods for each in (GRID if name == EVERY_CONTROL else (name,)))


def with_every_condition(names: Sequence[str]) -> tuple[str, ...]:
    """The conditions with all that ship in the place of the word for them."""
    if not names:
        return ()
    from cad_env.conditions import CONDITIONS, EVERY_CONDITION

    return tuple(each for name in names for each in (CONDITIONS if name == EVERY_CONDITION else (name,)))


def condition_called(name: str) -> "Condition":
    """The condition of a name, or one from outside; ConfigError or ValueError, one line, if there is none."""
    from cad_env.conditions import Condition, condition_named

    if not is_reference(name):
        return condition_named(name)
    found = resolved(name)
    if not isinstance(found, Condition):
        raise ConfigError(f"{name} must be a Condition of cad_env.conditions, got {found!r}")
    return found


def comparable(settings: Settings) -> Settings:
    """The same run with the expert, whom time lost is against, and of the usual methods those that can drive in it."""
    methods = settings.method
    if methods == SHIPPED_METHODS:
        methods = usual(methods, settings.scenarios())
    return replace(settings, method=methods if EXPERT in methods else (*methods, EXPERT))


def usual(methods: Sequence[str], scenarios: Sequence[str]) -> tuple[str, ...]:
    """The methods without best-blind where it was not chosen, as for a scenario from outside."""
    return tuple(name for name in methods if name != BEST_BLIND or has_best_control(scenarios))
