"""The nouns. Frozen records with shapes and units; nothing here computes.

World frame everywhere: metres, radians counter-clockwise from +x, m/s, s. Only an observation is in the ego frame.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[Any]  # any integer type; kernels use int64 indices, int8 classes and uint64 keys
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Image = NDArray[np.uint8]  # (height, width, 3)
Observation = dict[str, NDArray[Any]]

GO, BRAKE = 0, 1
CAR, TRUCK = 0, 1

# How an episode ends.
SUCCESS, COLLISION, TIMEOUT = OUTCOMES = ("success", "collision", "timeout")

STEP = 0.1  # s, one decision
MAX_STEPS = 300  # decisions, after which time is up: 30 s
FRAMES = 15  # frames in a graph window: 1.5 s at 10 Hz
MAX_TRACKS = 32  # tracks a vehicle can hold at once, its own body included
MAX_MERGED_TRACKS = 64  # tracks a merged graph can hold

OBSERVED_TRACKS = 16  # the nearest tracks of the merged graph that an observation shows
ROUTE_POINTS = 40  # points of its own route that an observation shows ...
ROUTE_SPACING = 2.0  # ... one every so many metres


class Command(IntEnum):
    """What the route asks of the ego now: the six commands of the paper, in the order of its one-hot vector."""

    FOLLOW_LANE = 0
    TURN_LEFT = 1
    TURN_RIGHT = 2
    GO_STRAIGHT = 3
    CHANGE_LEFT = 4
    CHANGE_RIGHT = 5


COMMANDS = len(Command)  # a scenario may add further ones
MOST_COMMANDS = 127  # in all: a map keeps them as int8


class GraphArrays(NamedTuple):
    """A graph as the compiled stages see it: preallocated rows, of which the first `used[0]` are in use.

    GraphArrays beyond the count may hold anything. Column -1 of `position` and `mask` is the newest frame.
    """

    used: Ints  # (1,) int64 rows in use
    track: Ints  # (R,) int64 ids
    position: Floats  # (R, T, 3) m
    mask: Bools  # (R, T) True where the track was seen in that frame
    kind: Ints  # (R,) int8 CAR or TRUCK


@dataclass(frozen=True)
class Graph:
    """A spatiotemporal graph: a node is a (track, frame) whose mask is set.

    Edges follow from the nodes and are never stored: spatial edges join all pairs of one frame (attribute:
    distance), temporal edges all pairs of one track (attribute: time gap). In the graph of a single vehicle,
    track 0 is the vehicle's own body, as its GNSS places it; ids from 1 are what it tracks.
    """

    sender: int
    time: float  # s, of the newest frame
    track: Ints  # (K,) ids, unique, as the sender numbers them
    position: Floats  # (K, T, 3) m; column -1 is the newest frame
    mask: Bools  # (K, T)
    kind: Ints  # (K,) int8 CAR or TRUCK


class Policy(Protocol):
    """Who decides. A privileged policy is given the Truth of the world, any other an observation."""

    privileged: bool

    def reset(self, seed: int) -> None:
        """Forget the last episode; `seed` is the only source of chance."""

    def act(self, observation: Any) -> int:
        """GO or BRAKE."""
