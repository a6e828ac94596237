"""What named rewards pay: the arithmetic, and the command."""

import pytest

from baselines.evaluation import reward_table
from baselines.evaluation.reward_table import mean_returns, returns
from baselines.evaluation.settings import Settings
from cad_env.envs.rewards import REWARDS, StepOutcome, progress
from cad_env.envs.single import CADEnv


def step(share: float, outcome: str | None = None) -> StepOutcome:
    """A step on which so much of the way was covered."""
    return StepOutcome(0, 1.0, share, 5.0, 1.0, outcome, True, 9.0, 0)


def test_a_discount_counts_decisions_that_hold() -> None:
    steps = [step(0.25), step(0.25), step(0.25), step(0.25, "success")]
    assert returns(steps, progress, 0.5, hold=1) == (2.0, 0.25 + 0.125 + 0.0625 + 1.25 / 8)
    assert returns(steps, progress, 0.5, hold=2) == (2.0, 0.25 + 0.25 + 0.125 + 1.25 / 2)
    assert returns(steps, progress, 1.0, hold=3) == (2.0, 2.0)


@pytest.mark.parametrize("reward", REWARDS)
def test_it_is_what_the_environment_pays(reward: str) -> None:
    settings = Settings(("left_turn",), ("always-go",), episodes=2, first_seed=0)
    total = 0.0
    env = CADEnv(reward=reward, radio="none")
    for seed in range(2):
        _, info = env.reset(seed=seed)
        while info["outcome"] is None:
            _, paid, _, _, info = env.step(0)
            total += paid
    assert mean_returns(settings, "left_turn", "always-go", 0.9, 1)[reward][0] == pytest.approx(total / 2)


def test_the_command_prints_a_line_for_each_method(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--scenario", "left_turn", "--method", "always-go", "expert", "--episodes", "1"]
    assert reward_table.main(words) == 0
    head, _, *lines = capsys.readouterr().out.splitlines()
    assert head.split() == [
        "scenario", "method", "progress", "at", "0.99", "safety-first", "at", "0.99", "time-and-safety", "at", "0.99",
    ]  # fmt: skip
    assert [line.split()[:2] for line in lines] == [["left_turn", "always-go"], ["left_turn", "expert"]]
    assert reward_table.main(["--discount", "2"]) == 2
    assert "discount must be a number from 0 to 1, got 2" in capsys.readouterr().err
