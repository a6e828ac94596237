"""How far off what others say is placed, by what vehicles know of their poses and by how a receiver places a sender.

python -m baselines.evaluation.placement --episodes 300 --out results/placement
python -m baselines.evaluation.placement --pose 0 0.5 1 1.5 2 3 --out results/placement_sweep    against the error

The expert drives, so that all ways of placing meet the same worlds. Errors are taken in the frame of the ego's own
body: what its own place on the map is off counts elsewhere.

said      a node of a sender, newest frame, where the receiver takes it to be, against where the sender means
merged    a node of the merged graph, newest frame, against the nearest vehicle
"""

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from baselines.cli import parsed, refused, say, stopped
from baselines.evaluation.settings import ALL_SCENARIOS, scenarios_chosen
from cad_env.checks import check_path, check_range, check_seed, check_several, check_text, settle
from cad_env.config import PLACINGS, POSE_PRESETS, PoseConfig, pose_config
from cad_env.files import replace_file
from cad_env.numerics.rigid import between, compose, from_to
from cad_env.pipeline.register import PLACED
from cad_env.rules.expert import expert_of
from cad_env.scoring.table import text_table
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import FRAMES, GO, Floats
from cad_env.version import version
from cad_env.world.state import OFF

FAR_OFF = 2.5  # m
_TITLES = ("scenario", "pose", "placing", "episodes", "said: median m", "rms m", "95th pct m", "> 2.5 m %",
           "abstained %", "merged: rms m", "> 2.5 m %")  # fmt: skip


@dataclass(frozen=True)
class PlacementSettings:
    """Measure how far off what others say is placed."""

    scenario: tuple[str, ...] = ALL_SCENARIOS  # names of scenarios, or all that ship
    pose: tuple[str, ...] = tuple(POSE_PRESETS)  # presets, or a bias in m (and as many degrees)
    placing: tuple[str, ...] = PLACINGS  # fixes, nearest, single, registered
    episodes: int = 300  # of each
    first_seed: int = 1_000_000  # training never uses seeds from a million on
    out: Path = Path("results/placement")  # folder for placement.json and placement.md

    def __post_init__(self) -> None:
        for what in ("scenario", "pose", "placing"):
            settle(self, what, check_several(what, getattr(self, what), check_text))
        settle(self, "episodes", int(check_range("episodes", self.episodes, 1, 1_000_000)))
        settle(self, "first_seed", check_seed("first-seed", self.first_seed))
        settle(self, "out", check_path("out", self.out))
        for pose, placing in product(self.pose, self.placing):
            posed(pose, placing)
        self.scenarios()

    def scenarios(self) -> tuple[str, ...]:
        """The names of the scenarios, in the order of the table."""
        return scenarios_chosen(self.scenario)


@dataclass(frozen=True)
class PlacementRow:
    """A row of the table; None where nothing was placed."""

    scenario: str
    pose: str
    placing: str
    episodes: int
    said_median: float | None  # m
    said_rms: float | None  # m
    said_95: float | None  # m
    said_far_off: float | None  # share of the nodes that are more than FAR_OFF off
    abstained: float | None  # share of the senders and steps in which a sender that has been heard is not placed
    merged_rms: float | None  # m
    merged_far_off: float | None


def posed(name: str, placing: str) -> PoseConfig:
    """A preset, or a bias in m with as many degrees, with a way of placing.

    >>> posed("1.5", "single").bias, posed("urban", "fixes").placing
    (1.5, 'fixes')
    """
    try:
        bias = float(name)
    except ValueError:
        return replace(pose_config(name), placing=placing)
    return replace(pose_config("standard"), bias=bias, yaw_bias=math.radians(bias), placing=placing)


@dataclass
class _Errors:
    said: list[float]  # m
    merged: list[float]  # m
    heard: int = 0
    placed: int = 0


def measured(scenario: str, pose: str, placing: str, seeds: Sequence[int]) -> PlacementRow:
    """One row: the episodes of these seeds, driven by the expert."""
    simulation, expert = (
        Simulation(setup_from({"scenario": scenario, "pose": posed(pose, placing)})),
        expert_of(scenario),
    )
    errors = _Errors([], [])
    for seed in seeds:
        expert.reset(seed)
        simulation.start(seed, receivers=1)
        while simulation.outcome() is None:
            actions = np.full(len(simulation.agents), GO)
            actions[0] = expert.act(simulation.truth())
            simulation.step(actions)
            _note(simulation, errors)
    return _row(scenario, pose, placing, len(seeds), errors)


def _note(simulation: Simulation, errors: _Errors) -> None:
    """Note the errors of the newest step."""
    fleet = simulation.fleet
    errors.merged += _merged_errors(simulation)
    for v in range(1, len(simulation.agents) if len(fleet.relations.state) else 1):
        if fleet.kept.used[0, v] == 0:
            continue
        errors.heard += 1
        if fleet.relations.state[0, v] == PLACED:
            errors.placed += 1
            errors.said += _said_errors(simulation, v)


