"""What the expert would do, frame by frame: recorded in shards, split by episode, read back as training batches.

A frame keeps only the nodes of its graph and not the padded window, so 10^5 frames take tens of megabytes. Whoever
drives, the label is the expert's: recording a learned driver gives the data of a DAgger round.
"""

import io
import json
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cad_env.env import CADEnv
from cad_env.files import replace_file
from cad_env.planner import Expert
from cad_env.rollout import rollouts
from cad_env.simulation import Simulation
from cad_env.types import FRAMES, OBSERVED_TRACKS, Floats, Ints, Observation, Policy
from cad_env.vector import CADVectorEnv

SHARD_EPISODES = 64
FORMAT = 1
_ARRAYS = ("seed", "label", "command", "ego", "kind", "first_node", "slot", "position")


class ShardError(ValueError):
    """A shard that cannot be used; one line with the file and the reason."""


@dataclass(frozen=True)
class Frames:
    """F labelled frames of whole episodes; the nodes of frame f are first_node[f] to first_node[f + 1]."""

    seed: Ints  # (F,) int64 of the episode
    label: Ints  # (F,) int8 what the expert would do
    command: Ints  # (F, 6) int8
    ego: Floats  # (F, 4) float32
    kind: Ints  # (F, K) int8
    first_node: Ints  # (F + 1,) int64
    slot: Ints  # (N,) int16 track * FRAMES + frame
    position: Floats  # (N, 3) float32 m

    def __len__(self) -> int:
        return len(self.label)

    def batch(self, frames: Ints) -> Observation:
        """The observations of some frames, stacked: what the network reads."""
        count = self.first_node[frames + 1] - self.first_node[frames]
        row = np.repeat(np.arange(len(frames)), count)
        node = np.arange(len(row)) + np.repeat(self.first_node[frames] - np.cumsum(count) + count, count)
        tracks = np.zeros((len(frames), OBSERVED_TRACKS * FRAMES, 3), np.float32)
        mask = np.zeros((len(frames), OBSERVED_TRACKS * FRAMES), np.int8)
        tracks[row, self.slot[node]] = self.position[node]
        mask[row, self.slot[node]] = 1
        return {
            "tracks": tracks.reshape(-1, OBSERVED_TRACKS, FRAMES, 3),
            "mask": mask.reshape(-1, OBSERVED_TRACKS, FRAMES),
            "command": self.command[frames],
            "ego": self.ego[frames],
            "kind": self.kind[frames],
        }


def frames_of(observations: Sequence[Observation], labels: Sequence[int], seeds: Sequence[int]) -> Frames:
    """The compact form of a list of observations."""
    masks = [np.flatnonzero(seen["mask"].reshape(-1)) for seen in observations]
    nodes = [seen["tracks"].reshape(-1, 3)[slots] for seen, slots in zip(observations, masks, strict=True)]
    return Frames(
        seed=np.array(seeds, np.int64),
        label=np.array(labels, np.int8),
        command=np.array([seen["command"] for seen in observations], np.int8),
        ego=np.array([seen["ego"] for seen in observations], np.float32),
        kind=np.array([seen["kind"] for seen in observations], np.int8),
        first_node=np.concatenate([[0], np.cumsum([len(slots) for slots in masks])]).astype(np.int64),
        slot=np.concatenate(masks).astype(np.int16),
        position=np.concatenate(nodes).astype(np.float32),
    )


def join(parts: Sequence[Frames]) -> Frames:
    """All frames of several recordings."""
    if len(parts) == 1:
        return parts[0]
    ends = np.cumsum([0] + [part.first_node[-1] for part in parts])
    first = [part.first_node[:-1] + end for part, end in zip(parts, ends, strict=False)]
    whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS if name != "first_node"}
    return Frames(first_node=np.concatenate([*first, ends[-1:]]), **whole)


def record(
    folder: Path,
    envs: CADVectorEnv | Sequence[CADEnv],
    driver: Policy,
    seeds: Sequence[int],
    advance: Callable[[int], object],
) -> Frames:
    """Drive an episode per seed, label every frame by the expert, and keep the shards that are already there.

    `advance` is told how many episodes were finished. Raises ShardError for a shard that is damaged or another's.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for start in range(0, len(seeds), SHARD_EPISODES):
        wanted = list(seeds[start : start + SHARD_EPISODES])
        path = folder / f"shard_{start // SHARD_EPISODES:05d}.npz"
        if not path.exists():
            write_shard(path, _drive(envs, driver, wanted))
        part = read_shard(path)
        if set(np.unique(part.seed)) != set(wanted):
            raise ShardError(f"{path}: holds other episodes than this run records; give another folder or delete it")
        parts.append(part)
        advance(len(wanted))
    return join(parts)


def _drive(envs: CADVectorEnv | Sequence[CADEnv], driver: Policy, seeds: Sequence[int]) -> Frames:
    expert = driver if isinstance(driver, Expert) else Expert()
    seen: list[Observation] = []
    labels: list[int] = []
    owner: list[int] = []

    def watch(simulation: Simulation, observation: Observation, action: int) -> None:
        seen.append(observation)
        labels.append(action if driver is expert else expert.act(simulation.truth()))
        owner.append(simulation.seed)

    for _ in rollouts(envs, driver, seeds, watch=watch):
        pass
    # In the order of the seeds, however many scenes were driven side by side.
    turn = {seed: number for number, seed in enumerate(seeds)}
    order = sorted(range(len(owner)), key=lambda frame: turn[owner[frame]])
    return frames_of([seen[k] for k in order], [labels[k] for k in order], [owner[k] for k in order])


def write_shard(path: Path, frames: Frames) -> None:
    """Write a shard whole or not at all."""
    meta = json.dumps({"format": FORMAT, "frames": len(frames)})
    archive = io.BytesIO()
    np.savez_compressed(archive, meta=np.array(meta), **{name: getattr(frames, name) for name in _ARRAYS})
    replace_file(path, archive.getvalue())


def read_shard(path: Path) -> Frames:
    """Read a shard back; ShardError for one that is missing, truncated, altered or of another format."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            meta = json.loads(str(archive["meta"]))
            frames = Frames(**{name: archive[name] for name in _ARRAYS})
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise ShardError(f"{path}: not a readable shard ({str(error) or type(error).__name__})") from None
    if meta != {"format": FORMAT, "frames": len(frames)}:
        raise ShardError(f"{path}: format or length is not what this version wrote: {meta}")
    _check(path, frames)
    return frames


def _check(path: Path, frames: Frames) -> None:
    """The zip's own checksums find flipped bits; this finds a shard that was put together wrongly."""
    count, nodes = len(frames), len(frames.slot)
    sound = (
        frames.seed.shape == (count,)
        and frames.command.shape[:1] == frames.ego.shape[:1] == frames.kind.shape[:1] == (count,)
        and frames.first_node.shape == (count + 1,)
        and frames.first_node[0] == 0
        and frames.first_node[-1] == nodes
        and bool((np.diff(frames.first_node) >= 0).all())
        and frames.position.shape == (nodes, 3)
        and bool(np.isfinite(frames.position).all())
        and bool(((frames.slot >= 0) & (frames.slot < OBSERVED_TRACKS * FRAMES)).all())
        and bool(np.isin(frames.label, (0, 1)).all())
    )
    if not sound:
        raise ShardError(f"{path}: its arrays do not fit together")
