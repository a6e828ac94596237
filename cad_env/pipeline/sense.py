"""Truth -> detections of one vehicle: range, line of sight, misses and noise. No identity passes this line."""

import math
from typing import NamedTuple

import numpy as np

from cad_env.chance import normals_and_uniform
from cad_env.compiled import compiled
from cad_env.config import SensorConfig
from cad_env.types import ROWS, STEP, TRUCK, Bools, Detections, Floats, Ints
from cad_env.world.geometry import box_hides
from cad_env.world.state import OFF, World

# A roof sensor near the front: it sees along a truck's flank instead of its own roof.
MOUNT = 0.4  # of the length, ahead of the centre
CENTRE_HEIGHT = (0.75, 1.75)  # m above the road of a car's and a truck's centre
_GNSS = 1 << 20  # counter that no target row reaches: the vehicle's own fix


class Sensing(NamedTuple):
    """A SensorConfig as compiled code sees it."""

    range: float
    noise: float
    miss: float
    gnss_noise: float
    gnss_yaw_noise: float


def sensing(config: SensorConfig) -> Sensing:
    """The compiled stages' view of a sensor configuration."""
    return Sensing(
        float(config.range), float(config.noise), float(config.miss),
        float(config.gnss_noise), float(config.gnss_yaw_noise),
    )  # fmt: skip


@compiled
def can_see(world: World, observer: int, target: int, reach: float) -> bool:
    """True if the observer's sensor has a free line, within reach, to one of five points of the target."""
    position, heading, size = world.position, world.heading, world.size
    ahead = MOUNT * size[observer, 0]
    x0 = position[observer, 0] + ahead * math.cos(heading[observer])
    y0 = position[observer, 1] + ahead * math.sin(heading[observer])
    cos, sin = math.cos(heading[target]), math.sin(heading[target])
    for forward, left in ((0.0, 0.0), (0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)):
        along, across = forward * size[target, 0], left * size[target, 1]
        x1 = position[target, 0] + along * cos - across * sin
        y1 = position[target, 1] + along * sin + across * cos
        if (x1 - x0) ** 2 + (y1 - y0) ** 2 > reach * reach:
            continue
        if not _hidden(world, observer, target, x0, y0, x1, y1):
            return True
    return False


@compiled
def _hidden(world: World, observer: int, target: int, x0: float, y0: float, x1: float, y1: float) -> bool:
    for k in range(world.heading.shape[0]):
        if k in (observer, target) or world.driver[k] == OFF:
            continue
        if box_hides(
            x0, y0, x1, y1, world.position[k, 0], world.position[k, 1],
            world.heading[k], world.size[k, 0], world.size[k, 1],
        ):  # fmt: skip
            return True
    return False


@compiled
def fix_pose(world: World, observer: int, sensor: Sensing, key: Ints, step: int, pose: Floats) -> None:
    """Write where the observer's GNSS places it to pose (3,): x, y (m), heading (rad)."""
    pose[0], pose[1] = world.position[observer, 0], world.position[observer, 1]
    pose[2] = world.heading[observer]
    if sensor.gnss_noise > 0.0 or sensor.gnss_yaw_noise > 0.0:
        east, north, _ = normals_and_uniform(key, step, observer, _GNSS, 0)
        turn, _, _ = normals_and_uniform(key, step, observer, _GNSS, 1)
        pose[0] += sensor.gnss_noise * east
        pose[1] += sensor.gnss_noise * north
        pose[2] += sensor.gnss_yaw_noise * turn


@compiled
def sense(world: World, observer: int, sensor: Sensing, key: Ints, step: int, pose: Floats,
          position: Floats, kind: Ints, visible: Bools) -> int:  # fmt: skip
    """Fill position (ROWS, 3) and kind (ROWS,) with what the observer detects; return how many.

    Detections are placed in the world by the observer's own fix `pose`, so its errors are theirs.
    visible (N,): what had a line of sight, reported or not; for tests and drawings, never passed on.
    """
    found = 0
    # The rotation by which a wrong heading fix turns everything that is placed relative to it.
    wrong = pose[2] - world.heading[observer]
    cos, sin = math.cos(wrong), math.sin(wrong)
    for target in range(world.heading.shape[0]):
        visible[target] = False
        if target == observer or world.driver[target] == OFF:
            continue
        dx = world.position[target, 0] - world.position[observer, 0]
        dy = world.position[target, 1] - world.position[observer, 1]
        if math.hypot(dx, dy) > sensor.range + 20.0 or not can_see(world, observer, target, sensor.range):
            continue
        visible[target] = True
        east, north, lucky = normals_and_uniform(key, step, observer, target, 0)
        if lucky < sensor.miss or found == ROWS:
            continue
        position[found, 0] = pose[0] + dx * cos - dy * sin + sensor.noise * east
        position[found, 1] = pose[1] + dx * sin + dy * cos + sensor.noise * north
        # The road is flat and known, so the height of a centre carries the class and no noise.
        position[found, 2] = CENTRE_HEIGHT[1] if world.kind[target] == TRUCK else CENTRE_HEIGHT[0]
        kind[found] = world.kind[target]
        found += 1
    return found


def detect(world: World, observer: int, config: SensorConfig, key: Ints, step: int) -> Detections:
    """What one vehicle's sensors report in one frame."""
    pose = np.zeros(3)
    sensor = sensing(config)
    position, kind = np.zeros((ROWS, 3)), np.zeros(ROWS, np.int8)
    fix_pose(world, observer, sensor, key, step, pose)
    visible = np.zeros(len(world.heading), np.bool_)
    found = sense(world, observer, sensor, key, step, pose, position, kind, visible)
    return Detections(step * STEP, position[:found].copy(), kind[:found].copy())
