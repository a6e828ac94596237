"""What the network promises, and that an independent twin agrees with it."""

import dataclasses

import numpy as np
import pytest
import torch
from torch.nn.functional import cross_entropy

from cad_env.pipeline.observe_lanes import LANE_FEATURES
from policies.stgraph.features import window_velocity
from policies.stgraph.network import StGraphConfig, StGraphNet, _WeightedSum

torch.set_num_threads(1)

PAPER = StGraphConfig()
EVERY_INPUT = StGraphConfig(node_time=True, velocity=True, ego_speed=True, class_input=True, ego_way=True)
VARIANTS = {
    "paper": PAPER,
    "relu attention": StGraphConfig(attn_slope=0.0),
    "relu logits": StGraphConfig(relu_logits=True),
    "no edge attributes": StGraphConfig(edge_attributes=False),
    "no time": StGraphConfig(temporal=False),
    "per layer": StGraphConfig(fusion="per_layer", layers=3),
    "consecutive": StGraphConfig(temporal_edges="consecutive"),
    "causal": StGraphConfig(temporal_edges="causal"),
    "every input": EVERY_INPUT,
    "coverage": StGraphConfig(coverage=True),
    "every third frame": StGraphConfig(velocity=True, ego_way=True, frame_stride=3),
    "one layer": StGraphConfig(layers=1, heads=2, head_width=5, hidden=7, mlp_width=9, position_scale=0.1),
}


def observations(seed: int = 0, graphs: int = 8, tracks: int = 5, frames: int = 6) -> dict[str, np.ndarray]:
    """Ragged scenes, from full ones down to an empty scene (the last) and a single node (the one before)."""
    rng = np.random.default_rng(seed)
    share = np.linspace(1.0, 0.1, graphs)[:, None, None]
    mask = (rng.random((graphs, tracks, frames)) < share).astype(np.int8)
    mask[-2:] = 0
    mask[-2, 0, frames // 2] = 1
    return {
        "tracks": rng.normal(0.0, 30.0, (graphs, tracks, frames, 3)).astype(np.float32),
        "mask": mask,
        "kind": rng.integers(0, 2, (graphs, tracks)).astype(np.int8),
        "ego": rng.uniform(1.0, 15.0, (graphs, 4)).astype(np.float32),
        "command": np.eye(6, dtype=np.int8)[rng.integers(0, 6, graphs)],
        "route": rng.normal(0.0, 10.0, (graphs, 40, 2)).astype(np.float32),
        **lanes(rng, graphs),
    }


def lanes(rng: np.random.Generator, graphs: int) -> dict[str, np.ndarray]:
    """Four lanes down to none, half of them without a phantom; what is masked is garbage."""
    mask = (np.arange(4) < np.arange(graphs)[::-1, None]).astype(np.int8)
    found = np.where(mask[..., None] == 1, rng.uniform(-1.0, 1.0, (graphs, 4, 14)), np.nan)
    scale = {"x": 50, "y": 20, "reach": 40, "through": 60, "hidden": 60, "age": 5, "time": 8, "speed": 15}
    for name, size in scale.items():
        found[..., LANE_FEATURES.index(name)] *= size
    found[..., LANE_FEATURES.index("time")] += 4
    found[:, ::2, LANE_FEATURES.index("hidden")] = 200.0
    return {"lanes": found.astype(np.float32), "lane_mask": mask}


def tensors(batch: dict[str, np.ndarray]) -> dict[str, torch.Tensor]:
    return {key: torch.tensor(value) for key, value in batch.items()}


def network(config: StGraphConfig = PAPER, seed: int = 1) -> StGraphNet:
    """In double precision, with no weight left at zero."""
    net = StGraphNet(config, seed).double()
    chance = torch.Generator().manual_seed(seed)
    for parameter in net.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=chance, dtype=torch.float64)
    return net


def logits(net: StGraphNet, batch: dict[str, np.ndarray]) -> np.ndarray:
    with torch.no_grad():
        return net(tensors(batch)).numpy()


