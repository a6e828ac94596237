"""The paper's network as a family: frames keep the nodes of their graphs, and a batch is the padded windows again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor, nn

from cad_env.simulation import Simulation
from cad_env.types import FRAMES, OBSERVED_TRACKS, Floats, Ints, Observation
from policies.driver import LearnedPolicy
from policies.fused import fused_logits
from policies.stgraph import StGraphConfig, StGraphNet

SLOTS = OBSERVED_TRACKS * FRAMES
_PARTS = ("seed", "label", "command", "ego", "kind", "slot", "position")


@dataclass(frozen=True)
class GraphFrames:
    """F labelled frames of whole episodes; the nodes of frame f are first_node[f] to first_node[f + 1].

    It keeps only the nodes of a graph and not the padded window, so 10^5 frames take tens of megabytes.
    """

    seed: Ints  # (F,) int64 of the episode
    label: Ints  # (F,) int8 what the expert would do
    command: Ints  # (F, 6) int8
    ego: Floats  # (F, 4) float32
    kind: Ints  # (F, K) int8
    first_node: Ints  # (F + 1,) int64
    slot: Ints  # (N,) uint8 track * FRAMES + frame
    position: Floats  # (N, 3) float32 m

    def __len__(self) -> int:
        """F."""
        return len(self.label)

    def batch(self, frames: Ints) -> dict[str, Any]:
        """The observations of some frames, stacked: what the network reads."""
        count = self.first_node[frames + 1] - self.first_node[frames]
        row = np.repeat(np.arange(len(frames)), count)
        node = np.arange(len(row)) + np.repeat(self.first_node[frames] - np.cumsum(count) + count, count)
        tracks = np.zeros((len(frames), SLOTS, 3), np.float32)
        mask = np.zeros((len(frames), SLOTS), np.int8)
        tracks[row, self.slot[node]] = self.position[node]
        mask[row, self.slot[node]] = 1
        return {
            "tracks": tracks.reshape(-1, OBSERVED_TRACKS, FRAMES, 3),
            "mask": mask.reshape(-1, OBSERVED_TRACKS, FRAMES),
            "command": self.command[frames],
            "ego": self.ego[frames],
            "kind": self.kind[frames],
        }

    def joined(self, others: "Sequence[GraphFrames]") -> "GraphFrames":
        """These frames and then the others'."""
        parts = [self, *others]
        ends = np.cumsum([0] + [part.first_node[-1] for part in parts])
        first = [part.first_node[:-1] + end for part, end in zip(parts, ends, strict=False)]
        whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _PARTS}
        return GraphFrames(first_node=np.concatenate([*first, ends[-1:]]), **whole)


@dataclass(frozen=True)
class Nodes:
    """What is kept of one observation."""

    slot: Ints  # (n,) uint8
    position: Floats  # (n, 3) float32 m
    command: Ints  # (6,) int8
    ego: Floats  # (4,) float32
    kind: Ints  # (K,) int8


@dataclass(frozen=True)
class StGraphFamily:
    """`policies.stgraph`, which reads the observation as it is."""

    name: str = "stgraph"
    config_type: type = StGraphConfig

    def build(self, config: StGraphConfig, seed: int) -> nn.Module:
        """A new network."""
        return StGraphNet(config, seed)

    def environment(self, network: nn.Module) -> dict[str, Any]:
        """Nothing beside what every environment has."""
        return {}

    def look(self, simulation: Simulation, observation: Observation) -> Nodes:
        """The nodes of the observed graph."""
        slot = np.flatnonzero(observation["mask"].reshape(-1))
        position = observation["tracks"].reshape(-1, 3)[slot]
        return Nodes(slot.astype(np.uint8), position, *(observation[name] for name in ("command", "ego", "kind")))

    def frames(self, looks: Sequence[Nodes], labels: Sequence[int], seeds: Sequence[int]) -> GraphFrames:
        """All graphs in one record."""
        return GraphFrames(
            seed=np.array(seeds, np.int64),
            label=np.array(labels, np.int8),
            command=np.array([seen.command for seen in looks], np.int8),
            ego=np.array([seen.ego for seen in looks], np.float32),
            kind=np.array([seen.kind for seen in looks], np.int8),
            first_node=np.concatenate([[0], np.cumsum([len(seen.slot) for seen in looks])]).astype(np.int64),
            slot=np.concatenate([seen.slot for seen in looks]),
            position=np.concatenate([seen.position for seen in looks]),
        )

    def logits(self, network: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Fused where it can be."""
        assert isinstance(network, StGraphNet)
        return fused_logits(network, batch)

    def driver(self, network: nn.Module, threshold: float) -> LearnedPolicy:
        """The network as it is now."""
        assert isinstance(network, StGraphNet)
        return LearnedPolicy(network, threshold)


FAMILY = StGraphFamily()
