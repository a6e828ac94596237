"""What must hold of a scenario holds of those that ship, and one that closed eyes pass is found out."""

from dataclasses import dataclass, replace

import pytest
from scenes import forget

from cad_env.scenarios import SCENARIOS, SHIPPED, register
from cad_env.scenarios.left_turn import LEFT_TURN, LeftTurnRanges
from cad_env.scenarios.ranges import Range, count, span
from cad_env.scoring.check_scenario import check_scenario, lines_of


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scenario_holds(name: str) -> None:
    verdicts = check_scenario(name, episodes=20, first_seed=3_000_000)
    assert all(each.holds for each in verdicts), "\n" + lines_of(verdicts)
    assert len(verdicts) >= 14


@pytest.mark.slow
@pytest.mark.parametrize("traffic", ["none", "light", "dense"])
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scenario_holds_in_every_density(name: str, traffic: str) -> None:
    verdicts = check_scenario(name, episodes=200, first_seed=4_000_000, traffic=traffic)
    assert all(each.holds for each in verdicts), "\n" + lines_of(verdicts)


@dataclass(frozen=True)
class RareRanges(LeftTurnRanges):
    """A vehicle a minute: who goes at once is nearly never hit."""

    platoon: tuple[int, int] = count(1, 1, within=(1, 30))
    platoon_gap: Range = span(60.0, 60.0, within=(1.0, 60.0))


def test_a_scenario_that_closed_eyes_pass_is_found_out() -> None:
    rare = register(replace(LEFT_TURN, name="rare", gym_id="CADRare-v0", ranges=RareRanges))
    try:
        failed = [each.what for each in check_scenario(rare, episodes=40) if not each.holds]
    finally:
        forget(rare)
    assert "episodes with a hazard" in failed
    assert "blind-0 collides" in failed
    assert "rare" not in SCENARIOS


@pytest.mark.parametrize("wrong", [{"episodes": 0}, {"episodes": 1.5}, {"scenario": "left_trun"}])
def test_a_wrong_call_is_refused_in_one_line(wrong: dict) -> None:
    with pytest.raises(ValueError, match=r"episodes|left_trun") as refusal:
        check_scenario(**{"scenario": "left_turn", **wrong})
    assert "\n" not in str(refusal.value)
