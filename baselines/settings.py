"""What a scoring run is asked for; also the command line of evaluate.py."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from baselines.contenders import CONTENDERS, contender_named, shipped_models
from cad_env.config import RADIO_PRESETS, RadioConfig, SensorConfig, check_range, radio_config
from cad_env.types import FRAMES

HAZARDS = {"all": None, "yes": True, "no": False}


@dataclass(frozen=True)
class Settings:
    """Score contenders in closed loop, all on the same seeds.

    Writes episodes.jsonl (one line an episode) and scores.json (rates with 95 % Wilson intervals), and prints the
    table. Interrupt it as you like: the same command goes on where it stopped.
    """

    scenario: str = "left_turn"
    contender: tuple[str, ...] = tuple(CONTENDERS)  # who drives, in the order of the table
    policy: Path | None = None  # folder of the trained models `shared` and `own`; default: those of the package
    episodes: int = 500  # per contender
    first_seed: int = 1_000_000  # training never uses seeds from a million on
    jobs: int = 1  # processes
    out: Path | None = None  # folder to write to; default: results/<scenario>
    radio: str = "dsrc"  # none, dsrc, cv2x or ideal, for the contenders that share
    loss: float | None = None  # probability that the ego misses a message; default: the radio's own
    delay: float | None = None  # s until a message arrives, rounded up to 0.1 s; default: the radio's own
    sensor_noise: float = SensorConfig.noise  # m, standard deviation of each coordinate of a detection
    gnss_noise: float = SensorConfig.gnss_noise  # m, standard deviation of a vehicle's own position
    hazard: str = "all"  # yes or no: only episodes with or without one; all: as the seed decides
    depth: int = FRAMES  # newest frames in a message

    def __post_init__(self) -> None:
        for name in self.contender:
            contender_named(name)
        if not self.contender or len(set(self.contender)) < len(self.contender):
            raise ValueError(f"contender must name at least one, each once, got {' '.join(self.contender)!r}")
        check_range("episodes", self.episodes, 1, 10_000_000)
        check_range("first-seed", self.first_seed, 0, 2**40)
        check_range("jobs", self.jobs, 1, 256)
        if self.hazard not in HAZARDS:
            raise ValueError(f"hazard must be one of {', '.join(HAZARDS)}, got {self.hazard!r}")
        from cad_env.simulation import setup_from  # here, because highway-env takes a second that --help need not wait

        setup_from(self.environment(shares=True))

    def environment(self, shares: bool) -> dict[str, Any]:
        """The options of the environment for a contender that shares, or does not."""
        return {
            "scenario": self.scenario,
            "radio": self.radio_config() if shares else RADIO_PRESETS["none"],
            "sensor": SensorConfig(noise=self.sensor_noise, gnss_noise=self.gnss_noise),
            "depth": self.depth,
        }

    def radio_config(self) -> RadioConfig:
        """The preset with what was overridden."""
        chosen = {"loss": self.loss, "delay": self.delay}
        return replace(radio_config(self.radio), **{name: value for name, value in chosen.items() if value is not None})

    def seeds(self) -> range:
        """The same for every contender."""
        return range(self.first_seed, self.first_seed + self.episodes)

    def models(self) -> Path:
        """The folder of trained models."""
        return shipped_models(self.scenario) if self.policy is None else self.policy

    def folder(self) -> Path:
        """Where the results go."""
        return Path("results") / self.scenario if self.out is None else self.out