def _pose(simulation: Simulation, v: int) -> tuple[float, float, float]:
    row = simulation.agents[v]
    x, y = simulation.world.position[row].tolist()
    return x, y, simulation.world.heading[row].item()


def _said_errors(simulation: Simulation, v: int) -> Iterator[float]:
    """m, of the newest nodes of sender v; both its odometry and the receiver's are taken from the newest frame."""
    fleet = simulation.fleet
    relations, kept = fleet.relations, fleet.kept
    found = from_to(tuple(relations.body[0, v]), tuple(relations.there[0, v]))
    own, its = (tuple(fleet.trail[k, FRAMES - 1]) for k in (0, v))
    meant = compose(from_to(_pose(simulation, 0), own), from_to(its, _pose(simulation, v)))
    for i in np.flatnonzero(kept.mask[0, v, : kept.used[0, v, 0], -1]):
        if kept.track[0, v, i] != relations.me[0, v]:
            node = (*kept.position[0, v, i, -1, :2].tolist(), 0.0)
            one, other = compose(found, node), compose(meant, node)
            yield math.hypot(one[0] - other[0], one[1] - other[1])


def _merged_errors(simulation: Simulation) -> list[float]:
    """m, of the newest nodes of the ego's merged graph."""
    fleet, world = simulation.fleet, simulation.world
    count = fleet.merged.used[0, 0]
    nodes = fleet.merged.position[0, :count, -1, :2][fleet.merged.mask[0, :count, -1]]
    others = np.flatnonzero(world.driver != OFF)
    others = others[others != simulation.agents[0]]
    if len(nodes) == 0 or len(others) == 0:
        return []
    truth, own = _pose(simulation, 0), tuple(fleet.trail[0, FRAMES - 1])
    there = _seen_from(world.position[others], truth)
    apart = np.linalg.norm(_seen_from(nodes, own)[:, None] - there[None], axis=-1)
    nearest: list[float] = apart.min(axis=1).tolist()
    return nearest


def _seen_from(points: Floats, pose: tuple[float, float, float]) -> Floats:
    """Points (n, 2) in the frame of a pose."""
    return np.array([between(pose, (x, y, 0.0))[:2] for x, y in points.tolist()]).reshape(-1, 2)


def _row(scenario: str, pose: str, placing: str, episodes: int, errors: _Errors) -> PlacementRow:
    said, merged = np.array(errors.said), np.array(errors.merged)
    abstained = 1.0 - errors.placed / errors.heard if errors.heard else None
    return PlacementRow(
        scenario, pose, placing, episodes, _of(said, np.median), _of(said, _rms),
        _of(said, lambda errors: np.quantile(errors, 0.95)), _of(said, _far_off), abstained, _of(merged, _rms),
        _of(merged, _far_off),
    )  # fmt: skip


def _rms(errors: Floats) -> Any:
    return np.sqrt(np.mean(errors**2))


def _far_off(errors: Floats) -> Any:
    return np.mean(errors > FAR_OFF)


def _of(errors: Floats, what: Any) -> float | None:
    return round(float(what(errors)), 4) if len(errors) else None


def rows_of(settings: PlacementSettings) -> Iterator[PlacementRow]:
    """Row by row; exact poses are placed in one way only."""
    seeds = range(settings.first_seed, settings.first_seed + settings.episodes)
    for scenario, pose, placing in product(settings.scenarios(), settings.pose, settings.placing):
        if not posed(pose, placing).exact or placing == settings.placing[-1]:
            yield measured(scenario, pose, placing, seeds)


def placement_table(rows: Sequence[PlacementRow]) -> str:
    """The rows as text."""

    def metres(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f}"

    def share(value: float | None) -> str:
        return "-" if value is None else f"{100.0 * value:.2f}"

    cells = [
        (row.scenario, row.pose, row.placing, str(row.episodes), metres(row.said_median), metres(row.said_rms),
         metres(row.said_95), share(row.said_far_off), share(row.abstained), metres(row.merged_rms),
         share(row.merged_far_off))
        for row in rows
    ]  # fmt: skip
    return text_table(_TITLES, cells)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    try:
        settings = parsed(PlacementSettings, argv)
        rows = list(rows_of(settings))
        settings.out.mkdir(parents=True, exist_ok=True)
        noted = {"version of cad_env": version(), "rows": [asdict(row) for row in rows]}
        replace_file(settings.out / "placement.json", (json.dumps(noted, indent=1) + "\n").encode())
        replace_file(settings.out / "placement.md", f"```\n{placement_table(rows)}\n```\n".encode())
    except (ValueError, OSError) as error:
        return refused(error)
    except KeyboardInterrupt as error:
        return stopped(error)
    say(placement_table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
