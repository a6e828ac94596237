"""A made-up run folder, with outcomes by chance, for the tests of the report."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from baselines.paper.folder import TABLE_ORDER
from baselines.paper.open_loop import OpenEpisode, OpenLoop, open_path, write_open_loop
from baselines.paper.sweeps import SWEEPS
from cad_env.scoring.scorecard import Record

SCENES = ("left_turn", "overtaking", "street_crossing")
LEARNED = ("ppo", "gat", "collab-gat", "stgraph-own", "raw-points", "compressed", "stgraph-no-edges", "stgraph-bc",
           "stgraph")  # fmt: skip
SUCCESS = {"always-go": 0.5, "always-brake": 0.0, "planner-own": 0.7, "gat": 0.6, "collab-gat": 0.85,
           "stgraph-own": 0.8, "ppo": 0.7, "raw-points": 0.75, "compressed": 0.8, "cautious-own": 0.95}  # fmt: skip
SIZE = {"planner-shared": 300, "stgraph": 300, "stgraph-no-edges": 300, "stgraph-bc": 310, "ppo": 300, "collab-gat": 80,
        "raw-points": 200_000, "compressed": 33_000}  # fmt: skip


def record(
    scene: str, method: str, seed: int, rng: np.random.Generator, success: float, size: int = 0
) -> Record:  # fmt: skip
    """One episode that succeeds with that probability, of messages of that size; 0 for none."""
    outcome = "success" if rng.random() < success else ("collision" if rng.random() < 0.7 else "timeout")
    time, hazard = round(float(rng.uniform(8.0, 15.0)), 1), seed % 2 == 0
    sent = round(time * 40) if size else 0
    return Record(
        scene, method, seed, hazard, outcome, time, int(rng.integers(0, 4)) if not hazard else 20,
        float(size) if size else None, round(1.7 * size) if size else None, sent, round(0.04 * sent), sent * size,
        round(float(rng.exponential(2.0)), 3), 0.1 if hazard else None, 4, round(float(rng.uniform(0, 6)), 3),
    )  # fmt: skip


def write_episodes(folder: Path, records: Iterable[Record], command: str = "python evaluate.py") -> None:
    """As evaluate.py leaves them."""
    folder.mkdir(parents=True)
    (folder / "settings.json").write_text(json.dumps({"command": command}))
    (folder / "episodes.jsonl").write_text("".join(one.line() + "\n" for one in records))


def write_closed(
    folder: Path, radio: str = "dsrc", training_seeds: int = 3, episodes: int = 60, scenes: Sequence[str] = SCENES
) -> None:
    """Every row in every scene; who is not trained is in training seed 0 only."""
    rng = np.random.default_rng(1)
    for training_seed in range(training_seeds):
        names = [name for name in TABLE_ORDER if name in LEARNED or training_seed == 0]
        records = [
            record(scene, name, seed, rng, SUCCESS.get(name, 0.99), SIZE.get(name, 0))
            for scene in scenes
            for name in names
            for seed in range(1_000_000, 1_000_000 + episodes)
        ]
        write_episodes(folder / "closed" / radio / str(training_seed), records)


def write_open(folder: Path, training_seeds: int = 2, episodes: int = 12, scenes: Sequence[str] = SCENES) -> None:
    """Answers that are right nine times out of ten."""
    rng = np.random.default_rng(2)
    for training_seed in range(training_seeds):
        for scene in scenes:
            for name in LEARNED:
                found = [open_episode(seed, rng, SIZE.get(name, 0)) for seed in range(800_000, 800_000 + episodes)]
                path = open_path(folder, training_seed, scene, name)
                write_open_loop(path, OpenLoop(scene, name, "dsrc", tuple(found)))


def open_episode(seed: int, rng: np.random.Generator, size: int = 300, frames: int = 40) -> OpenEpisode:
    """An episode of so many frames, a quarter of them with a brake."""
    labels = rng.random(frames) < 0.25
    scores = np.clip(labels * 0.8 + 0.1 + rng.normal(0.0, 0.3, frames), 0.0, 1.0)
    digits = ["".join("01"[int(one)] for one in some) for some in (labels, scores >= 0.5)]
    sent = 4 * frames if size else 0
    return OpenEpisode(seed, seed % 2 == 0, *digits, tuple(scores.tolist()), sent, size * sent, 2 * size)


def write_sweeps(folder: Path, episodes: int = 40, scenes: Sequence[str] = SCENES) -> None:
    """Every point; the more it asks of a method, the less it succeeds."""
    rng = np.random.default_rng(3)
    for sweep in SWEEPS.values():
        for place, point in enumerate(sweep.points):
            size = int(40 + 25 * float(point.value)) if sweep.name == "depth" else min(300, 64 * (place + 1))
            records = [
                record(scene, name, seed, rng, 0.99 - 0.1 * place * (name != "stgraph"), size)
                for scene in scenes
                for name in point.methods
                for seed in range(1_000_000, 1_000_000 + episodes)
            ]
            write_episodes(folder / point.folder, records)


def write_run(folder: Path, scenes: Sequence[str] = SCENES, episodes: int = 60) -> Path:
    """All parts."""
    write_closed(folder, episodes=episodes, scenes=scenes)
    write_closed(folder, "ideal", 1, episodes, scenes)
    write_open(folder, scenes=scenes)
    write_sweeps(folder, episodes // 2, scenes)
    (folder / "costs.json").write_text(json.dumps({"stgraph": {"parameters": 2722, "ms": 0.2}}))
    (folder / "notes.md").write_text("Points came out *better* than in the paper.")
    return folder
