"""Training under several conditions: an even split, seeds of their own, and the worst one decides."""

import csv
from pathlib import Path

import numpy as np
import pytest

from cad_env.checks import ConfigError
from policies.model_folder import load_model
from policies.stgraph.network import StGraphConfig
from policies.training.cloning import Worth
from policies.training.config import TrainingCell, TrainingConfig
from policies.training.dagger import train_network
from policies.training.validation_log import Log

MIXED = TrainingConfig(
    scenarios=("left_turn",), conditions=("nominal", "alone"), teacher="coverage", episodes=7, dagger_rounds=1,
    dagger_episodes=2, steps=4, segments=2, validation=3, final_validation=2, thresholds=(0.5,), batch=16,
    network=StGraphConfig(coverage=True),
)  # fmt: skip


def test_episodes_are_split_evenly_and_no_seed_is_used_twice() -> None:
    conditions = ("nominal", "alone", "loss-70")
    config = TrainingConfig(scenarios=("left_turn", "overtaking"), conditions=conditions)
    assert len(config.cells()) == 6
    parts = [config.seeds_of(TrainingCell("overtaking", name), 50, 11) for name in conditions]
    assert [seed for part in parts for seed in part] == list(range(50, 61))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_one_condition_has_all_seeds_and_learns_from_what_all_share() -> None:
    config = TrainingConfig()
    assert config.seeds_of(config.cells()[0], 3, 9) == range(3, 12)
    assert config.learns_from_shared
    assert [str(cell) for cell in config.cells()] == list(config.scenarios)
    assert not TrainingConfig(teacher="coverage").learns_from_shared
    assert not TrainingConfig(conditions=("alone",)).learns_from_shared


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"conditions": ("fog",)}, "unknown condition 'fog'"),
        ({"conditions": ()}, "conditions must name at least one"),
        ({"conditions": ("alone", "alone")}, "each once"),
        ({"conditions": ("alone", "nominal"), "dagger_episodes": 1}, "dagger_episodes must be at least 2"),
        ({"teacher": "covrage"}, "did you mean coverage"),
    ],
)
def test_nonsense_is_refused(wrong: dict, reason: str) -> None:
    with (
        pytest.raises(ConfigError, match=reason)
        if "did" in reason or "unknown" in reason
        else pytest.raises(ValueError, match=reason)
    ):
        TrainingConfig(**wrong)


def test_the_worst_condition_counts_before_the_mean(tmp_path: Path) -> None:
    assert Worth(9, 0, 30.0, worst=0) < Worth(1, 0, 10.0, worst=1)
    log = Log(tmp_path / "metrics.csv")
    collisions = {0: (0, 3), 1: (2, 2), 2: (2, 1)}  # of a segment, in each condition
    for segment, found in collisions.items():
        for condition, count in zip(("nominal", "alone"), found, strict=True):
            row = {**dict.fromkeys(Log.COLUMNS, 0), "segment": segment, "scenario": "left_turn", "threshold": 0.5}
            log.add({**row, "condition": condition, "collisions": count, "failures": count})
    assert [segment for _, segment, _ in log.ranked()] == [2, 1, 0]


def test_with_one_condition_failures_count_as_before(tmp_path: Path) -> None:
    log = Log(tmp_path / "metrics.csv")
    for segment, found in {0: (0, 5), 1: (3, 3)}.items():
        for scenario, count in zip(("left_turn", "overtaking"), found, strict=True):
            row = {**dict.fromkeys(Log.COLUMNS, 0), "segment": segment, "scenario": scenario, "threshold": 0.5}
            log.add({**row, "condition": "nominal", "collisions": count, "failures": count})
    assert [segment for _, segment, _ in log.ranked()] == [0, 1]


def test_a_network_learns_under_all_conditions_from_a_teacher_that_waits(tmp_path: Path) -> None:
    told: list[float] = []
    train_network(MIXED, tmp_path / "model", told.append, tmp_path / "demonstrations")
    assert sum(told) == pytest.approx(MIXED.work())
    with (tmp_path / "model/metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["condition"], row["episodes"]) for row in rows] == [("nominal", "1"), ("alone", "2")] * 4
    folders = {path.name for path in (tmp_path / "demonstrations/left_turn").iterdir()}
    assert folders == {"coverage_0-2", "coverage_3-6_alone"}
    model = load_model(tmp_path / "model")
    assert model.environment() == {"coverage": True}
    again = [value.numpy() for value in model.network.state_dict().values()]
    train_network(MIXED, tmp_path / "again", lambda work: None, tmp_path / "demonstrations")
    for one, other in zip(again, load_model(tmp_path / "again").network.state_dict().values(), strict=True):
        np.testing.assert_array_equal(one, other.numpy())
