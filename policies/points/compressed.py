"""Compressed feature sharing: every vehicle sends features of its points, the receiver pools them in voxels.

After COOPERNAUT (Cui, Qiu, Chen, Stone, Zhu, CVPR 2022): the sender's Point Transformer makes at most 128 keypoints
with 128 features each, which are sent as bytes (`feature_codec`). The receiver places all keypoints, its own among
them, in its frame, takes the largest of every feature in voxels of 4 m, and decides from these and the command.
There a vehicle has 2,048 points and the encoder two transitions; what fits a CPU, and is the default here, is 128
points, none of them left out, 8 neighbours and 16 channels in the encoder, mapped to the 128 that are sent.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from cad_env.lidar.config import CloudConfig, OwnCloud
from cad_env.lidar.points import KEPT, Reads, relative, thinned
from cad_env.pipeline.radio import REACHES
from cad_env.simulation.simulation import Simulation
from cad_env.types import COMMANDS, MOST_COMMANDS, Floats, Ints, Observation
from policies.layers import Linear
from policies.points import feature_codec
from policies.points.frames import CloudFrames, Seen, packed_frames, seen
from policies.points.layers import (
    POSITION_SCALE,
    SHARE,
    Backbone,
    check_sizes,
    cloud_of,
    decision,
    mean,
    most,
    sorted_points,
)
from policies.threshold_policy import PointsPolicy

_VOXEL = 4.0  # m
VEHICLES = 5  # whose keypoints the receiver has room for: its own and those of four others
MOST_KEYPOINTS = 128
_SIZES = {"points": 65_536, "neighbours": 64, "width": 256, "levels": 5, "channels": 256, "pooled_width": 256,
          "mlp_width": 1024, "commands": MOST_COMMANDS}  # fmt: skip


@dataclass(frozen=True)
class CompressedConfig:
    """The knobs of sender and receiver; `COOPERNAUT_SIZE` are those of COOPERNAUT.

    >>> CompressedConfig(points=2048)
    Traceback (most recent call last):
    ValueError: network levels=0 leaves 2048 keypoints of 2048 points, more than the 128 that are sent
    """

    points: int = KEPT  # of a vehicle's thinned cloud at most
    neighbours: int = 8  # of a point, itself included
    width: int = 16  # channels in the encoder
    levels: int = 0  # transitions down, each to a quarter of the points
    channels: int = 128  # features of a keypoint, as sent
    pooled_width: int = 32  # channels of a voxel, at the receiver
    mlp_width: int = 32
    commands: int = COMMANDS  # of the scenarios it drives in

    def __post_init__(self) -> None:
        check_sizes(self, _SIZES, {"levels": 0, "commands": COMMANDS})
        if self.keypoints > MOST_KEYPOINTS:
            raise ValueError(
                f"network levels={self.levels} leaves {self.keypoints} keypoints of {self.points} points, "
                f"more than the {MOST_KEYPOINTS} that are sent"
            )

    @property
    def keypoints(self) -> int:
        """That a vehicle sends at most."""
        return self.keypoints_of(self.points)

    def keypoints_of(self, points: int) -> int:
        """That are made of so many points: every level keeps one in SHARE, rounded up."""
        keypoints: int = -(-points // SHARE**self.levels)
        return keypoints


COOPERNAUT_SIZE = CompressedConfig(points=2048, neighbours=16, width=32, levels=2, pooled_width=128, mlp_width=128)


class CompressedNet(nn.Module):
    """The sender's encoder and the receiver's decision, trained as one; `seed` gives the first weights."""

    def __init__(self, config: CompressedConfig | None = None, seed: int = 0) -> None:
        super().__init__()
        self.config = config = config or CompressedConfig()
        rng = torch.Generator().manual_seed(seed)
        self.backbone = Backbone(config.width, config.neighbours, config.levels, 1, rng)
        self.send = Linear(config.width, config.channels, rng)
        self.pool, self.place = (Linear(n, config.pooled_width, rng) for n in (config.channels, 3))
        self.mix = Linear(config.pooled_width, config.pooled_width, rng)
        self.decide = decision(config.pooled_width, config.commands, config.mlp_width, rng)

    def encode(self, grid: Floats, first: Ints) -> tuple[Floats, Tensor, Ints]:
        """Keypoints (P, 3) m and their features (P, channels) of clouds in order, and where each begins (C + 1,)."""
        here, x = self.backbone(grid, first)
        return here.grid / feature_codec.CENTIMETRES, self.send(x), here.first

    def receive(self, position: Floats, features: Tensor, scene: Ints, command: Tensor) -> Tensor:
        """Logits (B, 2) for keypoints (P, 3) m in the ego's frame of the scenes (P,), and the commands (B, 6)."""
        cell = np.floor(position / _VOXEL).astype(np.int64)
        of_voxel, voxel = np.unique(_keys(scene, cell), return_inverse=True)
        at, voxels = torch.from_numpy(voxel.reshape(-1)), len(of_voxel)
        where = mean(torch.from_numpy(position).to(features.dtype), at, voxels) * POSITION_SCALE
        seen_there = self.mix(functional.relu(self.pool(most(features, at, voxels)) + self.place(where)))
        scenes = torch.from_numpy(of_voxel >> _SCENE)
        told = [functional.relu(most(seen_there, scenes, len(command))), command.to(features.dtype)]
        logits: Tensor = self.decide(torch.cat(told, dim=1))
        return logits

    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) for `cloud` (B, M, 3 + channels), `cloud_mask` (B, M) and `command` (B, 6) as observed."""
        cloud, mask = observation["cloud"], observation["cloud_mask"]
        rows = mask.reshape(-1).nonzero()[:, 0]
        there = cloud.reshape(-1, cloud.shape[2])[rows]
        features = there[:, 3:].to(self.send.weight.dtype)
        return self.receive(
            there[:, :3].double().numpy(), features, (rows // mask.shape[1]).numpy(), observation["command"]
        )

    def shared(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) from the clouds of all vehicles: what `forward` gives for what they would send.

        `clouds` (B, V, N, 3) m, `clouds_mask` (B, V, N), `poses` (B, V, 3) in the ego's frame and `command` (B, 6).
        """
        clouds, mask = batch["clouds"].flatten(0, 1).numpy(), batch["clouds_mask"].flatten(0, 1).numpy()
        position, features, first = self.encode(*sorted_points(clouds, mask)[:2])
        vehicle = cloud_of(first).numpy()
        pose = batch["poses"].flatten(0, 1).double().numpy()[vehicle]
        scene = vehicle // batch["clouds"].shape[1]
        return self.receive(_placed(position, pose), features, scene, batch["command"])


