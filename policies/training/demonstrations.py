"""What an episode is made of: its seed, what was decided in it, and what the expert would have done.

The traffic is a function of the seed, the settings of the scene and the decisions. So these are enough to replay an
episode, whatever is sensed or shared in it: the same demonstrations serve every network, at a few bytes a frame.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from cad_env.checks import ConfigError
from cad_env.envs.vector import CADVectorEnv
from cad_env.files import FileError, parse_json, shortened
from cad_env.scenarios.registry import outside_sources
from cad_env.scoring.rollout import BatchPolicy, play_episodes
from cad_env.simulation.scene_step import COLLIDED, SUCCEEDED, TIMED_OUT
from cad_env.simulation.setup import Setup
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, GO, Bools, Ints, Observation
from cad_env.version import version
from policies.training.array_file import read_arrays, write_arrays
from policies.training.teacher import Teacher

SHARD_EPISODES = 64
KEPT_EVERY = 1.0  # s, what has ended of a shard is written
FORMAT = 3
_ARRAYS: Mapping[str, type[np.signedinteger[Any]]] = MappingProxyType(
    {"seed": np.int64, "length": np.int64, "outcome": np.int8, "action": np.int8, "label": np.int8}
)

_ENDS = (SUCCEEDED, COLLIDED, TIMED_OUT)

Look = Callable[[Simulation, Observation], Any]


class ReplayError(ValueError):
    """An episode that does not come back as it was recorded."""


@dataclass(frozen=True)
class Demonstrations:
    """E whole episodes of F decisions in all, one after another."""

    seed: Ints  # (E,) int64
    length: Ints  # (E,) int64 decisions of each
    outcome: Ints  # (E,) int8 how each ended, by the numbers of cad_env.simulation.scene_step
    action: Ints  # (F,) int8 what was decided
    label: Ints  # (F,) int8 what the expert would have decided

    def __len__(self) -> int:
        """E."""
        return len(self.seed)

    def in_order(self, seeds: Sequence[int]) -> "Demonstrations":
        """The episodes of these seeds, in this order; KeyError for one that is not there."""
        place = {seed: episode for episode, seed in enumerate(self.seed.tolist())}
        chosen = np.array([place[seed] for seed in seeds], np.int64)
        first = np.cumsum(self.length) - self.length
        frames = np.concatenate(
            [np.arange(first[episode], first[episode] + self.length[episode]) for episode in chosen]
        )
        return Demonstrations(
            self.seed[chosen], self.length[chosen], self.outcome[chosen], self.action[frames], self.label[frames]
        )


def joined(parts: Sequence[Demonstrations]) -> Demonstrations:
    """All episodes of several demonstrations."""
    return Demonstrations(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS})


Driven = Callable[[Sequence[int]], Iterator[Demonstrations]]  # an episode for each seed, as they end


def record(
    folder: Path,
    envs: CADVectorEnv,
    policy: BatchPolicy | None,
    seeds: Sequence[int],
    advance: Callable[[int], object],
    mixing: float = 0.0,
    waits: bool = False,
) -> list[Demonstrations]:
    """Drive an episode per seed, ask the expert in every frame, and keep the shards that are already there.

    `waits`: a teacher takes the expert's place, which also waits for whom nobody vouches for (`Teacher`); what it says
    depends on who senses and sends what, so its episodes are replayed in scenes with the same options.
    Without a policy the expert drives; beside one it takes a share of the decisions, `mixing`. `advance` is told how
    many episodes were finished. Every shard is written whole or not at all, so two processes may record at once; what
    has ended of the next one is kept every second. Raises FileError for a shard that is damaged or of other episodes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    made_with, parts = _made_with(envs.batch.simulations[0].setup, waits), []
    for start in range(0, len(seeds), SHARD_EPISODES):
        wanted = list(seeds[start : start + SHARD_EPISODES])
        path = folder / f"shard_{start // SHARD_EPISODES:05d}.npz"
        begun = path.with_suffix(".begun.npz")
        if not path.exists():
            write_shard(
                path, _completed(begun, made_with, wanted, partial(_drive, envs, policy, mixing, waits)), made_with
            )
        begun.unlink(missing_ok=True)
        part = read_shard(path, made_with)
        if part.seed.tolist() != wanted:
            raise FileError(path, "holds other episodes than this run records; give another folder or delete it")
        parts.append(part)
        advance(len(wanted))
    return parts


