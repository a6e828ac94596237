"""How fast is a step in every scene and traffic, next to highway-env's own intersection? One core, one run, CPU time.

python benchmarks/scenes.py

The ego and three collaborators, light traffic, and dense traffic with 14 vehicles around the cast. Only stepping is
timed; the median of the repeats, and the ratio to the peer within each.
"""

import statistics
import time
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  registers the peer
import tyro
from tqdm import tqdm

import cad_env
from cad_env.scenarios import SCENARIOS

PEER = "intersection-v0"
KEEP_LANE = 1  # the peer's action
BARS = {"light": 3_000, "dense": 2_000}  # steps a second
FURTHER = 14  # vehicles around the cast that a dense scene must have to be timed


@dataclass(frozen=True)
class Settings:
    """Measure the speed of a step in every scene beside highway-env's intersection-v0, on one core."""

    repeats: int = 5
    steps: int = 1500
    """of each scene in a repeat; the peer takes a tenth of them"""


def rate(env: gym.Env[Any, Any], action: int, steps: int, seed: int) -> float:
    """Steps a second of CPU time, resets left out."""
    taken, stepping = 0, 0.0
    while taken < steps:
        env.reset(seed=seed)
        seed += 1
        if getattr(env.unwrapped, "simulation", None) is not None and not _full(env.unwrapped.simulation):
            continue
        start, over = time.process_time(), False
        while not over and taken < steps:
            _, _, terminated, truncated, _ = env.step(action)
            over, taken = terminated or truncated, taken + 1
        stepping += time.process_time() - start
    return taken / stepping


def _full(simulation: Any) -> bool:
    return simulation.setup.traffic != "dense" or len(simulation.scene.placements) >= FURTHER + 5


def main(settings: Settings) -> None:
    """The table."""
    gym.logger.min_level = gym.logger.ERROR  # that there is a v2 of the peer is known; v0 is the faster one
    peer = gym.make(PEER, config={"policy_frequency": 10, "simulation_frequency": 10})
    envs = {
        (scenario.name, density): gym.make(scenario.gym_id, traffic=density, ranges={"collaborators": (3, 3)})
        for scenario in SCENARIOS.values()
        for density in BARS
    }
    found: dict[Any, list[float]] = {}
    for repeat in tqdm(range(settings.repeats + 1), desc="repeats", disable=None):
        for name, env in {"peer": peer, **envs}.items():
            own = name != "peer"
            steps = settings.steps if own else settings.steps // 10
            measured = rate(env, cad_env.GO if own else KEEP_LANE, steps, 1000 * repeat)
            if repeat > 0:  # the first round compiles
                found.setdefault(name, []).append(measured)
    print(f"{'scene':18} {'traffic':8} {'steps/s':>8} {'least':>8}  {'bar':>6}  over {PEER} at 10 Hz")
    print(f"{'(peer)':18} {'-':8} {statistics.median(found['peer']):8,.0f} {min(found['peer']):8,.0f}")
    for (name, density), rates in ((name, rates) for name, rates in found.items() if name != "peer"):
        ratio = statistics.median(a / b for a, b in zip(rates, found["peer"], strict=True))
        met = "met" if statistics.median(rates) >= BARS[density] else "NOT MET"
        print(
            f"{name:18} {density:8} {statistics.median(rates):8,.0f} {min(rates):8,.0f}  {BARS[density]:6,}  "
            f"{ratio:.1f} times, {met}"
        )


if __name__ == "__main__":
    main(tyro.cli(Settings))