_SCENE = 36  # bits of the place of a voxel, twelve an axis; beyond them is the scene


def _keys(scene: Ints, cell: Ints) -> Ints:
    """One number for every voxel of every scene."""
    x, y, z = (np.clip(cell[:, axis] + 2048, 0, 4095) for axis in range(3))
    keys: Ints = scene.astype(np.int64) << _SCENE | x << 24 | y << 12 | z
    return keys


def _placed(position: Floats, pose: Floats) -> Floats:
    """Points (P, 3) m of frames with the poses (P, 3) m, m, rad."""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y, z = position.T
    return np.stack([pose[:, 0] + x * cos - y * sin, pose[:, 1] + x * sin + y * cos, z], axis=1)


class LearnedFeatures:
    """The codec of the environment: the encoder of a network as it was when this was made."""

    def __init__(self, network: CompressedNet) -> None:
        self._network = copy.deepcopy(network).double().eval().requires_grad_(False)
        self.width, self.most = network.config.channels, network.config.keypoints
        self.reads = Reads(thinned=network.config.points)

    def encode(self, clouds: Sequence[Floats]) -> list[bytes]:
        """A message for each of a batch of clouds (n, 3) m, ground and all; in double, so none depends on another."""
        few = [thinned(cloud, self._network.config.points) for cloud in clouds]
        mask = np.arange(self._network.config.points) < np.array([len(cloud) for cloud in few], int)[:, None]
        padded = np.zeros((*mask.shape, 3))
        padded[mask] = np.concatenate([np.zeros((0, 3)), *few])
        with torch.inference_mode():
            position, features, first = self._network.encode(*sorted_points(padded, mask)[:2])
        said = features.numpy()
        spans = zip(first[:-1].tolist(), first[1:].tolist(), strict=True)
        return [feature_codec.write_keypoints(position[a:b], said[a:b]) for a, b in spans]

    def decode(self, payload: bytes) -> Floats:
        """(k <= most, 3 + width) keypoints; raises DecodeError only."""
        return feature_codec.read_keypoints(payload, self.most, self.width)


