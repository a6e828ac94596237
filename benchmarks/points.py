"""What the networks of points cost: ms a sample on one thread, and the bytes of their messages as encoded.

python benchmarks/points.py --json runs/paper/costs.json      the table, and the same for the report of reproduce.py
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from cad_env.lidar.points import RawPoints
from cad_env.types import Floats
from policies.points import compressed, point_transformer
from policies.points.compressed import COMPRESSED, CompressedConfig, CompressedNet, LearnedFeatures
from policies.points.point_transformer import POINT_TRANSFORMER, PointTransformerConfig, PointTransformerNet
from policies.spec import NetworkSpec

RAYS = 1024 * 64
Row = dict[str, str | int | float]
ROW = "{:46} {:>6} {:>9} {:>9} {:>9} {:>10}"


def a_cloud(rng: np.random.Generator, count: int) -> Floats:
    """Points (n, 3) m in no order, as spread out as thinned ones are."""
    return rng.uniform([-70, -40, 0.3], [70, 40, 3.0], (count, 3))


def merged(points: int, batch: int) -> dict[str, Tensor]:
    """A batch of full merged clouds."""
    rng = np.random.default_rng(0)
    cloud = np.stack([a_cloud(rng, points) for _ in range(batch)]).astype(np.float32)
    return _tensors(cloud=cloud, cloud_mask=np.ones(cloud.shape[:2], np.int8), command=_commands(batch))


def of_vehicles(points: int, vehicles: int, batch: int) -> dict[str, Tensor]:
    """A batch of scenes in which so many vehicles have full clouds."""
    rng = np.random.default_rng(0)
    clouds = np.stack([a_cloud(rng, points) for _ in range(batch * vehicles)]).astype(np.float32)
    clouds = clouds.reshape(batch, vehicles, points, 3)
    poses = rng.uniform([-40, -20, -3], [40, 20, 3], (batch, vehicles, 3)).astype(np.float32)
    mask = np.ones(clouds.shape[:3], np.int8)
    return _tensors(clouds=clouds, clouds_mask=mask, poses=poses, command=_commands(batch))


def _commands(batch: int) -> np.ndarray:
    return np.eye(6, dtype=np.int8)[np.arange(batch) % 6]


def _tensors(**parts: np.ndarray) -> dict[str, Tensor]:
    return {name: torch.from_numpy(part) for name, part in parts.items()}


def _cost(family: NetworkSpec, network: nn.Module, batch: dict[str, Tensor], repeats: int) -> tuple[float, float]:
    """ms a sample: forward, and forward with backward."""
    count = len(batch["command"])
    label = torch.zeros(count, dtype=torch.long)

    def forward() -> None:
        with torch.no_grad():
            family.logits(network, batch)

    def train() -> None:
        network.zero_grad()
        nn.functional.cross_entropy(family.logits(network, batch), label).backward()

    return _ms(forward, repeats) / count, _ms(train, repeats) / count


def _ms(work: Callable[[], None], repeats: int) -> float:
    """The median of processor time, ms: other processes of the machine do not count."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - start))
    return statistics.median(times)


def _of_points(name: str, config: PointTransformerConfig, points: int, batch: int, repeats: int) -> Row:
    network = PointTransformerNet(config)
    cost = _cost(POINT_TRANSFORMER, network, merged(points, batch), repeats)
    return _tell(f"Point Transformer, {name}, {points} points", network, cost, len(_raw()))


def _of_features(name: str, config: CompressedConfig, points: int, vehicles: int, batch: int, repeats: int) -> Row:
    network = CompressedNet(config)
    cost = _cost(COMPRESSED, network, of_vehicles(points, vehicles, batch), repeats)
    sent = LearnedFeatures(network).encode([a_cloud(np.random.default_rng(1), 4 * points)])[0]
    return _tell(f"compressed, {name}, {points} x {vehicles} vehicles", network, cost, len(sent))


def _raw() -> bytes:
    return RawPoints().encode([a_cloud(np.random.default_rng(1), RAYS)])[0]


def _tell(what: str, network: nn.Module, cost: tuple[float, float], sent: int) -> Row:
    weights = sum(value.numel() for value in network.parameters())
    print(ROW.format(what, f"{weights / 1e3:.0f}k", f"{cost[0]:.2f}", f"{cost[1]:.2f}", f"{6e4 / cost[1]:,.0f}",
                     f"{sent:,}"), flush=True)  # fmt: skip
    return {
        "network": what, "weights": weights, "forward, ms a sample": round(cost[0], 2),
        "forward and backward, ms a sample": round(cost[1], 2), "bytes of a message": sent,
    }  # fmt: skip


def main() -> None:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    print(ROW.format("network, full clouds", "size", "fwd ms", "train ms", "train/min", "bytes"))
    small, repeats = PointTransformerConfig(), asked.repeats
    rows = [
        *(_of_points("CPU size", small, points, 32, repeats) for points in (128, 256, 512)),
        _of_points("paper size", point_transformer.PAPER_SIZE, 4096, 1, repeats),
        *(
            _of_features("CPU size", CompressedConfig(), points, vehicles, 32, repeats)
            for points, vehicles in ((64, 4), (128, 3), (128, 5))
        ),
        _of_features("paper size", compressed.COOPERNAUT_SIZE, 2048, 4, 1, repeats),
    ]
    if asked.json is not None:
        asked.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
