"""The teacher brakes for what the expert knows and for what nobody vouches for."""

from pathlib import Path

import numpy as np
import pytest

from cad_env.checks import ConfigError
from cad_env.envs.vector import CADVectorEnv
from cad_env.files import FileError
from cad_env.rules.coverage_planner import CoveragePlanner
from cad_env.rules.expert import decisions, expert_of
from cad_env.types import BRAKE, GO
from policies.training.demonstrations import joined, record, replay
from policies.training.teacher import Teacher, waiting

ALONE = {"scenario": "street_crossing", "coverage": True, "penetration": 0.0}


def test_a_teacher_that_waits_brakes_where_the_expert_does_or_the_lanes_say_so() -> None:
    envs, which = CADVectorEnv(8, **ALONE), np.arange(8)
    envs.reset(seed=0)
    teacher, expert = Teacher(envs.batch, waits=True), expert_of("street_crossing")
    found = []
    for _ in range(60):
        label, waits = teacher.labels(which), waiting(envs.batch.observations)
        truth = decisions(expert, envs.batch.truths(which))
        np.testing.assert_array_equal(label == BRAKE, waits | (truth == BRAKE))
        rules = CoveragePlanner().act_batch({name: part.copy() for name, part in envs.batch.observations.items()})
        assert (rules[waits] == BRAKE).all()
        found.append((waits, truth))
        envs.step(label)
    waits, truth = (np.concatenate(each) for each in zip(*found, strict=True))
    assert (waits & (truth == GO)).any()
    assert (~waits).any()


def test_without_coverage_no_teacher_can_wait() -> None:
    with pytest.raises(ConfigError, match="coverage=True"):
        Teacher(CADVectorEnv(1).batch, waits=True)


def test_what_a_teacher_says_belongs_to_what_is_sent(tmp_path: Path) -> None:
    def recorded(waits: bool, **options: object) -> tuple[list, list]:
        envs = CADVectorEnv(3, **{**ALONE, **options})
        return replay(joined(record(tmp_path, envs, None, range(3), lambda n: None, waits=waits)), envs, _nothing)

    _, labels = recorded(True)
    assert recorded(True)[1] == labels
    for other in ({"radio": "none"}, {"penetration": 0.5}, {"depth": 3}):
        with pytest.raises(FileError, match="delete it to record anew"):
            recorded(True, **other)
    envs = CADVectorEnv(3, **ALONE)
    expert = joined(record(tmp_path / "expert", envs, None, range(3), lambda n: None))
    assert np.mean(labels) > np.mean(expert.label)


def _nothing(simulation: object, observation: object) -> None:
    return None
