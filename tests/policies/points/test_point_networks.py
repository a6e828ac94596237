"""The networks of points: what they must not depend on, and what they learn with."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from policies.points import compressed, point_transformer
from policies.points.compressed import COMPRESSED, CompressedConfig, CompressedNet, LearnedFeatures
from policies.points.layers import sorted_points
from policies.points.neighbours import farthest, nearest
from policies.points.point_transformer import POINT_TRANSFORMER, PointTransformerConfig, PointTransformerNet

torch.set_num_threads(1)


def a_cloud(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Points in whole centimetres, m."""
    return np.round(rng.uniform([-60, -60, 0.3], [60, 60, 3.0], (count, 3)), 2)


def merged(counts: list[int], room: int = 96, seed: int = 0) -> dict[str, NDArray[Any]]:
    """Observations of clouds with so many points."""
    rng = np.random.default_rng(seed)
    cloud, mask = np.zeros((len(counts), room, 3), np.float32), np.zeros((len(counts), room), np.int8)
    for b, count in enumerate(counts):
        cloud[b, :count], mask[b, :count] = a_cloud(rng, count), 1
    command = np.eye(6, dtype=np.int8)[rng.integers(0, 6, len(counts))]
    return {"cloud": cloud, "cloud_mask": mask, "command": command}


def shared(scenes: int, seed: int = 0, room: int = 64) -> dict[str, NDArray[Any]]:
    """Clouds of up to five vehicles, the last of them not always there."""
    rng = np.random.default_rng(seed)
    count = rng.integers(0, room, (scenes, 5)) * (np.arange(5) < rng.integers(1, 6, scenes)[:, None])
    mask = np.arange(room) < count[..., None]
    clouds = np.zeros((*mask.shape, 3), np.float32)
    clouds[mask] = a_cloud(rng, int(mask.sum()))
    poses = rng.uniform(-1, 1, (scenes, 5, 3)).astype(np.float32) * np.array([40, 40, np.pi], np.float32)
    poses[:, 0] = 0
    command = np.eye(6, dtype=np.int8)[rng.integers(0, 6, scenes)]
    return {"clouds": clouds, "clouds_mask": mask.astype(np.int8), "poses": poses, "command": command}


def tensors(batch: Mapping[str, NDArray[Any]]) -> dict[str, Tensor]:
    return {name: torch.from_numpy(part) for name, part in batch.items()}


def networks() -> list[tuple[nn.Module, dict[str, NDArray[Any]]]]:
    return [(PointTransformerNet(seed=1), merged([60, 5, 0, 90])), (CompressedNet(seed=1), shared(4))]


def logits(network: nn.Module, batch: Mapping[str, NDArray[Any]]) -> Tensor:
    spec = POINT_TRANSFORMER if isinstance(network, PointTransformerNet) else COMPRESSED
    return spec.logits(network, tensors(batch))


def test_neighbours_are_the_nearest_points_of_the_same_cloud() -> None:
    rng = np.random.default_rng(2)
    batch = merged([50, 3, 30])
    grid, first, _ = sorted_points(batch["cloud"], batch["cloud_mask"])
    near = nearest(grid, first, 6)
    for b, i in [(0, int(rng.integers(50))), (1, 51), (2, 60), (2, 82)]:
        rows = np.arange(first[b], first[b + 1])
        gap = np.square(grid[rows] - grid[i]).sum(axis=1)
        wanted = np.sort(gap)[:6].tolist()
        found = np.square(grid[near[i]] - grid[i]).sum(axis=1).tolist()
        assert found[: len(wanted)] == wanted
        assert set(near[i]) <= set(rows)
        assert (near[i, len(rows) :] == i).all(), "in a cloud of few points one hears itself again"


def test_one_point_in_four_is_kept_and_they_are_far_apart() -> None:
    batch = merged([64, 0, 5])
    grid, first, _ = sorted_points(batch["cloud"], batch["cloud_mask"])
    kept, begin = farthest(grid, first, 4)
    assert begin.tolist() == [0, 16, 16, 18]
    assert (np.diff(kept[:16]) > 0).all()
    chosen = grid[kept[:16]]
    gap = np.linalg.norm(chosen[:, None] - chosen, axis=2) + 1e9 * np.eye(16)
    covered = np.linalg.norm(grid[:64, None] - chosen, axis=2).min(axis=1)
    assert covered.max() <= gap.min(), "no point is farther from all chosen than two of these are from each other"


@pytest.mark.parametrize("which", [0, 1], ids=["raw", "compressed"])
def test_a_gradient_reaches_every_parameter(which: int) -> None:
    network, batch = networks()[which]
    torch.nn.functional.cross_entropy(logits(network, batch), torch.tensor([0, 1, 1, 0])).backward()
    silent = [name for name, value in network.named_parameters() if value.grad is None or not value.grad.any()]
    assert silent == []


