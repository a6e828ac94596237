"""How fast is it, next to highway-env's own intersection? One core, one run, everything interleaved, CPU time.

python benchmarks/speed.py --json speed.json --plot growth.png

Each repeat measures every figure once, the peers' among them, so that whatever else the machine does meets all alike;
a figure is the median of the repeats. Only stepping is timed: episodes end and are reset off the clock, but in the
vector environment, which resets by itself.
"""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import tyro
from decision import Decisions
from growth import as_figures, growth, plot
from processes import memory_figures, startup_figures, work_figures
from simulators import simulators
from stages import FOUR, Stages
from stepping import AGENTS_PEER_ID, IDLE, PEER_ID, Measured, World, parallel, peer, single, vector
from table import tabled
from tqdm import tqdm
from training import Training

import cad_env

ENV_ID = "CADLeftTurn-v0"
SCENES = (1, 64, 256)  # of the vector environment
Note = Callable[[str, float], None]


@dataclass(frozen=True)
class Settings:
    """Measure the speed of cad_env beside highway-env's intersections, on one core."""

    repeats: int = 7
    """times every figure is measured; the median counts"""
    steps: int = 2000
    """steps of each of our environments in a repeat; the peers take a tenth of them"""
    json: Path | None = None
    """file that the figures are also written to"""
    plot: Path | None = None
    """file that the cost is drawn to, as vehicles, connected vehicles and scenes grow in number"""
    startup: bool = True
    """also measure cold compilation and the start-up of the commands, about a minute"""
    work: bool = True
    """also score 500 episodes and record 1,000, about a minute"""

    def __post_init__(self) -> None:
        if self.repeats < 1 or self.steps < 100:
            raise ValueError(f"repeats must be at least 1 and steps at least 100, got {self.repeats} and {self.steps}")


class Bench:
    """Every environment that is measured, made once."""

    def __init__(self, settings: Settings) -> None:
        self.steps = settings.steps
        self.peers = {hz: peer(hz) for hz in (10, 20)}
        self.crowds = {count: peer(10, AGENTS_PEER_ID, controlled_vehicles=count) for count in (2, 4)}  # 2: its default
        self.env = gym.make(ENV_ID, ranges=FOUR)
        self.agents = cad_env.parallel_env(ENV_ID, ranges=FOUR)
        mode = "vector_entry_point"
        self.vectors = {n: gym.make_vec(ENV_ID, num_envs=n, vectorization_mode=mode, ranges=FOUR) for n in SCENES}
        self.world, self.stages = World(), Stages()
        self.decisions, self.training = Decisions(), Training()
        # Whatever has to be compiled.
        single(self.env, cad_env.GO, 100, 0), parallel(self.agents, 100, 0), self.world.stepped(100, 0)

    def repeat(self, seed: int, note: Note) -> None:
        """Measure everything once."""
        few = self.steps // 10
        rates = {hz: single(other, IDLE, few, seed) for hz, other in self.peers.items()}
        together = {n: single(other, (IDLE,) * n, few, seed).rate for n, other in self.crowds.items()}
        ours = single(self.env, cad_env.GO, self.steps, seed)
        everyone = parallel(self.agents, self.steps, seed).rate
        self._peers(rates, together, note)
        note("env.step, ego + 3 collaborators (1/s)", ours.rate)
        note("  our vehicles at the end of an episode", ours.vehicles / ours.steps)
        note("env.step over peer at 10 Hz", ours.rate / rates[10].rate)
        note("env.step over peer at 20 Hz, as we simulate", ours.rate / rates[20].rate)
        for scenes, env in self.vectors.items():
            note(f"vector env, {scenes} scenes (1/s)", vector(env, 5 * self.steps, seed).rate)
        note("parallel env, 4 agents (1/s)", everyone)
        note("parallel env over peer's multi-agent env", everyone / together[2])
        note("parallel env over peer's with 4 agents", everyone / together[4])
        note("reset (ms)", 1e3 * ours.resetting / ours.resets)
        bare = self.world.stepped(20 * self.steps, seed)
        note("world step, 12 vehicles, 64 scenes (1/s)", bare.rate)
        note("  of 12 vehicles, on the map after 8 s", bare.vehicles / bare.steps)
        self._parts(1e6 / ours.rate, note)
        for further in (self.decisions.measured(seed), self.training.measured(seed), simulators(self.steps)):
            for name, value in further.items():
                note(name, value)

    def _peers(self, rates: dict[int, Measured], together: dict[int, float], note: Note) -> None:
        note(f"peer {PEER_ID}, simulation at 10 Hz (1/s)", rates[10].rate)
        note(f"peer {PEER_ID}, simulation at 20 Hz (1/s)", rates[20].rate)
        note("peer reset, simulation at 10 Hz (ms)", 1e3 * rates[10].resetting / rates[10].resets)
        note("  peer vehicles at the end of an episode", rates[10].vehicles / rates[10].steps)
        for count, rate in together.items():
            note(f"peer {AGENTS_PEER_ID}, {count} agents (1/s)", rate)

    def _parts(self, step: float, note: Note) -> None:
        parts = self.stages.measured()
        for name, cost in parts.items():
            note(f"  of a step: {name} (us)", cost)
        note("  of a step: Python around them (us)", step - sum(parts.values()))
        note("  a whole step (us)", step)


def stepping_figures(settings: Settings) -> dict[str, list[float]]:
    """Every figure of a running environment, once per repeat."""
    bench, figures = Bench(settings), dict[str, list[float]]()
    for repeat in tqdm(range(settings.repeats), desc="repeats", disable=None):
        bench.repeat(1000 * repeat, lambda name, value: figures.setdefault(name, []).append(value))
    return figures


def main(settings: Settings) -> None:
    """Measure, print, and keep."""
    further = work_figures() if settings.work else {}  # first, for it takes two processes
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # one core, and the same one throughout
    figures = {**stepping_figures(settings), **memory_figures()}
    if settings.startup:
        figures.update(startup_figures())
    if settings.plot is not None:
        curves = growth()
        figures.update(as_figures(curves))
        plot(curves, settings.plot)
    rows = tabled({**figures, **further})
    if settings.json is not None:
        settings.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Settings))
