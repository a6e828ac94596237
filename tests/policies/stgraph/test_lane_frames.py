"""What a network with coverage asks for, and what is kept of the lanes that it sees."""

import numpy as np
import pytest
import torch

from cad_env.envs.vector import CADVectorEnv
from policies.stgraph.lanes import seconds_past
from policies.stgraph.network import StGraphConfig, StGraphNet
from policies.stgraph.spec import SPEC


def test_only_a_network_with_coverage_asks_for_it() -> None:
    assert SPEC.environment(StGraphNet(StGraphConfig(coverage=True))) == {"coverage": True}
    assert SPEC.replayed(StGraphNet(StGraphConfig(coverage=True))) == {"coverage": True}
    assert SPEC.environment(StGraphNet()) == {} == SPEC.looked_with(StGraphConfig())


def test_frames_keep_the_lanes_as_they_were_observed() -> None:
    envs = CADVectorEnv(2, scenario="left_turn", coverage=True)
    seen = [envs.reset(seed=3)[0], *(envs.step(np.zeros(2, int))[0] for _ in range(5))]
    looks = [SPEC.look(envs.batch.simulations[0], {key: part[1] for key, part in each.items()}) for each in seen]
    frames = SPEC.frames(looks, [0] * 6)
    batch = frames.joined([frames]).batch(np.array([2, 9]))
    for name in ("lanes", "lane_mask"):
        np.testing.assert_array_equal(batch[name], [seen[2][name][1], seen[3][name][1]])
    assert batch["lane_mask"].any()


def test_frames_without_coverage_hold_no_lanes() -> None:
    envs = CADVectorEnv(1, scenario="left_turn")
    observation = {key: part[0] for key, part in envs.reset(seed=3)[0].items()}
    frames = SPEC.frames([SPEC.look(envs.batch.simulations[0], observation)], [0])
    assert "lanes" not in frames.batch(np.array([0]))


@pytest.mark.parametrize(("speed", "target", "distance"), [(0.0, 10.0, 9.0), (5.0, 10.0, 60.0), (8.0, 8.0, 20.0)])
def test_the_time_for_a_distance_is_that_of_small_steps(speed: float, target: float, distance: float) -> None:
    arc, now, time = 0.0, speed, 0.0
    while arc < distance:
        arc, now, time = arc + 1e-4 * now, min(now + 2e-4, target), time + 1e-4
    found = seconds_past(*(torch.tensor(each, dtype=torch.float64) for each in (distance, speed, target)))
    assert float(found) == pytest.approx(time, abs=1e-2)
