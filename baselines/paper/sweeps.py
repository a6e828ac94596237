"""What is swept, and over what: each point is a run of evaluate.py with some settings changed.

Budgets and depths are two sweeps, because a radio refuses a message above its budget whole and no sender trims its
graph to fit: with all 15 frames a small budget means that only short messages pass. Fewer frames make every message
smaller, and are what a sender would do.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

COMPARED = ("stgraph", "collab-gat", "compressed")  # whose robustness is shown
GRAPH = ("stgraph",)
SWEPT_EPISODES = 200  # of each scene and method at a point, at least, in a full run


@dataclass(frozen=True)
class SweepPoint:
    """One run; its episodes go to `sweeps/<name>/<value>`."""

    name: str
    value: str  # its folder, and its place on the axis where it is a number
    methods: tuple[str, ...]
    overrides: Mapping[str, Any]  # of baselines.evaluation.settings.Settings

    @property
    def folder(self) -> str:
        """Below the folder of the run."""
        return f"sweeps/{self.name}/{self.value}"

    @property
    def same_world(self) -> bool:
        """Whether the same vehicles drive as without the sweep, so that the expert's times are of the same episodes."""
        return self.overrides.get("traffic") in (None, "light")


@dataclass(frozen=True)
class Sweep:
    """One axis of a plot."""

    name: str
    label: str  # of the axis, with its unit
    points: tuple[SweepPoint, ...]


def _sweep(
    name: str, label: str, values: Sequence[Any], *settings: str, methods: tuple[str, ...] = COMPARED, **fixed: Any
) -> Sweep:
    points = (
        SweepPoint(name, f"{value}", methods, MappingProxyType({**fixed, **dict.fromkeys(settings, value)}))
        for value in values
    )
    return Sweep(name, label, tuple(points))


LOSSES = (0.0, 0.05, 0.2, 0.4, 0.7)
SWEEPS: Mapping[str, Sweep] = MappingProxyType(
    {
        sweep.name: sweep
        for sweep in (
            _sweep("loss", "messages lost, share (each by itself)", LOSSES, "loss"),
            _sweep("bursts", "messages lost, share (5 in a row on average)", LOSSES, "loss", burst=5.0),
            _sweep("delay", "delay of a message, s", (0.0, 0.1, 0.2, 0.3, 0.5), "delay"),
            _sweep(
                "gnss", "GNSS noise, m and degrees", (0.0, 0.25, 0.5, 1.0), "gnss_noise", "gnss_yaw_noise"
            ),
            _sweep("sensor", "sensor noise, m", (0.0, 0.2, 0.4, 0.8), "sensor_noise"),
            _sweep("collaborators", "collaborators", (0, 1, 2, 3, 4), "collaborators"),
            _sweep("traffic", "traffic", ("none", "light", "dense"), "traffic"),
            _sweep(
                "budget", "budget of a sender, bytes in 0.1 s (refused whole above)",
                (64, 128, 192, 256, 384, 512, 768, 1000, 25_000), "budget", methods=GRAPH,
            ),
            _sweep("depth", "newest frames in a message", (1, 2, 3, 5, 8, 15), "depth", methods=GRAPH),
        )
    }
)  # fmt: skip


def points(ends: bool = False) -> Iterator[SweepPoint]:
    """All points of all sweeps, or the two ends of each."""
    for sweep in SWEEPS.values():
        yield from sweep.points[:: len(sweep.points) - 1] if ends else sweep.points
