"""Open loop: the expert drives, and at every frame a method is asked what it would do.

The episodes are held out: their seeds, from 800,000 on, are neither learned from the expert nor scored in closed loop.
(PPO draws its episodes from all seeds below 900,000, so that one in 9,000 of them is among a hundred of these.) The
world is the same for every method, because the expert drives it by the truth; what is sent and seen is the
method's own.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from baselines.evaluation.job import job_of
from baselines.evaluation.settings import HAZARDS, Settings
from baselines.methods import Method
from cad_env.checks import ConfigError
from cad_env.envs.vector import CADVectorEnv
from cad_env.files import MOST_DATA_BYTES, FileError, read_json_object, replace_text, shortened
from cad_env.rules.expert import expert_of
from cad_env.scoring.rollout import BatchPolicy, rollouts
from cad_env.scoring.scorecard import is_count
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, Floats, Ints, Observation, Policy

FIRST_SEED = 800_000  # validation begins at 900,000 and scoring at a million
_ABREAST = 8  # episodes side by side, and how many an answer is asked for at once
AT_ONCE = 256  # frames that a policy is asked in one go


@dataclass(frozen=True)
class OpenEpisode:
    """What the expert did and what the method would have done, frame by frame; "1" is BRAKE."""

    seed: int
    hazard: bool
    labels: str  # of the expert, a digit a frame
    answers: str  # of the method
    brake_probability: tuple[float, ...] | None  # a frame; None for a method that has none
    messages: int  # sent by all connected vehicles
    bytes: int  # of all of them
    largest: int  # bytes

    def __post_init__(self) -> None:
        scores = self.brake_probability
        frames = len(self.labels) if isinstance(self.labels, str) else 0
        sound = {
            "seed": type(self.seed) is int and self.seed >= 0,
            "hazard": isinstance(self.hazard, bool),
            "labels": isinstance(self.labels, str) and set(self.labels) <= {"0", "1"} and frames > 0,
            "answers": isinstance(self.answers, str)
            and set(self.answers) <= {"0", "1"}
            and len(self.answers) == frames,
            "brake_probability": scores is None
            or (len(scores) == frames and all(type(p) in (int, float) and 0 <= p <= 1 for p in scores)),
            **{name: is_count(getattr(self, name)) for name in ("messages", "bytes", "largest")},
        }
        for name, valid in sound.items():
            if not valid:
                value = shortened(repr(getattr(self, name)))
                raise ConfigError(f"an open-loop episode cannot have {name} {value}")

    def counts(self) -> tuple[int, int, int, int]:
        """Frames: brake as the expert, brake where it goes, go where it brakes, go as the expert."""
        pairs = list(zip(self.answers, self.labels, strict=True))
        return pairs.count(("1", "1")), pairs.count(("1", "0")), pairs.count(("0", "1")), pairs.count(("0", "0"))


@dataclass(frozen=True)
class OpenLoop:
    """A method in the held-out episodes of a scenario."""

    scenario: str
    method: str
    radio: str  # by the name of its preset
    episodes: tuple[OpenEpisode, ...]
    made_with: str = ""  # digest of all that the answers depend on: settings, model and code of the scenes


def measure(method: Method, settings: Settings, scenario: str, seeds: Sequence[int]) -> OpenLoop:
    """Ask a method in the expert's episodes of these seeds. ValueError for models that are not there."""
    job = job_of(settings, scenario, method.name)
    # Who has a memory and must be asked at once is asked in one episode after the other.
    alone = job.policy.privileged and not isinstance(job.policy, BatchPolicy)
    envs = CADVectorEnv(1 if alone else min(_ABREAST, len(seeds)), **job.options)
    found: list[OpenEpisode] = []
    for start in range(0, len(seeds), _ABREAST):  # so many episodes of observations are held at a time
        found += _asked(job.policy, envs, seeds[start : start + _ABREAST], HAZARDS[settings.hazard])
    return OpenLoop(scenario, method.name, job.radio, tuple(found))


