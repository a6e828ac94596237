"""The fused network says what the dense one says: logits, gradients, decisions."""

import dataclasses
from pathlib import Path

import numba
import numpy as np
import pytest
import torch
from torch.nn.functional import cross_entropy

import cad_env
import policies
from baselines.methods import MOTION, shipped_models
from cad_env.envs.vector import CADVectorEnv
from cad_env.numerics.jit import cache_folder
from cad_env.scenarios import SCENARIOS
from policies.model_folder import load_model
from policies.spec import Frames
from policies.stgraph.compiled.attention import exponentials
from policies.stgraph.compiled.module import FusedNet, fused_logits, supports
from policies.stgraph.network import StGraphConfig, StGraphNet
from policies.stgraph.policy import StGraphPolicy
from policies.stgraph.spec import SPEC
from policies.training.cloning import fit
from policies.training.config import TrainingConfig
from policies.training.demonstrations import joined, record, replay
from tests.policies.stgraph.test_stgraph import PAPER, VARIANTS, lanes, network, observations, tensors

torch.set_num_threads(1)
pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="plain Python takes the dense way")

FUSED = {
    "paper": PAPER,
    "relu attention": VARIANTS["relu attention"],
    "no edge attributes": VARIANTS["no edge attributes"],
    "velocity": StGraphConfig(velocity=True),
    "ego way": StGraphConfig(ego_way=True),
    "every third frame": VARIANTS["every third frame"],
    "coverage": VARIANTS["coverage"],
    "motion and coverage": StGraphConfig(**MOTION, coverage=True),
    "other widths": StGraphConfig(head_width=2, hidden=5, mlp_width=9, position_scale=0.1, attn_slope=1.0),
}
DENSE = {name: config for name, config in VARIANTS.items() if name not in FUSED} | {
    "odd heads": StGraphConfig(head_width=5),
    "three layers": StGraphConfig(layers=3),
    "two heads": StGraphConfig(heads=2),
    "fused after every layer": StGraphConfig(fusion="per_layer"),
    "node time": StGraphConfig(node_time=True),
    "ego speed": StGraphConfig(ego_speed=True),
    "class input": StGraphConfig(class_input=True),
}
Arrays = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Frames:
    folder = tmp_path_factory.mktemp("demonstrations")
    envs = CADVectorEnv(8, scenario="left_turn")
    return SPEC.frames(*replay(joined(record(folder, envs, None, range(8), lambda _: None)), envs, SPEC.look))


def differences(net: StGraphNet, batch: Arrays) -> tuple[float, float]:
    """The largest difference of logits, and of the gradients of a loss, between fused and dense."""
    truth = torch.arange(len(batch["mask"])) % 2
    answers, slopes = [], []
    for way in (fused_logits, StGraphNet.forward):
        net.zero_grad()
        answers.append(way(net, tensors(batch)))
        cross_entropy(answers[-1], truth).backward()
        slopes.append([parameter.grad.clone() for parameter in net.parameters()])
    apart = [float((one - other).abs().max()) for one, other in zip(*slopes, strict=True)]
    return float((answers[0] - answers[1]).detach().abs().max()), max(apart)


def dense_logits(net: StGraphNet, batch: Arrays) -> np.ndarray:
    with torch.no_grad():
        return net(tensors(batch)).numpy()


@pytest.mark.parametrize("name", FUSED)
def test_ragged_scenes_give_the_logits_and_gradients_of_the_dense_network(name: str) -> None:
    for seed, graphs, tracks, frames in ((0, 8, 5, 6), (1, 3, 16, 15), (2, 33, 3, 4), (3, 2, 1, 1)):
        logits, gradients = differences(network(FUSED[name], seed), observations(seed, graphs, tracks, frames))
        assert logits < 1e-11
        assert gradients < 1e-9


def test_every_weight_has_a_gradient() -> None:
    net = network()
    fused_logits(net, tensors(observations()))[:, 1].sum().backward()
    assert all(parameter.grad.abs().max() > 1e-6 for parameter in net.parameters())


@pytest.mark.parametrize("name", FUSED)
def test_empty_scenes_give_what_the_dense_network_gives(name: str) -> None:
    batch = observations()
    batch["mask"][:] = 0
    assert max(differences(network(FUSED[name]), batch)) < 1e-12


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_recorded_scenes_give_the_logits_and_gradients_of_the_dense_network(
    recorded: Frames, dtype: torch.dtype
) -> None:
    batch = recorded.batch(np.arange(0, len(recorded), 20))
    logits, gradients = differences(StGraphNet(seed=3).to(dtype), batch)
    assert logits < (1e-5 if dtype == torch.float32 else 1e-12)
    assert gradients < (1e-5 if dtype == torch.float32 else 1e-9)


