"""What "to the last bit" means: digests of whole episodes, of tiny trainings and of a scored run.

They are of one kind of processor, since compilers and libraries order sums differently for another one.

python -m tests.goldens.compute      writes those of this kind of processor; a change of them belongs in CHANGELOG.md
"""

import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import llvmlite.binding
import numpy as np
import torch

import evaluate
from cad_env.envs.single import CADEnv
from cad_env.lidar.config import CloudConfig
from cad_env.scenarios import SHIPPED
from policies.registry import spec_named
from policies.training import ppo
from policies.training.config import TrainingConfig
from policies.training.dagger import train_network

HERE = Path(__file__).parent
TRAFFIC, RADIOS = ("none", "light", "dense"), ("none", "dsrc", "ideal")
NETWORKS = ("stgraph", "command", "point_transformer", "compressed")
# What a step says of itself; a new key of info may be added without a new golden.
STEP_INFO = (
    "hazard", "hazard_time", "speed", "outcome", "min_ttc", "struck_from_behind", "bytes_sent", "bytes_received",
    "largest_message",
    "messages_sent", "messages_lost", "refused",
)  # fmt: skip
SCORED = ("always-go", "planner-own", "planner-shared", "cautious-own", "expert", "stgraph", "stgraph-own")


def processor() -> str:
    """The kind of processor: what compilers here make code for."""
    return f"{llvmlite.binding.get_host_cpu_name()}-{torch.backends.cpu.get_cpu_capability().lower()}"


def stored(name: str = "") -> Path:
    """The file of a kind of processor, by default of this one."""
    return HERE / f"{name or processor()}.json"


def episode(steps: int = 300, **options: Any) -> str:
    """Digest of all that an agent is given in one episode, which it drives by chance."""
    env, found = CADEnv(**options), hashlib.sha256()
    rng = np.random.default_rng(5)
    observation, info = env.reset(seed=2_000_000, options={"hazard": True})
    for _ in range(steps):
        for name, part in observation.items():
            found.update(f"{name} {part.dtype} {part.shape}".encode() + part.tobytes())
        found.update(repr([info[name] for name in STEP_INFO]).encode())
        if info["outcome"] is not None:
            break
        observation, reward, _, _, info = env.step(int(rng.random() < 0.2))
        found.update(repr(float(reward)).encode())
    return found.hexdigest()[:16]


def weights(folder: Path) -> str:
    """Digest of the weights of a model."""
    return hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest()[:16]


def trained(network: str, folder: Path) -> str:
    """Digest of a network that has learned for a moment, with dagger_rounds, on two scenarios."""
    spec = spec_named(network)
    config = TrainingConfig(
        scenarios=SHIPPED[:2], radio="ideal", episodes=6, dagger_rounds=1, dagger_episodes=1, steps=6,
        segments=2, validation=1, final_validation=1, thresholds=(0.5,), batch=8, spec=spec.name,
        network=spec.config_type(),
    )  # fmt: skip
    train_network(config, folder, lambda done: None)
    return weights(folder)


def trained_by_reward(folder: Path) -> str:
    """Digest of the network of PPO after two small updates."""
    bare = ppo.PpoConfig(
        batch=16, reward="progress", hold=1, go_bias=0.0, learning_rate=1e-3, final_rate=1.0, entropy=0.005, epochs=4,
        critic_parts=0, validation=0,
    )  # fmt: skip
    with mock.patch.multiple(ppo, SCENES_AT_ONCE=4, ROLLOUT=8, PART=32):
        ppo.train_ppo(folder, 64, scenarios=("left_turn",), config=bare)
    return weights(folder)


def scored(folder: Path) -> str:
    """Digest of the values of an `episodes.jsonl`: its keys may be renamed."""
    words = ["--method", *SCORED, "--episodes", "3", "--no-report", "--out", str(folder)]
    assert evaluate.main(words) == 0
    lines = (folder / "episodes.jsonl").read_text().splitlines()
    return hashlib.sha256(repr([list(json.loads(line).values()) for line in lines]).encode()).hexdigest()[:16]


def goldens() -> Iterator[tuple[str, Callable[[Path], str]]]:
    """Every golden by its name, as a function of an empty folder."""
    for scenario in SHIPPED:
        for traffic in TRAFFIC:
            for radio in RADIOS:
                options = {"scenario": scenario, "traffic": traffic, "radio": radio}
                yield f"episode {scenario} {traffic} {radio}", lambda _, options=options: episode(**options)
        points = {"scenario": scenario, "radio": "ideal", "cloud": CloudConfig()}
        yield f"episode {scenario} points", lambda _, points=points: episode(20, **points)
    for network in NETWORKS:
        yield f"training {network}", lambda folder, network=network: trained(network, folder)
    yield "training ppo", trained_by_reward
    yield "episodes.jsonl", scored


def main() -> None:
    """Write the goldens of this kind of processor."""
    torch.set_num_threads(1)
    found = {}
    for name, compute in goldens():
        with tempfile.TemporaryDirectory() as folder:
            found[name] = compute(Path(folder) / "new")
        print(name, found[name], flush=True)
    stored().write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