def replay(recorded: Demonstrations, envs: CADVectorEnv, look: Look) -> tuple[list[Any], list[int]]:
    """Drive the episodes as they were driven, in whatever is sensed and shared in `envs`.

    What was looked at in every frame and the expert's labels (F,), an episode after another.
    Raises ReplayError for an episode that does not end as it did.
    """
    looks: list[list[Any]] = [[] for _ in recorded.seed]
    first = np.cumsum(recorded.length) - recorded.length

    def decide(which: Ints, episodes: Ints) -> Ints:
        at = np.array([len(looks[episode]) for episode in episodes])
        if (at >= recorded.length[episodes]).any():
            raise _unlike(recorded, int(episodes[at >= recorded.length[episodes]][0]))
        for place, episode in zip(which.tolist(), episodes.tolist(), strict=True):
            looks[episode].append(look(envs.batch.simulations[place], envs.batch.observation(place)))
        action: Ints = recorded.action[first[episodes] + at].astype(np.int64)
        return action

    outcome = np.zeros(len(recorded), np.int8)
    for episode, place in play_episodes(envs.batch, recorded.seed.tolist(), decide):
        outcome[episode] = envs.batch.outcomes[place]
    length = np.array([len(of) for of in looks])
    if unlike := np.flatnonzero((outcome != recorded.outcome) | (length != recorded.length)).tolist():
        raise _unlike(recorded, unlike[0])
    return [seen for of in looks for seen in of], recorded.label.tolist()


def _unlike(recorded: Demonstrations, episode: int) -> ReplayError:
    return ReplayError(f"episode {recorded.seed[episode]} does not end as it was recorded: other settings or scenes")


def _completed(begun: Path, made_with: Mapping[str, Any], seeds: list[int], driven: Driven) -> Demonstrations:
    """The episodes of a shard, in their order; those that are in the file `begun` are not driven again."""
    known: list[Demonstrations] = []
    if begun.exists():
        try:
            known = [read_shard(begun, made_with)]
        except FileError:
            if begun.exists():
                raise  # else another process has just finished this shard
    there = {seed for part in known for seed in part.seed.tolist()}
    written = time.monotonic()
    for episode in driven([seed for seed in seeds if seed not in there]):
        known.append(episode)
        if time.monotonic() - written > KEPT_EVERY:
            known = [joined(known)]
            write_shard(begun, known[0], made_with)
            written = time.monotonic()
    return joined(known).in_order(seeds)


def _drive(
    envs: CADVectorEnv, policy: BatchPolicy | None, mixing: float, waits: bool, seeds: Sequence[int]
) -> Iterator[Demonstrations]:
    """One episode after another, as they end."""
    batch = envs.batch
    teacher = Teacher(batch, waits)
    actions: list[list[int]] = [[] for _ in seeds]
    labels: list[list[int]] = [[] for _ in seeds]
    rng = [np.random.default_rng([seed, 1]) for seed in seeds]

    def decide(which: Ints, episodes: Ints) -> Ints:
        label = teacher.labels(which)
        action = label
        if policy is not None:
            seen = {name: part[which] for name, part in batch.observations.items()}
            helped: Bools = np.array([rng[episode].random() < mixing for episode in episodes])
            action = np.where(helped, label, policy.act_batch(seen))
        for episode, chosen, right in zip(episodes.tolist(), action.tolist(), label.tolist(), strict=True):
            actions[episode].append(chosen)
            labels[episode].append(right)
        return action

    for episode, place in play_episodes(batch, seeds, decide):
        yield Demonstrations(
            np.array([seeds[episode]], np.int64), np.array([len(actions[episode])], np.int64),
            batch.outcomes[[place]].astype(np.int8), np.array(actions[episode], np.int8),
            np.array(labels[episode], np.int8),
        )  # fmt: skip


