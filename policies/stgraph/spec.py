"""The paper's network as a spec: frames keep the nodes of their graphs, and a batch is the padded windows again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor, nn

from cad_env.pipeline.observe_lanes import LANE_FEATURES, LaneView
from cad_env.simulation.simulation import Simulation
from cad_env.types import FRAMES, OBSERVED_TRACKS, ROUTE_POINTS, Floats, Ints, Observation
from policies.spec import SpecDefaults
from policies.stgraph.compiled.module import fused_logits
from policies.stgraph.features import WAY_POINTS
from policies.stgraph.network import StGraphConfig, StGraphNet
from policies.stgraph.policy import StGraphPolicy

SLOTS = OBSERVED_TRACKS * FRAMES
CENTIMETRE = np.float32(0.01)  # m; as fine as messages carry positions, and much finer than the sensors
_NO_LANES = LaneView(np.zeros((0, len(LANE_FEATURES)), np.float32), np.zeros(0, np.int8))
_PARTS = ("label", "command", "ego", "kind", "aside", "first_node", "nodes", "lanes", "lane_mask")


@dataclass(frozen=True)
class GraphFrames:
    """F labelled frames of whole episodes, in P parts that were recorded together.

    It keeps only the nodes of a graph and not the padded window, and positions to a centimetre: a frame of a hundred
    nodes takes 0.8 kB. Parts are never copied together, which would take the memory twice.
    """

    label: Ints  # (F,) int8 what the expert would do
    command: Ints  # (F, 6) int8
    ego: Floats  # (F, 4) float32
    kind: Ints  # (F, K) int8
    aside: Ints  # (F, W) int16 cm, to the left: the points of the route that the network reads
    lanes: Floats  # (F, L, 14) float32 the lanes that the ego's way meets; L is 0 where coverage is not shared
    lane_mask: Ints  # (F, L) int8
    part: Ints  # (F,) int32 the part that the frame is in
    first_node: Ints  # (F,) int64 in that part
    nodes: Ints  # (F,) int16 how many from there on
    slot: tuple[Ints, ...]  # P times (N,) uint8 track * FRAMES + frame
    position: tuple[Ints, ...]  # P times (N, 3) int16 cm

    def __len__(self) -> int:
        """F."""
        return len(self.label)

    def batch(self, frames: Ints) -> dict[str, Any]:
        """The observations of some frames, stacked: what the network reads."""
        tracks = np.zeros((len(frames), SLOTS, 3), np.float32)
        mask = np.zeros((len(frames), SLOTS), np.int8)
        first, last = self.first_node[frames], self.first_node[frames] + self.nodes[frames]
        for row, (part, start, end) in enumerate(zip(self.part[frames], first, last, strict=True)):
            slot = self.slot[part][start:end]
            tracks[row, slot] = CENTIMETRE * self.position[part][start:end]
            mask[row, slot] = 1
        route = np.zeros((len(frames), ROUTE_POINTS, 2), np.float32)
        route[:, WAY_POINTS, 1] = CENTIMETRE * self.aside[frames]
        lanes = {"lanes": self.lanes[frames], "lane_mask": self.lane_mask[frames]} if self.lanes.shape[1] else {}
        return {
            **lanes,
            "tracks": tracks.reshape(-1, OBSERVED_TRACKS, FRAMES, 3),
            "mask": mask.reshape(-1, OBSERVED_TRACKS, FRAMES),
            "command": self.command[frames],
            "ego": self.ego[frames],
            "kind": self.kind[frames],
            "route": route,
        }

    def joined(self, others: "Sequence[GraphFrames]") -> "GraphFrames":
        """These frames and then the others'."""
        all_of = [self, *others]
        ends = np.cumsum([0] + [len(of.slot) for of in all_of])
        return GraphFrames(
            part=np.concatenate([of.part + end for of, end in zip(all_of, ends, strict=False)], dtype=np.int32),
            slot=tuple(slot for of in all_of for slot in of.slot),
            position=tuple(position for of in all_of for position in of.position),
            **{name: np.concatenate([getattr(of, name) for of in all_of]) for name in _PARTS},
        )


@dataclass(frozen=True)
class SeenGraph:
    """What is kept of one observation."""

    slot: Ints  # (n,) uint8
    position: Ints  # (n, 3) int16 cm
    command: Ints  # (6,) int8
    ego: Floats  # (4,) float32
    kind: Ints  # (K,) int8
    aside: Ints  # (W,) int16 cm
    lanes: LaneView  # of no lanes where coverage is not shared


@dataclass(frozen=True)
class StGraphSpec(SpecDefaults):
    """`policies.stgraph.network`, which reads the observation as it is."""

    name: str = "stgraph"
    config_type: type = StGraphConfig

    def build(self, config: StGraphConfig, seed: int) -> nn.Module:
        """A new network."""
        return StGraphNet(config, seed)

    def environment(self, network: nn.Module) -> dict[str, Any]:
        """Coverage, where the network is to know what nobody vouches for."""
        return self.looked_with(network.config)

    def looked_with(self, config: Any) -> dict[str, Any]:
        """Whether frames hold lanes."""
        return {"coverage": True} if config.coverage else {}

    def look(self, simulation: Simulation, observation: Observation) -> SeenGraph:
        """The nodes of the observed graph."""
        slot = np.flatnonzero(observation["mask"].reshape(-1))
        position = observation["tracks"].reshape(-1, 3)[slot]
        rounded = np.rint(position / CENTIMETRE).astype(np.int16)
        aside = np.rint(observation["route"][list(WAY_POINTS), 1] / CENTIMETRE).astype(np.int16)
        command, ego, kind = (observation[name] for name in ("command", "ego", "kind"))
        return SeenGraph(slot.astype(np.uint8), rounded, command, ego, kind, aside, _lanes_in(observation))

    def frames(self, looks: Sequence[SeenGraph], labels: Sequence[int]) -> GraphFrames:
        """All graphs in one record."""
        return GraphFrames(
            label=np.array(labels, np.int8),
            command=np.array([seen.command for seen in looks], np.int8),
            ego=np.array([seen.ego for seen in looks], np.float32),
            kind=np.array([seen.kind for seen in looks], np.int8),
            aside=np.array([seen.aside for seen in looks], np.int16),
            lanes=np.array([seen.lanes.lanes for seen in looks], np.float32),
            lane_mask=np.array([seen.lanes.lane_mask for seen in looks], np.int8),
            part=np.zeros(len(looks), np.int32),
            first_node=np.cumsum([0] + [len(seen.slot) for seen in looks[:-1]]).astype(np.int64),
            nodes=np.array([len(seen.slot) for seen in looks], np.int16),
            slot=(np.concatenate([seen.slot for seen in looks]),),
            position=(np.concatenate([seen.position for seen in looks]),),
        )

    def logits(self, network: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Fused where it can be."""
        assert isinstance(network, StGraphNet)
        return fused_logits(network, batch)

    def policy(self, network: nn.Module, threshold: float) -> StGraphPolicy:
        """The network as it is now."""
        assert isinstance(network, StGraphNet)
        return StGraphPolicy(network, threshold)


def _lanes_in(observation: Observation) -> LaneView:
    if "lanes" not in observation:
        return _NO_LANES
    return LaneView(observation["lanes"], observation["lane_mask"])


SPEC = StGraphSpec()
