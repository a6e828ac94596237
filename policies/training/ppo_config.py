"""How a network learns by reward: the only place where these numbers and their defaults are declared."""

from dataclasses import dataclass, field

from cad_env.checks import ConfigError, check_numbers, check_text, did_you_mean, settle
from cad_env.config import radio_config
from cad_env.types import MAX_STEPS
from policies.stgraph.config import StGraphConfig
from policies.training.config import VALIDATION

SCENES_AT_ONCE, ROLLOUT = 48, 64  # scenes at once, and decisions in each of them between two updates


@dataclass(frozen=True)
class PpoConfig:
    """How the network learns; most numbers are customary ones."""

    radio: str = "dsrc"  # none: without sharing
    reward: str = "time-and-safety"  # one of cad_env.envs.rewards.REWARDS
    hold: int = 5  # steps of 0.1 s for which a decision holds while it learns
    go_bias: float = 1.5  # what the first network's logit of GO is above that of BRAKE: e^1.5 = 4.5 goes to a brake
    learning_rate: float = 1e-3
    final_rate: float = 0.1  # share of it in the last part; in between it falls evenly
    discount: float = 0.99  # of a decision
    advantage: float = 0.95  # lambda of generalised advantage estimation
    clip: float = 0.2
    entropy: float = 0.02
    epochs: int = 3
    batch: int = 128
    validation: int = 40  # episodes of each scenario after each part; 0: none, and the last part is kept
    clone: str | None = (
        None  # folder of a model of the same kind to begin with; its network takes the place of `network`
    )
    critic_parts: int = 2  # parts at first in which the critic learns what the first decisions are worth, not they
    network: StGraphConfig = field(default_factory=StGraphConfig)

    def __post_init__(self) -> None:
        from cad_env.envs.rewards import REWARDS  # here, because it brings numba, for which --help need not wait

        radio_config(self.radio)
        if self.reward not in REWARDS:
            near = did_you_mean(self.reward, REWARDS)
            raise ConfigError(f"reward must be one of {', '.join(REWARDS)}, got {self.reward!r}{near}")
        settle(self, "clone", None if self.clone is None else check_text("clone", self.clone))
        limits = {
            "hold": (1, MAX_STEPS), "go_bias": (-10.0, 10.0), "learning_rate": (1e-7, 1.0), "final_rate": (0.0, 1.0),
            "discount": (0.0, 1.0), "advantage": (0.0, 1.0), "clip": (0.0, 1.0), "entropy": (0.0, 1.0),
            "epochs": (1, 100), "batch": (2, SCENES_AT_ONCE * ROLLOUT), "validation": (0, VALIDATION[1]),
            "critic_parts": (0, 10**6),
        }  # fmt: skip
        check_numbers(self, "", limits)
