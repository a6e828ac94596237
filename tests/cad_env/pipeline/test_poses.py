"""What vehicles know of their poses: each error has its size, its time and its own chance."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import started, steps

from cad_env.config import POSE_PRESETS, PoseConfig
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, Floats

ALL_BUT_EXACT = [name for name in POSE_PRESETS if name != "exact"]
# All of the machinery, and next to no errors.
TINY = PoseConfig(scale=1e-12)


def wrapped(angle: Floats) -> Floats:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def errors(pose: str | PoseConfig, seeds: range, count: int) -> tuple[Floats, Floats, Floats]:
    """(n, 3) errors of all fixes along the axes of the first heading, (n, 2) what is stated, (n, 3) those of places."""
    fix, stated, place = [], [], []
    for seed in seeds:
        simulation = started(seed, pose=pose)
        for _ in steps(simulation, count):
            fleet, world = simulation.fleet, simulation.world
            for v, row in enumerate(fleet.rows):
                truth = np.array([*world.position[row], world.heading[row]])
                if fleet.poses.fixes[v]:
                    fix.append(fleet.poses.fix[v] - truth)
                    stated.append(fleet.poses.accuracy[v].copy())
                place.append(fleet.poses.place[v] - truth)
    return np.array(fix), np.array(stated), np.array(place)


def test_without_errors_odometry_is_the_way_and_fix_and_place_are_the_pose() -> None:
    simulation = started(1, pose=TINY)
    start = np.array([*simulation.world.position[0], simulation.world.heading[0]])
    for _ in steps(simulation, 80):
        truth = np.array([*simulation.world.position[0], simulation.world.heading[0]])
        cos, sin = math.cos(start[2]), math.sin(start[2])
        dx, dy = (truth - start)[:2]
        away = [dx * cos + dy * sin, dy * cos - dx * sin, truth[2] - start[2]]
        assert simulation.fleet.trail[0, -1] == pytest.approx(away, abs=1e-9)
        assert simulation.fleet.poses.fix[0] == pytest.approx(truth, abs=1e-9)
        assert simulation.fleet.poses.place[0] == pytest.approx(
            truth, abs=5e-3
        )  # place_on_route is exact to some millimetres


def test_a_place_is_off_along_the_way_only() -> None:
    simulation = started(0, pose=replace(TINY, bias=3.0))
    off = []
    for _ in steps(simulation, 60):
        heading, row = simulation.world.heading[0], simulation.fleet.poses.place[0]
        dx, dy = row[:2] - simulation.world.position[0]
        off.append([dx * math.cos(heading) + dy * math.sin(heading), dy * math.cos(heading) - dx * math.sin(heading)])
    along, beside = np.abs(off).T
    assert along.max() > 0.5
    assert beside[:20].max() < 0.05


@pytest.mark.parametrize("name", ["rtk", "white", "standard", "urban"])
def test_a_fix_is_as_accurate_as_it_states(name: str) -> None:
    fix, stated, _ = errors(name, range(30), 40)
    assert 0.6 < math.sqrt(np.mean((fix[:, :2] / stated[:, :1]) ** 2)) < 1.3
    assert 0.6 < math.sqrt(np.mean((wrapped(fix[:, 2]) / stated[:, 1]) ** 2)) < 1.3


def test_a_bias_lasts_as_long_as_its_time_constant() -> None:
    remembers, forgets = (
        errors(replace(TINY, bias=2.0, bias_time=seconds), range(12), 100)[0] for seconds in (1e4, 0.1)
    )
    assert np.abs(np.diff(remembers[::3, 0])).mean() < np.abs(np.diff(forgets[::3, 0])).mean()


def test_outages_take_their_share_and_last() -> None:
    config, out = PoseConfig(outage=0.3, outage_time=2.0), []
    for seed in range(60):
        simulation = started(seed, pose=config)
        out.append(np.array([simulation.fleet.poses.out.copy() for _ in steps(simulation, 100)]))
    assert abs(np.mean(np.concatenate([episode.ravel() for episode in out])) - 0.3) < 0.05
    ends = sum((episode[:-1] > episode[1:]).sum() for episode in out) / sum(episode[:-1].sum() for episode in out)
    assert 0.1 / ends == pytest.approx(2.0, rel=0.2)


def test_who_is_denied_has_no_fix_and_still_a_place() -> None:
    simulation = started(2, pose="denied")
    for _ in steps(simulation, 40):
        assert (simulation.fleet.poses.fixes == 0).all()
        assert np.linalg.norm(simulation.fleet.poses.place[0, :2] - simulation.world.position[0]) < 5.0
    assert (simulation.fleet.relations.stated[0, 1:, 6] == 0.0).all()


def series(pose: PoseConfig, seed: int = 4) -> list[Simulation]:
    simulation = started(seed, pose=pose, radio="none")
    return [
        np.concatenate([simulation.fleet.trail[0, -1], simulation.fleet.poses.fix[0]]) for _ in steps(simulation, 30)
    ]


def test_each_error_has_numbers_of_its_own() -> None:
    base = PoseConfig(bias=1.0, scale=0.01, yaw_rate=0.001)
    usual = np.array(series(base))
    assert (np.array(series(replace(base, start=9.0))) == usual).all()
    noisy = np.array(series(replace(base, noise=1.0, yaw_noise=0.1, yaw_bias=0.1)))
    assert (noisy[:, :3] == usual[:, :3]).all()  # odometry knows nothing of the fixes
    twice = np.array(series(replace(base, bias=2.0)))
    truth = np.array(series(replace(base, bias=0.0, scale=1e-12, yaw_rate=0.0)))[:, 3:5]
    assert twice[:, 3:5] - truth == pytest.approx(2.0 * (usual[:, 3:5] - truth), abs=1e-6)


@pytest.mark.parametrize("name", ALL_BUT_EXACT)
def test_poses_do_not_move_the_traffic(name: str) -> None:
    here, there = started(7), started(7, pose=name)
    for _ in zip(steps(here, 50, lambda agent: BRAKE), steps(there, 50, lambda agent: BRAKE), strict=True):
        assert here.world.position.tobytes() == there.world.position.tobytes()
        assert here.fleet.visible.tobytes() == there.fleet.visible.tobytes()
