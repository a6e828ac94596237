"""How one network is trained: the only place where these numbers and their defaults are declared."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from cad_env.checks import ConfigError, check_numbers, check_range, check_seed, check_several, did_you_mean, settle
from cad_env.conditions import condition_named
from cad_env.config import radio_config
from cad_env.types import FRAMES

# Seeds of training stay below a million; those of scoring begin there. Every scenario uses the same ones.
EXPERT_SEEDS, DAGGER_SEEDS, VALIDATION_SEEDS, FINAL_SEEDS = 0, 300_000, 900_000, 950_000
LAST_SEED = 999_999
FINALISTS = 2  # checkpoints that are validated once more

# What one unit of each kind of work costs, relative to an optimiser step: for an honest progress bar.
REPLAYED_COST, DRIVEN_COST = 0.9, 1.6

NOMINAL = "nominal"
TEACHERS = ("expert", "coverage")  # who labels; coverage: also waits for whom nobody vouches for

STEPS, VALIDATION = (3, 10**7), (1, FINAL_SEEDS - VALIDATION_SEEDS)  # least and most
_LIMITS = {
    "depth": (1, FRAMES), "episodes": (1, DAGGER_SEEDS), "dagger_rounds": (0, 49), "dagger_episodes": (1, 10_000),
    "mixing": (0.0, 1.0), "steps": STEPS, "segments": (1, 100), "validation": VALIDATION,
    "final_validation": (1, LAST_SEED - FINAL_SEEDS), "batch": (1, 100_000), "learning_rate": (1e-8, 1.0),
    "brake_share": (0.0, 1.0),
}  # fmt: skip

Advance = Callable[[float], object]  # told of work that was done


def _check_threshold(name: str, value: Any) -> float:
    return check_range(name, value, 0.0, 1.0)


def small_seed(seed: int) -> int:
    """A seed as torch and Stable-Baselines3 take it, below 2**32: itself where it is, else drawn from it."""
    return seed if seed < 2**32 else int(np.random.SeedSequence(seed).generate_state(1)[0])


def _shipped() -> tuple[str, ...]:
    from cad_env.scenarios import SHIPPED  # here, because it brings numba, for which --help need not wait

    return SHIPPED


class TrainingCell(NamedTuple):
    """What an episode is driven in."""

    scenario: str
    condition: str

    def __str__(self) -> str:
        return self.scenario if self.condition == NOMINAL else f"{self.scenario} {self.condition}"


@dataclass(frozen=True)
class TrainingConfig:
    """How one network is trained. Episodes are counted per scenario, and split evenly among the conditions."""

    scenarios: tuple[str, ...] = field(default_factory=_shipped)  # that one network learns
    radio: str = "dsrc"  # none: trained, as it will be run, without sharing
    conditions: tuple[str, ...] = (NOMINAL,)  # names of cad_env.conditions that it learns under and is validated by
    teacher: str = TEACHERS[0]  # one of TEACHERS
    depth: int = FRAMES  # newest frames in a message
    seed: int = 0
    episodes: int = 960  # driven by the expert
    dagger_rounds: int = 2  # the network drives, the expert labels
    dagger_episodes: int = 256  # in each DAgger round
    mixing: float = 0.0  # share of the decisions that the expert takes in the first DAgger round; of the n-th: to the n
    steps: int = 3000  # optimiser steps of the first round; half as many in each later one
    segments: int = 3  # parts of a round; a checkpoint and a validation after each
    validation: int = 40  # episodes after each segment
    final_validation: int = 100  # episodes for each of the best checkpoints and thresholds
    thresholds: tuple[float, ...] = (0.65, 0.5, 0.35)
    batch: int = 96  # frames
    learning_rate: float = 5e-3  # of Adam, at the start; falls to a fiftieth of it by a cosine over all rounds
    brake_share: float = 0.3  # of every batch; in the recorded frames it is about a tenth
    spec: str = "stgraph"  # by its name in policies.registry
    network: Any = None  # of the spec's config type; None: its defaults

    def __post_init__(self) -> None:
        from cad_env.scenarios import scenario_named

        settle(self, "scenarios", check_several("scenarios", self.scenarios, lambda _, each: scenario_named(each).name))
        if not self.scenarios or len(set(self.scenarios)) < len(self.scenarios):
            raise ValueError(f"scenarios must name at least one, each once, got {' '.join(self.scenarios)!r}")
        radio_config(self.radio)
        settle(self, "seed", check_seed("seed", self.seed))
        check_numbers(self, "", _LIMITS)
        settle(self, "thresholds", check_several("thresholds", self.thresholds, _check_threshold))
        if not self.thresholds or len(set(self.thresholds)) < len(self.thresholds):
            raise ValueError(f"thresholds must be at least one, each once, got {self.thresholds}")
        self._check_conditions()
        self.frames_of_each(len(self.cells()))
        self._settle_network()

    def _settle_network(self) -> None:
        from policies.registry import spec_named  # here, because it may bring torch
        from policies.spec import fitting

        network = spec_named(self.spec).config_type() if self.network is None else self.network
        settle(self, "network", fitting(network, self.scenarios))

    def _check_conditions(self) -> None:
        settle(
            self, "conditions", check_several("conditions", self.conditions, lambda _, each: condition_named(each).name)
        )
        if not self.conditions or len(set(self.conditions)) < len(self.conditions):
            raise ValueError(f"conditions must name at least one, each once, got {' '.join(self.conditions)!r}")
        for name in ("episodes", "dagger_episodes", "validation", "final_validation"):
            if getattr(self, name) < len(self.conditions):
                least = f"at least {len(self.conditions)}, one for each of the conditions"
                raise ValueError(f"{name} must be {least}, got {getattr(self, name)}")
        if self.teacher not in TEACHERS:
            near = did_you_mean(self.teacher, TEACHERS)
            raise ConfigError(f"teacher must be one of {', '.join(TEACHERS)}, got {self.teacher!r}{near}")

    @property
    def waits(self) -> bool:
        """Whether labels also say to wait for whom nobody vouches for."""
        return self.teacher == "coverage"

    @property
    def learns_from_shared(self) -> bool:
        """Whether its first demonstrations are those of the expert, which networks of all kinds share."""
        return self.conditions == (NOMINAL,) and not self.waits

    def cells(self) -> list[TrainingCell]:
        """Every scenario under every condition."""
        return [TrainingCell(scenario, condition) for scenario in self.scenarios for condition in self.conditions]

    def seeds_of(self, cell: TrainingCell, first: int, episodes: int) -> range:
        """The part of a cell in the seeds of a scenario's episodes, which begin with `first`."""
        place, count = self.conditions.index(cell.condition), len(self.conditions)
        return range(first + place * episodes // count, first + (place + 1) * episodes // count)

    def frames_of_each(self, cells: int) -> tuple[int, int]:
        """Frames of every cell in a batch: braking, going. ValueError if there are none of either."""
        size = max(round(self.batch / cells), 1)
        brake = round(size * self.brake_share)
        if not 0 < brake < size:
            under = " under every condition" if len(self.conditions) > 1 else ""
            raise ValueError(
                f"batch={self.batch} with brake_share={self.brake_share} must hold frames of both kinds of every "
                f"scenario{under}, of which there are {cells}: {brake} of {size} would brake"
            )
        return brake, size - brake

    def steps_of(self, turn: int) -> int:
        """Optimiser steps of a round, a multiple of its segments."""
        whole = self.steps if turn == 0 else self.steps // 2
        return max(whole // self.segments, 1) * self.segments

    def work(self) -> float:
        """All that `train` will tell its `advance`."""
        rounds = range(self.dagger_rounds + 1)
        driven = self.dagger_rounds * self.dagger_episodes + self.segments * len(rounds) * self.validation
        driven += FINALISTS * len(self.thresholds) * self.final_validation
        replayed = self.episodes + self.dagger_rounds * self.dagger_episodes
        replayed += 0 if self.learns_from_shared else self.episodes  # which are recorded first
        per_scenario = REPLAYED_COST * replayed + DRIVEN_COST * driven
        return len(self.scenarios) * per_scenario + sum(self.steps_of(turn) for turn in rounds)
