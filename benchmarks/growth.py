"""What a step costs as vehicles, connected vehicles and scenes grow in number, as figures and as a plot."""

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
from crowd import crowds

VEHICLES = (6, 12, 20, 30, 45, 60)  # with four of them connected
CONNECTED = (1, 2, 4, 8, 12, 16)  # of twenty vehicles
SCENES = (1, 4, 16, 64, 256, 1024)
ABREAST = 16  # scenes that the first two are measured on
STEPS, REPEATS = 40, 5

Curve = dict[int, float]  # how many -> us a step of one scene


def growth() -> dict[str, Curve]:
    """The three curves; a point is the median of several repeats."""
    return {
        "vehicles (4 connected)": {n: _median(lambda n=n: _crowded(n, 4)) for n in VEHICLES},
        "connected (of 20 vehicles)": {n: _median(lambda n=n: _crowded(20, n)) for n in CONNECTED},
        "scenes (vector env, resets included)": {n: _median(_vector(n)) for n in SCENES},
    }


def _median(measure: Callable[[], float]) -> float:
    return statistics.median(measure() for _ in range(REPEATS))


def _crowded(vehicles: int, connected: int) -> float:
    batch, everywhere = crowds(ABREAST, vehicles, connected), np.arange(ABREAST)
    go = np.zeros(ABREAST, np.int64)
    batch.step(everywhere, go)
    start = time.process_time()
    for _ in range(STEPS):
        batch.step(everywhere, go)
    return (time.process_time() - start) / STEPS / ABREAST * 1e6


def _vector(scenes: int) -> Callable[[], float]:
    env = gym.make_vec("CADLeftTurn-v0", num_envs=scenes, vectorization_mode="vector_entry_point")
    env.reset(seed=0)
    go, times = np.zeros(scenes, np.int64), max(STEPS, 4000 // scenes)

    def measure() -> float:
        start = time.process_time()
        for _ in range(times):
            env.step(go)
        return (time.process_time() - start) / times / scenes * 1e6

    measure()  # until the scenes are at different times in their episodes
    return measure


def as_figures(curves: dict[str, Curve]) -> dict[str, list[float]]:
    """Rows of the table."""
    return {f"step with {n} {name} (us)": [cost] for name, curve in curves.items() for n, cost in curve.items()}


def plot(curves: dict[str, Curve], file: Path) -> None:
    """Draw them, a panel each, to a file of any kind that matplotlib writes."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, len(curves), figsize=(11, 3.2), layout="constrained")
    for panel, (name, curve) in zip(panels, curves.items(), strict=True):
        panel.plot(list(curve), list(curve.values()), "o-")
        panel.set(xlabel=name, ylim=(0.0, None))
        panel.grid(alpha=0.3)
        if max(curve) > 100:
            panel.set_xscale("log", base=4)
            panel.set_xticks(list(curve), [f"{n:,}" for n in curve])
    panels[0].set_ylabel("step of one scene, µs")
    figure.savefig(file, dpi=150)
    pyplot.close(figure)
