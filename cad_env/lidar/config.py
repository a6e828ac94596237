"""Sharing points instead of graphs: the settings, what a codec must do, and what the ego is shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from gymnasium import spaces

from cad_env.checks import check_numbers
from cad_env.config import check_names, knows_its_names
from cad_env.lidar.points import MOST_POINTS, RawPoints, Reads
from cad_env.pipeline.observe import HORIZON, observation_space
from cad_env.pipeline.observe_lanes import lane_spaces
from cad_env.types import COMMANDS, Floats, Ints

MOST_AZIMUTHS, MOST_BEAMS, MOST_MERGED = 8192, 128, 65536


@runtime_checkable
class CloudCodec(Protocol):
    """How a vehicle's cloud becomes bytes, and bytes points again. What it does to one cloud depends on no other."""

    @property
    def width(self) -> int:
        """W, numbers after x, y, z of a decoded point; 0 for raw points."""

    @property
    def most(self) -> int:
        """Points that one message decodes to at most."""

    def encode(self, clouds: Sequence[Floats]) -> list[bytes]:
        """A payload for each of a batch of clouds (n, 3) m, as cast: ground included, in the vehicles' own frames.

        An encoder of few points begins with `pipeline.points.thinned`, and had better be `Selective`. The arrays are
        lent: they are not to be changed, and the next batch is in them.
        """

    def decode(self, payload: bytes) -> Floats:
        """(k <= most, 3 + W) finite numbers, x, y, z in m in the sender's own frame; raises DecodeError only."""


@runtime_checkable
class Selective(Protocol):
    """A codec that says what it reads, which spares making the rest."""

    @property
    def reads(self) -> Reads:
        """The same for every cloud."""


@knows_its_names("cloud setting")
@dataclass(frozen=True)
class CloudConfig:
    """That connected vehicles share points, and how: 1024 x 64 are the rays of a usual lidar."""

    azimuths: int = 1024  # directions around the vehicle
    beams: int = 64  # elevations in each; 1: a single horizontal one that meets boxes at half their height
    codec: CloudCodec = field(default_factory=RawPoints)
    merged: int = 512  # points that the ego is shown at most; of more, every so many (a stride over all of them)

    def __post_init__(self) -> None:
        check_numbers(self, "cloud", {"azimuths": (8, MOST_AZIMUTHS), "merged": (1, MOST_MERGED)})
        # As many rays as a message may have points, since every one may return.
        check_numbers(self, "cloud", {"beams": (1, min(MOST_BEAMS, MOST_POINTS // self.azimuths))})
        if not isinstance(self.codec, CloudCodec):
            raise ValueError(f"cloud codec must have width, most, encode and decode, got {self.codec!r}")


class OwnCloud(NamedTuple):
    """What one vehicle's lidar sees now, and where its GNSS places it: for training data."""

    thinned: Floats  # (n, 3) m, in its own frame
    pose: Floats  # (3,) m, m, rad, in the world


class CloudView(NamedTuple):
    """The merged points that the ego decides on; the fields that an observation has with clouds. M = merged."""

    cloud: Floats  # (M, 3 + W) float32 m in the ego's frame now, then W features; zero where the mask is
    cloud_mask: Ints  # (M,) int8


def empty_cloud_view(config: CloudConfig, *lead: int) -> CloudView:
    """No points; leading dimensions stack views."""
    return CloudView(
        np.zeros((*lead, config.merged, 3 + config.codec.width), np.float32),
        np.zeros((*lead, config.merged), np.int8),
    )


def space_with(config: CloudConfig | None, commands: int = COMMANDS, coverage: bool = False) -> spaces.Dict:
    """The space of the ego's observation: that of graphs, and with clouds or coverage their two boxes."""
    boxes = dict(observation_space(commands).spaces)
    if coverage:
        boxes.update(lane_spaces())
    if config is not None:
        view = empty_cloud_view(config)
        boxes["cloud"] = spaces.Box(-HORIZON, HORIZON, view.cloud.shape, np.float32)
        boxes["cloud_mask"] = spaces.Box(0, 1, view.cloud_mask.shape, np.int8)
    return spaces.Dict(boxes)


def cloud_config(given: Any) -> CloudConfig | None:
    """A CloudConfig as it is or from a dict of its settings; None stays None.

    >>> cloud_config({"beams": 32}).azimuths
    1024
    """
    if isinstance(given, Mapping):
        check_names("cloud setting", dict(given), [f.name for f in fields(CloudConfig)])
        return CloudConfig(**given)
    if given is not None and not isinstance(given, CloudConfig):
        raise ValueError(f"cloud must be None, a CloudConfig or a dict of its settings, got {given!r}")
    return given


MAX_RANGE = 300.0  # m of the sensor: the coordinates of raw points are two bytes of centimetres
