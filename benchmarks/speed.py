"""How fast is it, next to highway-env's own intersection? One core, one run, everything interleaved, CPU time.

python benchmarks/speed.py --json speed.json

Each repeat measures every figure once, the peer's among them, so that whatever else the machine does meets all alike;
a figure is the median of the repeats. Only stepping is timed: episodes end and are reset off the clock.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  registers the peer
import numpy as np
import tyro
from stages import Stages
from tqdm import tqdm

import cad_env
from cad_env.scenarios import scenario_named
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import place
from cad_env.world.state import OFF
from cad_env.world.step import advance

ROOT = Path(__file__).resolve().parent.parent
ENV_ID, PEER_ID = "CADLeftTurn-v0", "intersection-v0"
AGENTS_PEER_ID = "intersection-multi-agent-v0"
FOUR = {"collaborators": (3, 3)}  # the ego and exactly three more
IDLE = 1  # the peer's "keep lane and speed"
EPISODE = 80  # steps of the bare world between two scenes: 8 s, about an episode
VEHICLES = 12

BARS = {  # figure -> (least or most, bar)
    "world step, 12 vehicles (1/s)": ("least", 50_000.0),
    "env.step, ego + 3 collaborators (1/s)": ("least", 3_000.0),
    "env.step over peer at 10 Hz": ("least", 15.0),
    "parallel env, 4 agents (1/s)": ("least", 6_000.0),
    "parallel env over peer's multi-agent env": ("least", 50.0),
    "reset (ms)": ("most", 2.0),
}


@dataclass(frozen=True)
class Settings:
    """Measure the speed of cad_env beside highway-env's intersection-v0, on one core."""

    repeats: int = 7
    """times every figure is measured; the median counts"""
    steps: int = 2000
    """steps of each of our environments in a repeat; the peer takes a tenth of them"""
    json: Path | None = None
    """file that the figures are also written to"""
    startup: bool = True
    """also measure cold compilation and the start-up of the commands, about a minute"""

    def __post_init__(self) -> None:
        if self.repeats < 1 or self.steps < 100:
            raise ValueError(f"repeats must be at least 1 and steps at least 100, got {self.repeats} and {self.steps}")


@dataclass
class Measured:
    """Steps and resets of one repeat, and the CPU time they took, s."""

    steps: int = 0
    stepping: float = 0.0
    resets: int = 0
    resetting: float = 0.0
    vehicles: int = 0  # summed over the steps

    @property
    def rate(self) -> float:
        """Steps a second."""
        return self.steps / self.stepping


def single(env: gym.Env[Any, Any], action: Any, steps: int, first_seed: int) -> Measured:
    """Step a Gymnasium environment, a new seed whenever an episode ends."""
    result = Measured()
    while result.steps < steps:
        start = time.process_time()
        env.reset(seed=first_seed + result.resets)
        reset = time.process_time()
        over, taken = False, 0
        while not over and result.steps + taken < steps:
            _, _, terminated, truncated, _ = env.step(action)
            over, taken = terminated or truncated, taken + 1
        result.stepping += time.process_time() - reset
        result.resetting += reset - start
        result.resets, result.steps = result.resets + 1, result.steps + taken
        result.vehicles += taken * len(env.unwrapped.road.vehicles)  # as many as at the end of the episode
    return result


def parallel(env: Any, steps: int, first_seed: int) -> Measured:
    """Step the multi-agent environment while all its agents are there."""
    result = Measured()
    while result.steps < steps:
        env.reset(seed=first_seed + result.resets)
        everyone, actions = len(env.agents), dict.fromkeys(env.agents, cad_env.GO)
        start, taken = time.process_time(), 0
        while len(env.agents) == everyone and result.steps + taken < steps:
            env.step(actions)
            taken += 1
        result.stepping += time.process_time() - start
        result.resets, result.steps = result.resets + 1, result.steps + taken
    return result


def world(steps: int, first_seed: int) -> Measured:
    """Step the bare world: drivers, motion and contact of twelve vehicles."""
    scenario = scenario_named("left_turn")
    ranges, dense = scenario.configured({}), Traffic("dense")
    routes, agents, actions = scenario.map.routes, np.array([0]), np.array([cad_env.GO])
    scratch = np.zeros(VEHICLES)
    result = Measured()
    while result.steps < steps:
        scene = scenario.scene(ranges, dense, first_seed + result.resets, hazard=True)
        state = place(replace(scene, placements=scene.placements[:VEHICLES]), routes)
        start = time.process_time()
        for _ in range(EPISODE):
            advance(state, routes, agents, actions, scratch)
        result.stepping += time.process_time() - start
        result.resets, result.steps = result.resets + 1, result.steps + EPISODE
        result.vehicles += EPISODE * int((state.driver != OFF).sum())
    return result


def peer(simulation_hz: int, env_id: str = PEER_ID, **config: Any) -> gym.Env[Any, Any]:
    """highway-env's own intersection, deciding at 10 Hz as ours does."""
    gym.logger.min_level = gym.logger.ERROR  # that there is a v2 of it is known; v0 is the faster one
    return gym.make(env_id, config={"policy_frequency": 10, "simulation_frequency": simulation_hz, **config})