def scenes_of(setup: Setup) -> dict[str, Any]:
    """All that an episode depends on beside its seed and its decisions: who senses and sends what is not among it."""
    ranges = {name: list(value) if isinstance(value, tuple) else value for name, value in setup.ranges.items()}
    return {
        "scenario": setup.scenario, "ranges": ranges, "traffic": setup.traffic,
        "penetration": setup.penetration, "version of cad_env": version(), **outside_sources(setup.scenario),
    }  # fmt: skip


def _made_with(setup: Setup, waits: bool) -> dict[str, Any]:
    """All that a shard depends on beside its seeds and the policy that drives."""
    if not waits:
        return scenes_of(setup)
    heard = {"radio": asdict(setup.radio), "sensor": asdict(setup.sensor), "depth": setup.depth}
    return {**scenes_of(setup), "waits over": heard}


def write_shard(path: Path, recorded: Demonstrations, made_with: Mapping[str, Any]) -> None:
    """Write a shard whole or not at all."""
    about = json.dumps({"format": FORMAT, "episodes": len(recorded), **made_with})
    write_arrays(path, about, {name: getattr(recorded, name) for name in _ARRAYS})


def read_shard(path: Path, made_with: Mapping[str, Any]) -> Demonstrations:
    """Read a shard back; FileError for one that is missing, damaged, or made with something else."""
    about, arrays = read_arrays(path)
    found = _about(path, about)
    recorded = _checked(path, arrays)
    wanted = json.loads(json.dumps({"format": FORMAT, "episodes": len(recorded), **made_with}))
    for name, value in wanted.items():
        if found.get(name) != value:
            was = shortened(repr(found.get(name)))
            raise FileError(path, f"has {name} {was}, not {value!r}: delete it to record anew")
    return recorded


def _about(path: Path, text: str) -> dict[str, Any]:
    """What a shard says it was made with."""
    try:
        found = parse_json(text)
    except ConfigError as error:
        raise FileError(path, f"its text: {error}") from None
    if not isinstance(found, dict):
        raise FileError(path, f"its text must be a JSON object, got {type(found).__name__}")
    return found


def _checked(path: Path, arrays: Mapping[str, Any]) -> Demonstrations:
    """The checksum finds flipped bits; this finds a shard that was put together wrongly."""
    if set(arrays) != set(_ARRAYS):
        raise FileError(path, f"must hold the arrays {', '.join(_ARRAYS)}, got {', '.join(map(shortened, arrays))}")
    for name, array in arrays.items():
        if array.ndim != 1 or array.dtype != _ARRAYS[name]:
            wanted = f"a row of {_ARRAYS[name].__name__}"
            raise FileError(path, f"{name} must be {wanted}, got {array.dtype} of shape {array.shape}")
    recorded = Demonstrations(**arrays)
    count, frames = len(recorded), len(recorded.action)
    whole = bool(((recorded.length > 0) & (recorded.length <= frames)).all())  # so that their sum cannot overflow
    sound = {
        "seed": bool((recorded.seed >= 0).all()) and len(set(recorded.seed.tolist())) == count,
        "length": whole and len(recorded.length) == count and int(recorded.length.sum()) == frames,
        "outcome": len(recorded.outcome) == count and bool(np.isin(recorded.outcome, _ENDS).all()),
        "action": bool(np.isin(recorded.action, (GO, BRAKE)).all()),
        "label": len(recorded.label) == frames and bool(np.isin(recorded.label, (GO, BRAKE)).all()),
    }
    if wrong := [name for name, right in sound.items() if not right]:
        raise FileError(path, f"its arrays do not fit together, or {wrong[0]} holds what cannot be")
    return recorded
