"""What each named reward pays those who are no learners: whether it puts them in the order that one wants.

python -m baselines.evaluation.reward_table                              all scenarios that ship
python -m baselines.evaluation.reward_table --method always-go expert --scenario left_turn --hold 1

An episode is driven once per method, and every reward is computed from the same steps. Seeds are training seeds.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from baselines.cli import parsed, refused, say, stopped
from baselines.controls.names import BEST_BLIND
from baselines.evaluation.job import job_of
from baselines.evaluation.settings import ALL_SCENARIOS, Settings
from cad_env.checks import check_numbers
from cad_env.envs.rewards import REWARDS, Reward, StepOutcome
from cad_env.envs.single import CADEnv
from cad_env.scoring.rollout import rollout
from cad_env.scoring.table import text_table
from cad_env.types import MAX_STEPS
from policies.training.config import LAST_SEED


@dataclass(frozen=True)
class Paying:
    """Print the mean return of each named reward, without and with a discount, for methods that do not learn."""

    scenario: tuple[str, ...] = ALL_SCENARIOS  # names of scenarios, or all that ship
    method: tuple[str, ...] = ("always-go", "always-brake", BEST_BLIND, "expert")
    episodes: int = 300  # of each scenario and method, from seed 0 on
    hold: int = 5  # steps of 0.1 s that a decision holds: the discount is of a decision
    discount: float = 0.99

    def __post_init__(self) -> None:
        check_numbers(self, "", {"episodes": (1, LAST_SEED), "hold": (1, MAX_STEPS), "discount": (0.0, 1.0)})

    def settings(self) -> Settings:
        """The run of evaluate.py that the methods would drive in."""
        return Settings(scenario=self.scenario, method=self.method, episodes=self.episodes, first_seed=0)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    try:
        paying = parsed(Paying, argv)
        heads = [head for name in REWARDS for head in (name, f"at {paying.discount:g}")]
        say(text_table(("scenario", "method", *heads), list(_rows(paying)), names=2))
    except (ValueError, OSError) as error:
        return refused(error)
    except KeyboardInterrupt as error:
        return stopped(error)
    return 0


def _rows(paying: Paying) -> Iterator[tuple[str, ...]]:
    settings = paying.settings()
    for scenario in settings.scenarios():
        for method in settings.method:
            found = mean_returns(settings, scenario, method, paying.discount, paying.hold)
            yield scenario, method, *(f"{value:.3f}" for pair in found.values() for value in pair)


def mean_returns(
    settings: Settings, scenario: str, method: str, discount: float, hold: int
) -> Mapping[str, tuple[float, float]]:
    """reward -> mean return over the episodes of a method, without and with the discount."""
    job = job_of(settings, scenario, method)
    steps: list[StepOutcome] = []

    def noted(step: StepOutcome) -> float:
        steps.append(step)
        return 0.0

    env = CADEnv(**job.options, reward=noted)
    found = dict.fromkeys(REWARDS, (0.0, 0.0))
    for seed in range(settings.first_seed, settings.first_seed + settings.episodes):
        steps.clear()
        rollout(env, job.policy, seed)
        for name, (plain, discounted) in found.items():
            paid, less = returns(steps, REWARDS[name], discount, hold)
            found[name] = plain + paid / settings.episodes, discounted + less / settings.episodes
    return found


def returns(steps: Sequence[StepOutcome], reward: Reward, discount: float, hold: int) -> tuple[float, float]:
    """What an episode pays, without a discount and with one for every `hold` steps that have passed."""
    paid = [reward(step) for step in steps]
    return sum(paid), sum(discount ** (k // hold) * each for k, each in enumerate(paid))


if __name__ == "__main__":
    sys.exit(main())