def compare_with_twin(config: StGraphConfig, dtype: torch.dtype) -> tuple[float, float]:
    """The largest difference of logits, and of gradients, between the network and its twin."""
    pytest.importorskip("torch_geometric")
    from pyg_twin import PygTwin, to_hetero_data

    batch = observations(seed=2)
    net = network(config).to(dtype)
    twin = PygTwin(config).to(dtype)
    twin.load_state_dict(net.state_dict())
    keys = ("tracks", "mask", "command", "ego", "kind", "route", "lanes", "lane_mask")
    graphs = [to_hetero_data(*(batch[key][i] for key in keys), config) for i in range(len(batch["mask"]))]
    here, there = net(tensors(batch)), twin(graphs)
    truth = torch.arange(len(here)) % 2
    for answer in (here, there):
        cross_entropy(answer, truth).backward()
    slopes = [(mine.grad, its.grad) for mine, its in zip(net.parameters(), twin.parameters(), strict=True)]
    assert all(mine is not None and mine.abs().sum() > 0 for mine, _ in slopes) or config.relu_logits
    return float((here - there).detach().abs().max()), max(float((mine - its).abs().max()) for mine, its in slopes)


@pytest.mark.parametrize("name", VARIANTS)
def test_message_passing_twin_agrees_forward_and_gradient(name: str) -> None:
    forward, gradient = compare_with_twin(VARIANTS[name], torch.float64)
    assert forward < 1e-10
    assert gradient < 1e-10


def test_twin_agrees_in_single_precision_within_rounding() -> None:
    forward, gradient = compare_with_twin(PAPER, torch.float32)
    assert forward < 1e-5
    assert gradient < 1e-5


def test_paper_width_has_2722_parameters() -> None:
    assert sum(parameter.numel() for parameter in StGraphNet().parameters()) == 2722


def test_weighted_sum_has_the_gradient_of_its_formula() -> None:
    chance = torch.Generator().manual_seed(0)
    alpha = torch.rand(2, 3, 4, 2, 3, generator=chance, dtype=torch.float64, requires_grad=True)
    value = torch.rand(2, 5, 4, 2, 3, generator=chance, dtype=torch.float64, requires_grad=True)
    assert torch.allclose(_WeightedSum.apply(alpha, value), torch.einsum("hijgb,hdjgb->hdigb", alpha, value))
    assert torch.autograd.gradcheck(_WeightedSum.apply, (alpha, value))


