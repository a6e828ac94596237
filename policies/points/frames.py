"""Labelled frames of point clouds in a form that takes little memory: whole centimetres, no padding.

A frame holds the clouds of some vehicles, each with the pose of its own frame in the ego's. 60,000 frames of five
vehicles with 128 points each would take 240 MB; as the left turn's clouds are, they take 140 MB.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cad_env.types import Floats, Ints, Observation
from policies.points.feature_codec import CENTIMETRES

_PARTS = ("label", "command", "ego", "pose", "point")
_REACH = 32_767  # cm


@dataclass(frozen=True)
class Seen:
    """What is kept of one frame."""

    clouds: Sequence[Ints]  # of each vehicle (n_i, 3) int16 cm, in its own frame; the ego's first
    pose: Floats  # (V, 3) float32 m, m, rad: of those frames in the ego's
    room: int  # points that a cloud has at most
    command: Ints  # (6,) int8
    ego: Floats  # (4,) float32


def seen(clouds: Sequence[NDArray[Any]], pose: NDArray[Any], room: int, observation: Observation) -> Seen:
    """A frame of clouds (n_i <= room, 3) m and their poses (V, 3)."""
    whole = [np.clip(np.rint(cloud * CENTIMETRES), -_REACH, _REACH).astype(np.int16) for cloud in clouds]
    return Seen(whole, np.asarray(pose, np.float32), room, observation["command"], observation["ego"])


@dataclass(frozen=True)
class CloudFrames:
    """F labelled frames of whole episodes.

    The clouds of frame f are first_cloud[f] to first_cloud[f + 1], and the points of cloud c are first_point[c] to
    first_point[c + 1].
    """

    vehicles: int  # most clouds in a frame
    points: int  # most points in a cloud
    label: Ints  # (F,) int8 what the expert would do
    command: Ints  # (F, 6) int8
    ego: Floats  # (F, 4) float32
    first_cloud: Ints  # (F + 1,) int64
    pose: Floats  # (C, 3) float32 m, m, rad
    first_point: Ints  # (C + 1,) int64
    point: Ints  # (P, 3) int16 cm

    def __len__(self) -> int:
        """F."""
        return len(self.label)

    def batch(self, frames: Ints) -> dict[str, NDArray[Any]]:
        """`clouds` (B, V, N, 3) m and `clouds_mask` (B, V, N), `poses` (B, V, 3), `command` (B, 6), `ego` (B, 4)."""
        slot, cloud = _spread(self.first_cloud, frames, np.arange(len(frames)) * self.vehicles)
        place, point = _spread(self.first_point, cloud, slot * self.points)
        slots = len(frames) * self.vehicles
        poses, points = np.zeros((slots, 3), np.float32), np.zeros((slots * self.points, 3), np.float32)
        mask = np.zeros(slots * self.points, np.int8)
        poses[slot], points[place], mask[place] = self.pose[cloud], self.point[point] / np.float32(CENTIMETRES), 1
        shape = (len(frames), self.vehicles, self.points)
        return {
            "clouds": points.reshape(*shape, 3),
            "clouds_mask": mask.reshape(shape),
            "poses": poses.reshape(*shape[:2], 3),
            "command": self.command[frames],
            "ego": self.ego[frames],
        }

    def joined(self, others: "Sequence[CloudFrames]") -> "CloudFrames":
        """These frames and then the others'."""
        parts = [self, *others]
        whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _PARTS}
        first_cloud = np.cumsum(np.concatenate([[0], *(np.diff(part.first_cloud) for part in parts)]))
        first_point = np.cumsum(np.concatenate([[0], *(np.diff(part.first_point) for part in parts)]))
        return type(self)(self.vehicles, self.points, first_cloud=first_cloud, first_point=first_point, **whole)


def packed_frames(looks: Sequence[Seen], labels: Sequence[int], vehicles: int) -> dict[str, Any]:
    """The fields of the frames that were looked at, with at most so many vehicles of each."""
    clouds = [cloud for look in looks for cloud in look.clouds[:vehicles]]
    poses = [look.pose[:vehicles] for look in looks]
    return {
        "vehicles": vehicles,
        "points": max((look.room for look in looks), default=0),
        "label": np.array(labels, np.int8),
        "command": np.array([look.command for look in looks], np.int8).reshape(len(looks), -1),
        "ego": np.array([look.ego for look in looks], np.float32).reshape(len(looks), -1),
        "first_cloud": np.cumsum([0] + [len(pose) for pose in poses]),
        "pose": np.concatenate(poses) if poses else np.zeros((0, 3), np.float32),
        "first_point": np.cumsum([0] + [len(cloud) for cloud in clouds]),
        "point": np.concatenate(clouds) if clouds else np.zeros((0, 3), np.int16),
    }


def _spread(first: Ints, chosen: Ints, begin: Ints) -> tuple[Ints, Ints]:
    """Where the rows first[c] to first[c + 1] of the chosen ones go, from the `begin` of each on, and they."""
    count = first[chosen + 1] - first[chosen]
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(begin, count) + within, np.repeat(first[chosen], count) + within