def stepping_figures(settings: Settings) -> dict[str, list[float]]:
    """Every figure of a running environment, once per repeat."""
    peers = {hz: peer(hz) for hz in (10, 20)}
    crowds = {count: peer(10, AGENTS_PEER_ID, controlled_vehicles=count) for count in (2, 4)}  # 2 is its default
    env = gym.make(ENV_ID, ranges=FOUR)
    agents = cad_env.parallel_env(ENV_ID, ranges=FOUR)
    stages = Stages()
    few = settings.steps // 10
    figures: dict[str, list[float]] = {}

    def note(name: str, value: float) -> None:
        figures.setdefault(name, []).append(value)

    single(env, cad_env.GO, 100, 0), parallel(agents, 100, 0), world(100, 0)  # whatever has to be compiled
    for repeat in tqdm(range(settings.repeats), desc="repeats", disable=None):
        seed = 1000 * repeat
        rates = {hz: single(other, IDLE, few, seed) for hz, other in peers.items()}
        together = {count: single(other, (IDLE,) * count, few, seed).rate for count, other in crowds.items()}
        ours = single(env, cad_env.GO, settings.steps, seed)
        everyone = parallel(agents, settings.steps, seed)
        bare = world(20 * settings.steps, seed)
        note(f"peer {PEER_ID}, simulation at 10 Hz (1/s)", rates[10].rate)
        note(f"peer {PEER_ID}, simulation at 20 Hz (1/s)", rates[20].rate)
        note("peer reset, simulation at 10 Hz (ms)", 1e3 * rates[10].resetting / rates[10].resets)
        note("  peer vehicles at the end of an episode", rates[10].vehicles / rates[10].steps)
        note("world step, 12 vehicles (1/s)", bare.rate)
        note("  of 12 vehicles, on the map after 8 s", bare.vehicles / bare.steps)
        note("env.step, ego + 3 collaborators (1/s)", ours.rate)
        note("  our vehicles at the end of an episode", ours.vehicles / ours.steps)
        note("env.step over peer at 10 Hz", ours.rate / rates[10].rate)
        note("env.step over peer at 20 Hz, as we simulate", ours.rate / rates[20].rate)
        for count, rate in together.items():
            note(f"peer {AGENTS_PEER_ID}, {count} agents (1/s)", rate)
        note("parallel env, 4 agents (1/s)", everyone.rate)
        note("parallel env over peer's multi-agent env", everyone.rate / together[2])
        note("parallel env over peer's with 4 agents", everyone.rate / together[4])
        note("reset (ms)", 1e3 * ours.resetting / ours.resets)
        step, parts = 1e6 / ours.rate, {"world": 1e6 / bare.rate, **stages.measured()}
        for name, cost in parts.items():
            note(f"  of a step: {name} (us)", cost)
        note("  of a step: Python around them (us)", step - sum(parts.values()))
        note("  a whole step (us)", step)
    return figures


COLD = f"""
import time, gymnasium as gym, cad_env
env = gym.make({ENV_ID!r})
env.reset(seed=0)
env.step(0)
print(time.process_time())
"""


def startup_figures() -> dict[str, list[float]]:
    """Seconds until the first step, with nothing compiled and with everything, and until a command's help."""
    figures: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        for name in ("cold: import to first step, CPU (s)", "warm: import to first step, CPU (s)"):
            done = _run(["-c", COLD], environment)
            figures[name] = [float(done.stdout)]
    for command in ("train.py", "evaluate.py"):
        if (ROOT / command).exists():
            figures[f"{command} --help, wall (s)"] = [_wall(lambda c=command: _run([c, "--help"])) for _ in range(3)]
    return figures


def _run(arguments: list[str], environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)


def _wall(act: Callable[[], object]) -> float:
    start = time.perf_counter()
    act()
    return time.perf_counter() - start


def verdict(name: str, value: float) -> str:
    """What the table says about the bar of a figure."""
    if name not in BARS:
        return ""
    sense, bar = BARS[name]
    met = value >= bar if sense == "least" else value <= bar
    return f"at {sense} {bar:,g}: {'met' if met else 'NOT MET'}"


def tabled(figures: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    """Print the table; the same numbers as a record."""
    rows = {}
    print(f"{'figure':50} {'median':>10} {'least':>10} {'most':>10}  bar")
    for name, values in figures.items():
        middle = statistics.median(values)
        rows[name.strip()] = {"median": middle, "least": min(values), "most": max(values)}
        numbers = " ".join(
            f"{x:10,.0f}" if abs(x) >= 1000 else f"{x:10.3g}" for x in (middle, min(values), max(values))
        )
        print(f"{name:50} {numbers}  {verdict(name, middle)}".rstrip())
    return rows


def main(settings: Settings) -> None:
    """Measure, print, and keep."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # one core, and the same one throughout
    figures = stepping_figures(settings)
    if settings.startup:
        figures.update(startup_figures())
    rows = tabled(figures)
    if settings.json is not None:
        settings.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Settings))