@pytest.mark.parametrize("name", VARIANTS)
def test_a_scene_does_not_depend_on_its_batch_mates(name: str) -> None:
    net, batch = network(VARIANTS[name]), observations()
    alone = [logits(net, {key: value[i : i + 1] for key, value in batch.items()})[0] for i in range(8)]
    np.testing.assert_allclose(logits(net, batch), alone, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", VARIANTS)
def test_the_order_of_tracks_changes_nothing(name: str) -> None:
    net, batch = network(VARIANTS[name]), observations()
    order = np.random.default_rng(3).permutation(5)
    shuffled = batch | {key: batch[key][:, order] for key in ("tracks", "mask", "kind")}
    np.testing.assert_allclose(logits(net, shuffled), logits(net, batch), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", VARIANTS)
def test_what_is_masked_is_not_read(name: str) -> None:
    net, batch = network(VARIANTS[name]), observations()
    seen = batch["mask"][..., None] != 0
    garbage = batch | {
        "tracks": np.where(seen, batch["tracks"], np.float32(np.nan)),
        "kind": np.where(batch["mask"].any(2), batch["kind"], 7).astype(np.int8),
    }
    np.testing.assert_array_equal(logits(net, garbage), logits(net, batch))


@pytest.mark.parametrize("name", VARIANTS)
def test_padding_with_empty_tracks_changes_nothing(name: str) -> None:
    net, batch = network(VARIANTS[name]), observations()
    wider = batch | {
        key: np.pad(batch[key], [(0, 0), (0, 4)] + [(0, 0)] * (batch[key].ndim - 2))
        for key in ("tracks", "mask", "kind")
    }
    np.testing.assert_array_equal(logits(net, wider), logits(net, batch))


@pytest.mark.parametrize("name", VARIANTS)
def test_empty_scenes_give_finite_decisions_and_gradients(name: str) -> None:
    net, batch = StGraphNet(VARIANTS[name]), observations()
    batch["mask"][:] = 0
    answer = net(tensors(batch))
    answer.sum().backward()
    assert answer.isfinite().all()
    assert all(p.grad is None or p.grad.isfinite().all() for p in net.parameters())


def test_an_empty_scene_still_tells_the_commands_apart() -> None:
    batch = observations(graphs=6)
    batch["mask"][:], batch["command"] = 0, np.eye(6, dtype=np.int8)
    assert len(np.unique(logits(network(), batch)[:, 0])) == 6


def test_without_time_only_the_newest_frame_counts() -> None:
    net, batch = network(StGraphConfig(temporal=False)), observations()
    older = batch | {"tracks": batch["tracks"].copy(), "mask": batch["mask"].copy()}
    older["tracks"][:, :, :-1] += 5
    older["mask"][:, :, :-1] ^= 1
    np.testing.assert_array_equal(logits(net, older), logits(net, batch))


def test_the_past_and_the_future_are_told_apart() -> None:
    net, batch = network(), observations()
    backwards = batch | {key: batch[key][:, :, ::-1].copy() for key in ("tracks", "mask")}
    assert np.abs(logits(net, backwards) - logits(net, batch))[:6].min() > 1e-6


@pytest.mark.parametrize(
    ("switch", "key"),
    [
        ("ego_speed", "ego"),
        ("velocity", "ego"),
        ("class_input", "kind"),
        ("ego_way", "ego"),
        ("ego_way", "route"),
        ("coverage", "lanes"),
    ],
)
def test_speed_and_kind_reach_the_decision_only_when_asked(switch: str, key: str) -> None:
    batch = observations()
    other = batch | {key: (batch[key] + 1) % 2 if key == "kind" else batch[key] + 1}
    np.testing.assert_array_equal(logits(network(), other), logits(network(), batch))
    told = network(dataclasses.replace(PAPER, **{switch: True}))
    assert np.abs(logits(told, other) - logits(told, batch))[:6].min() > 1e-9


def test_velocity_is_the_slope_of_the_sightings() -> None:
    time = torch.arange(-5, 1) / 10
    position = torch.stack([3.0 * time + 1, -2.0 * time]).view(2, 1, 6, 1)
    mask = torch.tensor([1, 0, 1, 1, 0, 1]).bool().view(1, 6, 1)
    assert torch.allclose(window_velocity(position * mask, mask, time).flatten(), torch.tensor([3.0, -2.0]), atol=1e-5)
    once = torch.tensor([0, 0, 1, 0, 0, 0]).bool().view(1, 6, 1)
    assert window_velocity(position * once, once, time).abs().max() == 0


def test_the_same_seed_gives_the_same_weights_and_leaves_torch_alone() -> None:
    before = torch.random.get_rng_state()
    one, same, other = (StGraphNet(seed=seed).state_dict() for seed in (4, 4, 5))
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert not torch.equal(one["project.weight"], other["project.weight"])
    assert torch.equal(before, torch.random.get_rng_state())


@pytest.mark.parametrize(
    ("knob", "value"),
    [
        ("hidden", 0),
        ("heads", 2.0),
        ("layers", True),
        ("mlp_width", 10**9),
        ("velocity", 1),
        ("ego_way", "yes"),
        ("coverage", None),
        ("frame_stride", 0),
        ("attn_slope", -0.1),
        ("position_scale", float("nan")),
        ("fusion", "first"),
        ("temporal_edges", "none"),
    ],
)
def test_nonsense_is_refused_in_one_line_that_names_it(knob: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"network {knob} must be") as caught:
        dataclasses.replace(PAPER, **{knob: value})
    message = str(caught.value)
    assert repr(value) in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "knob", [{"velocity": True}, {"node_time": True}, {"fusion": "per_layer"}, {"frame_stride": 3}]
)
def test_what_needs_time_is_refused_without_it(knob: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="when temporal is False"):
        dataclasses.replace(PAPER, temporal=False, **knob)


def test_shapes_that_do_not_fit_are_refused() -> None:
    batch = tensors(observations())
    with pytest.raises(ValueError, match="mask"):
        StGraphNet()(batch | {"mask": batch["mask"][:, :-1]})


def test_it_learns_which_way_an_object_goes_along_the_same_places() -> None:
    chance = torch.Generator().manual_seed(0)
    truth = torch.randint(2, (64,), generator=chance)
    time = torch.arange(-14, 1) / 10
    speed = torch.where(truth == 1, -15.0, 15.0)[:, None]
    away = 40 + 20 * torch.rand(64, 1, generator=chance) + speed * (time + 0.7)  # the same places, in another order
    tracks = torch.stack([away, 0 * away, 0 * away], dim=-1).unsqueeze(1)
    batch = {"tracks": tracks, "mask": torch.ones(64, 1, 15), "command": torch.zeros(64, 6)}
    net = StGraphNet(seed=0)
    adam = torch.optim.Adam(net.parameters(), lr=1e-2)
    for _ in range(100):
        adam.zero_grad()
        cross_entropy(net(batch), truth).backward()
        adam.step()
    assert (net(batch).argmax(1) == truth).float().mean() > 0.95