def test_the_gradient_is_that_of_finite_differences() -> None:
    net, batch = network(seed=4), tensors(observations(graphs=3, tracks=3, frames=4))
    fused_logits(net, batch)[:, 1].sum().backward()
    rng = np.random.default_rng(0)
    for parameter in net.parameters():
        at = tuple(rng.integers(size) for size in parameter.shape)
        ahead, behind = (_nudged(net, parameter, at, step, batch) for step in (1e-6, -1e-6))
        assert float(parameter.grad[at]) == pytest.approx((ahead - behind) / 2e-6, abs=1e-7)


def _nudged(net: StGraphNet, parameter: torch.Tensor, at: tuple, step: float, batch: dict) -> float:
    with torch.no_grad():
        parameter[at] += step
        total = float(fused_logits(net, batch)[:, 1].sum())
        parameter[at] -= step
    return total


def scenes(rng: np.random.Generator, count: int) -> Arrays:
    """Random scenes of every density and size."""
    batch = observations(int(rng.integers(2**31)), count, tracks=16, frames=15)
    batch["mask"] *= rng.random((count, 16, 1)) < rng.random((count, 1, 1))
    batch |= lanes(rng, count)
    order = rng.permutation(count)
    batch |= {name: batch[name][order] for name in ("lanes", "lane_mask")}
    batch["tracks"] *= rng.choice([0.1, 1.0, 3.0], (count, 1, 1, 1)).astype(np.float32)
    return batch