@pytest.mark.parametrize("which", [0, 1], ids=["raw", "compressed"])
def test_the_order_of_the_points_changes_nothing(which: int) -> None:
    network, batch = networks()[which]
    cloud, mask = ("cloud", "cloud_mask") if which == 0 else ("clouds", "clouds_mask")
    mixed = np.random.default_rng(3).permutation(batch[mask].shape[-1])
    moved = batch | {cloud: batch[cloud][..., mixed, :], mask: batch[mask][..., mixed]}
    torch.testing.assert_close(logits(network, moved), logits(network, batch), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("which", [0, 1], ids=["raw", "compressed"])
def test_what_the_padding_holds_and_how_much_there_is_changes_nothing(which: int) -> None:
    network, batch = networks()[which]
    cloud, mask = ("cloud", "cloud_mask") if which == 0 else ("clouds", "clouds_mask")
    more = [(0, 0)] * (batch[mask].ndim - 1) + [(0, 20)]
    padded = np.pad(batch[cloud], [*more, (0, 0)]) + (np.pad(batch[mask], more) == 0)[..., None].astype(np.float32)
    wider = batch | {cloud: padded, mask: np.pad(batch[mask], more)}
    torch.testing.assert_close(logits(network, wider), logits(network, batch), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("which", [0, 1], ids=["raw", "compressed"])
def test_a_scene_decides_alone_as_it_does_in_a_batch(which: int) -> None:
    network, batch = networks()[which]
    together = logits(network.double(), batch)
    for b in range(4):
        alone = logits(network, {name: part[b : b + 1] for name, part in batch.items()})
        torch.testing.assert_close(alone, together[b : b + 1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("which", [0, 1], ids=["raw", "compressed"])
def test_other_points_give_another_decision(which: int) -> None:
    network, batch = networks()[which]
    mask = "cloud_mask" if which == 0 else "clouds_mask"
    half = batch | {mask: batch[mask] * (np.arange(batch[mask].shape[-1]) % 2).astype(np.int8)}
    apart = (logits(network, half) - logits(network, batch)).abs().amax(1)
    assert (apart[batch[mask].reshape(4, -1).any(1)] > 1e-5).all()


def test_the_driver_decides_as_the_network_does_and_alone_as_in_a_batch() -> None:
    network, batch = networks()[0]
    policy = POINT_TRANSFORMER.policy(network, 0.5)
    sure = policy.brake_probability(batch)
    np.testing.assert_allclose(sure, torch.softmax(logits(network, batch), 1)[:, 1].detach().numpy(), atol=1e-5)
    threshold = float(np.sort(sure)[1])
    policy = POINT_TRANSFORMER.policy(network, threshold)
    alone = [policy.act({name: part[b] for name, part in batch.items()}) for b in range(4)]
    assert policy.act_batch(batch).tolist() == alone
    assert set(alone) == {0, 1}
    assert not policy.privileged
    assert policy.act_batch({name: part[:0] for name, part in batch.items()}).shape == (0,)


def test_what_the_vehicles_send_decides_as_training_has_it() -> None:
    network, batch = CompressedNet(seed=4), shared(6, seed=5)
    codec = LearnedFeatures(network)
    rows = []
    for clouds, masks, poses in zip(batch["clouds"], batch["clouds_mask"], batch["poses"], strict=True):
        payloads = codec.encode([cloud[mask > 0].astype(float) for cloud, mask in zip(clouds, masks, strict=True)])
        parts = [codec.decode(payload) for payload in payloads]
        for part, (x, y, turn) in zip(parts, poses.astype(float), strict=True):
            ahead, aside = part[:, 0].copy(), part[:, 1].copy()
            part[:, 0] = x + ahead * np.cos(turn) - aside * np.sin(turn)
            part[:, 1] = y + ahead * np.sin(turn) + aside * np.cos(turn)
        rows.append(np.concatenate(parts))
    room = max(len(row) for row in rows)
    cloud = np.zeros((6, room, 3 + codec.width), np.float32)
    mask = np.zeros((6, room), np.int8)
    for b, row in enumerate(rows):
        cloud[b, : len(row)], mask[b, : len(row)] = row, 1
    observed = {"cloud": cloud, "cloud_mask": mask, "command": batch["command"]}
    assert mask.sum() == batch["clouds_mask"].sum() > 300, "all points are keypoints here"
    found = COMPRESSED.policy(network, 0.5).brake_probability(observed)
    np.testing.assert_allclose(found, torch.softmax(logits(network, batch), 1)[:, 1].detach().numpy(), atol=2e-3)


def test_a_message_does_not_depend_on_the_other_clouds_of_its_batch() -> None:
    rng, codec = np.random.default_rng(6), LearnedFeatures(CompressedNet(seed=4))
    clouds = [a_cloud(rng, count) for count in (300, 0, 40)]
    assert codec.encode(clouds) == [codec.encode([cloud])[0] for cloud in clouds]
    assert len(codec.decode(codec.encode(clouds)[0])) == codec.most == 128
    assert codec.encode([]) == []


def test_the_first_weights_are_a_function_of_the_seed() -> None:
    for spec, config in ((POINT_TRANSFORMER, PointTransformerConfig()), (COMPRESSED, CompressedConfig())):
        first, again, other = (spec.build(config, seed).state_dict() for seed in (1, 1, 2))
        assert all(torch.equal(first[name], again[name]) for name in first)
        assert any(not torch.equal(first[name], other[name]) for name in first)


def test_the_sizes_of_the_papers_can_be_built_and_run() -> None:
    network = PointTransformerNet(point_transformer.PAPER_SIZE)
    assert logits(network, merged([200], room=256)).shape == (1, 2)
    sender = LearnedFeatures(CompressedNet(compressed.COOPERNAUT_SIZE))
    payload = sender.encode([a_cloud(np.random.default_rng(7), 4000)])[0]
    assert sender.decode(payload).shape == (128, 131)


@pytest.mark.parametrize("knobs", [{"merged": 0}, {"width": 1.5}, {"levels": -1}, {"mlp_width": True}])
def test_sizes_that_are_none_are_refused(knobs: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"network {next(iter(knobs))} must be a whole number"):
        PointTransformerConfig(**knobs)