def _asked(policy: Policy, envs: CADVectorEnv, seeds: Sequence[int], hazard: bool | None) -> list[OpenEpisode]:
    labels: dict[int, list[int]] = {seed: [] for seed in seeds}
    seen: dict[int, list[Observation]] = {seed: [] for seed in seeds}
    told: dict[int, list[int]] = {seed: [] for seed in seeds}  # at once: the truth does not stay as it is

    def watch(simulation: Simulation, observation: Observation, action: int) -> None:
        first = not labels[simulation.seed]
        labels[simulation.seed].append(action)
        if policy.privileged:
            if first:
                policy.reset(simulation.seed)
            told[simulation.seed].append(policy.act(simulation.truth()))
        else:
            seen[simulation.seed].append(observation)

    driven = {
        episode.seed: episode
        for episode in rollouts(
            envs, expert_of(envs.batch.simulations[0].setup.scenario), seeds, hazard=hazard, watch=watch
        )
    }
    found = []
    for seed in seeds:
        episode = driven[seed]
        answers, scores = (np.array(told[seed]), None) if policy.privileged else answers_of(policy, seen[seed], seed)
        found.append(
            OpenEpisode(
                seed, episode.hazard, _digits(np.array(labels[seed])), _digits(answers),
                None if scores is None else tuple(np.round(scores, 6).tolist()),
                int(episode.messages_sent.sum()), int(episode.bytes_sent.sum()), int(episode.largest_message.max()),
            )
        )  # fmt: skip
    return found


def answers_of(policy: Policy, seen: Sequence[Observation], seed: int) -> tuple[Ints, Floats | None]:
    """What a policy decides at each frame of an episode, (n,), and P(brake), (n,), if it says so."""
    policy.reset(seed)
    if not isinstance(policy, BatchPolicy):
        return np.array([policy.act(observation) for observation in seen]), None
    answers, scores = [], []
    for start in range(0, len(seen), AT_ONCE):
        part = seen[start : start + AT_ONCE]
        batch = {name: np.stack([observation[name] for observation in part]) for name in part[0]}
        if hasattr(policy, "brake_probability") and hasattr(policy, "threshold"):
            scores.append(policy.brake_probability(batch))
            answers.append((scores[-1] >= policy.threshold).astype(np.int64))  # as it decides: one pass is enough
        else:
            answers.append(policy.act_batch(batch))
    return np.concatenate(answers), np.concatenate(scores) if scores else None


def _digits(decisions: Ints) -> str:
    return "".join("1" if decision == BRAKE else "0" for decision in decisions)


def at_threshold(loop: OpenLoop, threshold: float) -> OpenLoop:
    """What the method would have answered with another threshold. ValueError for one that has no P(brake)."""
    episodes = []
    for episode in loop.episodes:
        if episode.brake_probability is None:
            raise ValueError(f"{loop.method} gives no P(brake), so there is nothing to compare with a threshold")
        answers = _digits((np.array(episode.brake_probability) >= threshold).astype(np.int64))
        episodes.append(replace(episode, answers=answers))
    return replace(loop, episodes=tuple(episodes))


NAMES = ("scenario", "method", "radio", "made_with")  # of an OpenLoop
_KEYS = tuple(field.name for field in fields(OpenEpisode))


def open_path(folder: Path, training_seed: int, scenario: str, method: str) -> Path:
    """The file of these answers in the folder of a run."""
    return folder / "open" / str(training_seed) / f"{scenario}_{method}.json"


def write_open_loop(path: Path, found: OpenLoop) -> None:
    """Write it, all or nothing, and make its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    episodes = ",\n".join(json.dumps(asdict(episode), allow_nan=False) for episode in found.episodes)
    head = json.dumps({name: getattr(found, name) for name in NAMES})[:-1]
    replace_text(path, f'{head}, "episodes": [\n{episodes}\n]}}\n')


def read_open_loop(path: Path) -> OpenLoop:
    """Read it; FileError, one line, if it is missing or damaged."""
    data = read_json_object(path, MOST_DATA_BYTES)
    try:
        return _parsed(data)
    except ConfigError as error:
        raise FileError(path, error) from None


def _parsed(data: dict[str, Any]) -> OpenLoop:
    if "episodes" in data and "made_with" not in data:
        raise ConfigError("it is of an older format, without its model and settings: delete it")
    if set(data) != {*NAMES, "episodes"}:
        raise ConfigError(f"it must have the keys {', '.join(NAMES)}, episodes")
    names, lines = [data[name] for name in NAMES], data["episodes"]
    if not all(isinstance(name, str) for name in names) or not isinstance(lines, list) or not lines:
        raise ConfigError(f"{', '.join(NAMES)} must be names, and episodes a list of at least one")
    episodes = []
    for line in lines:
        if not isinstance(line, dict) or set(line) != set(_KEYS):
            raise ConfigError(f"an open-loop episode must have the keys {', '.join(_KEYS)}")
        scores = line["brake_probability"]
        if scores is not None and not isinstance(scores, list):
            raise ConfigError("brake_probability must be a list or null")
        episodes.append(OpenEpisode(**{**line, "brake_probability": None if scores is None else tuple(scores)}))
    scenario, method, radio, made_with = names
    return OpenLoop(scenario, method, radio, tuple(episodes), made_with)