class SizedOnly:
    """The codec to replay in: messages as long as those of `LearnedFeatures`, so as often refused, that say nothing."""

    width = 0

    def __init__(self, config: CompressedConfig) -> None:
        self._config, self.most = config, config.keypoints
        self.reads = Reads(thinned=config.points)

    def encode(self, clouds: Sequence[Floats]) -> list[bytes]:
        """For each of a batch of clouds (n, 3) m as many zeros as its keypoints would take."""
        keypoints = [self._config.keypoints_of(len(thinned(cloud, self._config.points))) for cloud in clouds]
        return [bytes(feature_codec.size(count, self._config.channels)) for count in keypoints]

    def decode(self, payload: bytes) -> Floats:
        """(0, 3)."""
        return np.zeros((0, 3))


@dataclass(frozen=True)
class CompressedSpec:
    """Features of points as messages; sender and receiver learn together, from the clouds of all vehicles."""

    name: str = "compressed"
    config_type: type = CompressedConfig
    kept_as: type | None = CloudFrames

    def build(self, config: CompressedConfig, seed: int) -> nn.Module:
        """A new network."""
        return CompressedNet(config, seed)

    def environment(self, network: nn.Module) -> dict[str, Any]:
        """Its encoder as it is now, and room for the keypoints of VEHICLES."""
        assert isinstance(network, CompressedNet)
        return {"cloud": CloudConfig(codec=LearnedFeatures(network), merged=VEHICLES * network.config.keypoints)}

    def replayed(self, network: nn.Module) -> dict[str, Any]:
        """What arrives is as large, but not encoded, and the ego is shown no points: `look` reads none of these.

        ValueError for a network of other clouds than those that recorded scenes keep, KEPT points a vehicle.
        """
        assert isinstance(network, CompressedNet)
        if network.config.points != KEPT:
            raise ValueError(
                f"network points must be {KEPT} to learn from recorded episodes, got {network.config.points}"
            )
        return {"cloud": CloudConfig(codec=SizedOnly(network.config), merged=1)}

    def looked_with(self, config: CompressedConfig) -> dict[str, Any]:
        """What the length of a message depends on."""
        return {name: getattr(config, name) for name in ("points", "levels", "channels")}

    def look(self, simulation: Simulation, observation: Observation) -> Seen:
        """The clouds of the ego and of the nearest others whose messages reach it now.

        So a loss, or a message over the budget, is missing in training as in driving. With a delay the clouds are
        those of now, though what arrives is older.
        """
        clouds = simulation.clouds
        assert clouds is not None, "the environment of this spec shares points"
        heard = [clouds[v] for v in range(1, len(clouds)) if simulation.arrival(v, 0)[0] == REACHES]
        own = clouds[0]
        near = [own, *sorted(heard, key=lambda other: _apart(own, other))][:VEHICLES]
        pose = np.stack([relative(other.pose, own.pose) for other in near])
        return seen([cloud.thinned for cloud in near], pose, KEPT, observation)

    def frames(self, looks: Sequence[Seen], labels: Sequence[int]) -> CloudFrames:
        """All clouds in one record."""
        return CloudFrames(**packed_frames(looks, labels, VEHICLES))

    def logits(self, network: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """End to end, from what all vehicles see."""
        assert isinstance(network, CompressedNet)
        return network.shared(batch)

    def policy(self, network: nn.Module, threshold: float) -> PointsPolicy:
        """The receiver as it is now; the senders are in the environment."""
        return PointsPolicy(network, threshold)


def _apart(one: OwnCloud, other: OwnCloud) -> float:
    return float(np.hypot(*(one.pose - other.pose)[:2]))


SPEC = COMPRESSED = CompressedSpec()