def same_decisions(count: int) -> None:
    rng = np.random.default_rng(7)
    for seed in range(4):
        net, batch = network(seed=seed), scenes(rng, count // 4)
        dense = dense_logits(net, batch) @ (-1, 1)
        # The threshold splits the scenes in two halves, so both decisions occur.
        threshold = 1 / (1 + np.exp(-np.median(dense) + 1e-9))
        decided = StGraphPolicy(net, threshold).act_batch(batch)
        np.testing.assert_array_equal(decided, 1 / (1 + np.exp(-dense)) >= threshold)
        assert 0.4 < decided.mean() < 0.6


def test_2000_random_observations_are_decided_as_by_the_dense_network() -> None:
    same_decisions(2000)


@pytest.mark.slow
def test_10000_random_observations_are_decided_as_by_the_dense_network() -> None:
    same_decisions(10_000)


@pytest.mark.slow
def test_10000_recorded_observations_are_decided_by_the_shipped_network_as_by_its_dense_self(tmp_path: Path) -> None:
    model = load_model(shipped_models() / "stgraph")
    seen = 0
    for scenario in SCENARIOS:
        envs = CADVectorEnv(32, scenario=scenario)
        demonstrations = joined(record(tmp_path / scenario, envs, None, range(40), lambda _: None))
        frames = SPEC.frames(*replay(demonstrations, envs, SPEC.look))
        batch = frames.batch(np.arange(len(frames)))
        dense = dense_logits(model.network.double(), batch) @ (-1, 1)
        decided = StGraphPolicy(model.network, model.threshold).act_batch(batch)
        np.testing.assert_array_equal(decided, 1 / (1 + np.exp(-dense)) >= model.threshold)
        seen += len(frames)
    assert seen >= 10_000


@pytest.mark.parametrize("name", FUSED)
def test_a_scene_alone_gives_the_same_bits_as_in_any_batch(name: str) -> None:
    policy, batch = StGraphPolicy(network(FUSED[name])), scenes(np.random.default_rng(1), 50)
    together = policy.brake_probability(batch)
    assert len(np.unique(together)) > 40
    for size in (1, 3, 7, 17):
        parts = [
            policy.brake_probability({k: v[at : at + size] for k, v in batch.items()}) for at in range(0, 50, size)
        ]
        np.testing.assert_array_equal(np.concatenate(parts), together)


@pytest.mark.parametrize("name", FUSED)
def test_what_is_masked_is_not_read(name: str) -> None:
    net, batch = network(FUSED[name]), observations()
    garbage = batch | {"tracks": np.where(batch["mask"][..., None] != 0, batch["tracks"], np.float32(np.nan))}
    np.testing.assert_array_equal(FusedNet(net)(garbage), FusedNet(net)(batch))


def test_the_decision_network_keeps_the_weights_that_it_was_made_with() -> None:
    net, batch = network(), observations()
    fused = FusedNet(net)
    before = fused(batch)
    for parameter in net.parameters():
        parameter.data += 1
    np.testing.assert_array_equal(fused(batch), before)


def test_the_gradient_of_the_lanes_is_that_of_finite_differences() -> None:
    net, batch = network(StGraphConfig(coverage=True), seed=4), tensors(observations(graphs=6, tracks=3, frames=4))
    fused_logits(net, batch)[:, 1].sum().backward()
    rng = np.random.default_rng(0)
    for name, parameter in net.lanes.named_parameters():
        assert parameter.grad.abs().max() > 1e-6, name
        at = tuple(rng.integers(size) for size in parameter.shape)
        ahead, behind = (_nudged(net, parameter, at, step, batch) for step in (1e-6, -1e-6))
        assert float(parameter.grad[at]) == pytest.approx((ahead - behind) / 2e-6, abs=1e-7)


@pytest.mark.parametrize("name", ["coverage", "motion and coverage"])
def test_lanes_are_decided_on_as_by_the_dense_network(name: str) -> None:
    net, batch = network(FUSED[name]), scenes(np.random.default_rng(3), 60)
    assert set(batch["lane_mask"].sum(axis=1)) == {0, 1, 2, 3, 4}
    np.testing.assert_allclose(FusedNet(net)(batch), dense_logits(net, batch), rtol=0, atol=1e-12)


def test_two_forward_passes_before_a_backward_one_do_not_disturb_each_other() -> None:
    net = network()
    one, other = tensors(observations(seed=1)), tensors(observations(seed=2))
    both = fused_logits(net, one).sum() + fused_logits(net, other).sum()
    together = torch.autograd.grad(both, list(net.parameters()))
    apart = [torch.autograd.grad(fused_logits(net, batch).sum(), list(net.parameters())) for batch in (one, other)]
    assert all(torch.allclose(a, b + c, atol=1e-12) for a, b, c in zip(together, *apart, strict=True))


@pytest.mark.parametrize("name", DENSE)
def test_any_other_network_goes_the_dense_way(name: str) -> None:
    net, batch = network(DENSE[name]), observations()
    assert not supports(DENSE[name])
    assert max(differences(net, batch)) == 0
    probability = StGraphPolicy(net).brake_probability(batch)
    np.testing.assert_allclose(probability, 1 / (1 + np.exp(-dense_logits(net, batch) @ (-1, 1))), atol=1e-12)


def test_every_knob_of_the_network_is_either_computed_or_left_to_the_dense_one() -> None:
    told = {"attn_slope", "position_scale", "hidden", "mlp_width", "head_width", "edge_attributes", "velocity",
            "commands", "ego_way", "frame_stride", "coverage"}  # fmt: skip
    left = {"heads", "layers", "fusion", "temporal_edges", "temporal", "node_time", "relu_logits", "ego_speed"}
    assert {knob.name for knob in dataclasses.fields(StGraphConfig)} == told | left | {"class_input", "commands"}
    assert all(map(supports, FUSED.values()))


def test_further_commands_are_computed_too() -> None:
    batch, net = observations(), network(StGraphConfig(commands=9))
    batch["command"] = np.eye(9, dtype=np.int8)[np.arange(len(batch["mask"])) % 9]
    assert max(differences(net, batch)) < 1e-12
    np.testing.assert_allclose(FusedNet(net)(batch), dense_logits(net, batch), rtol=0, atol=1e-12)


def test_shapes_that_do_not_fit_are_refused() -> None:
    batch = observations()
    batch["mask"] = batch["mask"][:, :-1]
    with pytest.raises(ValueError, match="mask"):
        FusedNet(network())(batch)


def test_training_fused_goes_where_training_dense_goes(recorded: Frames, monkeypatch: pytest.MonkeyPatch) -> None:
    ends = []
    for way in (fused_logits, StGraphNet.forward):
        monkeypatch.setattr("policies.stgraph.spec.fused_logits", way)
        net = StGraphNet(seed=5).double()
        adam = torch.optim.Adam(net.parameters(), lr=1e-3)
        rng = np.random.default_rng(0)
        fit(SPEC, net, adam, {"left_turn": recorded}, TrainingConfig(batch=16), range(10), 10, rng, lambda _: None)
        ends.append(torch.cat([parameter.detach().flatten() for parameter in net.parameters()]))
    assert float((ends[0] - ends[1]).abs().max()) < 1e-7


def test_exponentials_are_exact_to_two_units_in_the_last_place() -> None:
    x = np.concatenate([-np.logspace(-20, 2.8, 5001), [0.0, -1e300, -np.inf]])
    y = x.copy()
    exponentials(y)
    # A unit is between 1.1e-16 and 2.2e-16 of the number.
    np.testing.assert_allclose(y, np.exp(x), rtol=4.5e-16, atol=1e-300)


def test_compiled_code_of_a_package_belongs_to_its_sources() -> None:
    ours, theirs = (cache_folder(Path(package.__file__).parent) for package in (policies, cad_env))
    assert ours != theirs
    assert str(ours) in str(exponentials.stats.cache_path)
