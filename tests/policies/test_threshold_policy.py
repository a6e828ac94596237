"""The learned policy decides each scene by itself."""

import numpy as np
import pytest
import torch

from policies.stgraph.network import StGraphNet
from policies.stgraph.policy import StGraphPolicy
from tests.policies.stgraph.test_stgraph import VARIANTS, observations

torch.set_num_threads(1)


@pytest.mark.parametrize("name", ["paper", "every input", "no time"])
def test_the_driver_decides_the_same_alone_and_in_a_batch(name: str) -> None:
    batch = observations(graphs=40)
    net = StGraphNet(VARIANTS[name], seed=7)
    # The threshold splits the scenes, so both decisions occur.
    middle = float(np.median(StGraphPolicy(net).brake_probability(batch)))
    policy = StGraphPolicy(net, threshold=middle + 1e-9)
    together = policy.act_batch(batch)
    alone = [policy.act({key: value[i] for key, value in batch.items()}) for i in range(40)]
    assert together.tolist() == alone
    assert set(alone) == {0, 1}


def test_a_batch_larger_than_one_pass_is_decided_in_order() -> None:
    batch = observations(graphs=300, tracks=2, frames=3)
    policy = StGraphPolicy(StGraphNet())
    head = {key: value[:200] for key, value in batch.items()}
    np.testing.assert_allclose(policy.brake_probability(batch)[:200], policy.brake_probability(head), atol=1e-12)
    assert policy.act_batch({key: value[:0] for key, value in batch.items()}).shape == (0,)


def test_the_driver_brakes_from_the_threshold_up() -> None:
    batch = observations()
    assert StGraphPolicy(StGraphNet(), threshold=0.0).act_batch(batch).tolist() == [1] * 8
    assert StGraphPolicy(StGraphNet(), threshold=1.0).act_batch(batch).tolist() == [0] * 8
    with pytest.raises(ValueError, match="threshold"):
        StGraphPolicy(StGraphNet(), threshold=1.5)
    assert not StGraphPolicy(StGraphNet()).privileged
