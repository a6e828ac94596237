"""Truth -> detections of one vehicle: range, line of sight, misses and noise. No identity passes this line."""

import math
from typing import NamedTuple

from cad_env.config import SensorConfig
from cad_env.numerics.jit import compiled, inlined, inlined_part
from cad_env.numerics.philox import normals_and_uniform, uniform
from cad_env.types import CAR, MAX_TRACKS, TRUCK, Bools, Floats, Ints
from cad_env.world.geometry import box_hides, within
from cad_env.world.state import OFF, World

# A roof sensor near the front: it sees along a truck's flank instead of its own roof.
MOUNT = 0.4  # of the length, ahead of the centre
CENTRE_HEIGHT = (0.75, 1.75)  # m above the road of a car's and a truck's centre
SURELY = 0.01  # m, by which a box must be too far from a line of sight to be left out unasked
_POINTS = ((0.0, 0.0), (0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5))  # of a target, lengths and widths from it
_DETECTION, _FALSE_ALARM, _CLASS, _CORNER = range(4)  # last counters: each error has numbers of its own
_GNSS = 1 << 20  # counter that no target row reaches: the vehicle's own fix


class Sensing(NamedTuple):
    """A SensorConfig as compiled code sees it."""

    range: float
    noise: float
    miss: float
    gnss_noise: float
    gnss_yaw_noise: float
    false_alarm: float
    partial: float
    class_error: float


def sensing(config: SensorConfig) -> Sensing:
    """The compiled stages' view of a sensor configuration."""
    return Sensing(
        float(config.range), float(config.noise), float(config.miss),
        float(config.gnss_noise), float(config.gnss_yaw_noise), float(config.false_alarm), float(config.partial),
        float(config.class_error),
    )  # fmt: skip


@compiled
def outline(world: World, outlines: Floats) -> None:
    """Write of every vehicle what all lines of sight ask for: outlines (N, 3), cos and sin of its heading, radius m."""
    for k in range(outlines.shape[0]):
        outlines[k, 0], outlines[k, 1] = math.cos(world.heading[k]), math.sin(world.heading[k])
        outlines[k, 2] = 0.5 * math.hypot(world.size[k, 0], world.size[k, 1])


@inlined
def can_see(world: World, outlines: Floats, observer: int, target: int, reach: float, near: Ints) -> bool:
    """True if the observer's sensor has a free line, within reach, to one of five points of the target.

    outlines (N, 3) as from `outline`; near (N,) is scratch.
    """
    position, size = world.position, world.size
    ahead = MOUNT * size[observer, 0]
    x0 = position[observer, 0] + ahead * outlines[observer, 0]
    y0 = position[observer, 1] + ahead * outlines[observer, 1]
    cos, sin = outlines[target, 0], outlines[target, 1]
    count = _near_line(world, outlines, observer, target, x0, y0, near)
    for forward, left in _POINTS:
        along, across = forward * size[target, 0], left * size[target, 1]
        x1 = position[target, 0] + along * cos - across * sin
        y1 = position[target, 1] + along * sin + across * cos
        if (x1 - x0) ** 2 + (y1 - y0) ** 2 > reach * reach:
            continue
        if not _hidden(world, outlines, near, count, x0, y0, x1, y1):
            return True
    return False


@inlined_part
def _seen_middle(
    world: World, outlines: Floats, observer: int, target: int, reach: float, near: Ints
) -> tuple[float, float]:
    """(x, y) m from the centre of a target to the middle of those of its points that are seen, of which there are."""
    position, size = world.position, world.size
    ahead, cos, sin = MOUNT * size[observer, 0], outlines[target, 0], outlines[target, 1]
    x0 = position[observer, 0] + ahead * outlines[observer, 0]
    y0 = position[observer, 1] + ahead * outlines[observer, 1]
    count = _near_line(world, outlines, observer, target, x0, y0, near)
    x = y = seen = 0.0
    for forward, left in _POINTS:
        along, across = forward * size[target, 0], left * size[target, 1]
        dx, dy = along * cos - across * sin, along * sin + across * cos
        x1, y1 = position[target, 0] + dx, position[target, 1] + dy
        far = (x1 - x0) ** 2 + (y1 - y0) ** 2 > reach * reach
        if not far and not _hidden(world, outlines, near, count, x0, y0, x1, y1):
            x, y, seen = x + dx, y + dy, seen + 1.0
    return x / seen, y / seen


@inlined_part
def _near_line(world: World, outlines: Floats, observer: int, target: int, x0: float, y0: float, near: Ints) -> int:
    """Write to `near` the rows that could hide any part of the target from (x0, y0), and answer how many.

    No other box comes as near to the line to the target's centre as its own radius and the target's.
    """
    dx, dy = world.position[target, 0] - x0, world.position[target, 1] - y0
    square, count = dx * dx + dy * dy, 0
    for k in range(outlines.shape[0]):
        px, py = world.position[k, 0] - x0, world.position[k, 1] - y0
        reach = outlines[k, 2] + outlines[target, 2] + SURELY
        cross, along = px * dy - py * dx, px * dx + py * dy
        if cross * cross > reach * reach * square or (along < 0.0 and px * px + py * py > reach * reach):
            continue
        if k != observer and k != target and world.driver[k] != OFF:
            near[count] = k
            count += 1
    return count


@inlined_part
def _hidden(world: World, outlines: Floats, near: Ints, count: int, x0: float, y0: float, x1: float, y1: float) -> bool:
    for n in range(count):
        k = near[n]
        if box_hides(
            x0, y0, x1, y1, world.position[k, 0], world.position[k, 1], outlines[k, 0], outlines[k, 1],
            world.size[k, 0], world.size[k, 1],
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
def sense(world: World, outlines: Floats, observer: int, sensor: Sensing, key: Ints, step: int, pose: Floats,
          position: Floats, kind: Ints, visible: Bools, near: Ints) -> int:  # fmt: skip
    """Fill position (MAX_TRACKS, 3) and kind (MAX_TRACKS,) with what the observer detects; return how many.

    Detections are placed in the world by the observer's own fix `pose`, so its errors are theirs.
    outlines (N, 3) as from `outline`; near (N,) is scratch.
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
        if not within(dx, dy, sensor.range + 20.0):
            continue
        if not can_see(world, outlines, observer, target, sensor.range, near):
            continue
        visible[target] = True
        if sensor.false_alarm > 0.0 and found < MAX_TRACKS:
            found += _alarm(world, outlines, observer, target, sensor, key, step, pose, position[found], kind[found:])
        east, north, lucky = normals_and_uniform(key, step, observer, target, _DETECTION)
        if lucky < sensor.miss or found == MAX_TRACKS:
            continue
        if sensor.partial > 0.0:
            x, y = _seen_middle(world, outlines, observer, target, sensor.range, near)
            dx, dy = dx + sensor.partial * x, dy + sensor.partial * y
        kind[found] = world.kind[target]
        if sensor.class_error > 0.0 and uniform(key, step, observer, target, _CLASS) < sensor.class_error:
            kind[found] = CAR if kind[found] == TRUCK else TRUCK
        position[found, 0] = pose[0] + dx * cos - dy * sin + sensor.noise * east
        position[found, 1] = pose[1] + dx * sin + dy * cos + sensor.noise * north
        # The road is flat and known, so the height of a centre carries the class and no noise.
        position[found, 2] = CENTRE_HEIGHT[1] if kind[found] == TRUCK else CENTRE_HEIGHT[0]
        found += 1
    return found


@inlined_part
def _alarm(world: World, outlines: Floats, observer: int, target: int, sensor: Sensing, key: Ints, step: int,
           pose: Floats, position: Floats, kind: Ints) -> int:  # fmt: skip
    """Write, by chance, a second detection of a target, at a corner of its box; answers how many."""
    east, north, lucky = normals_and_uniform(key, step, observer, target, _FALSE_ALARM)
    if lucky >= sensor.false_alarm:
        return 0
    corner = 1 + int(4.0 * uniform(key, step, observer, target, _CORNER))
    along, across = _POINTS[corner][0] * world.size[target, 0], _POINTS[corner][1] * world.size[target, 1]
    dx = world.position[target, 0] - world.position[observer, 0]
    dy = world.position[target, 1] - world.position[observer, 1]
    dx += along * outlines[target, 0] - across * outlines[target, 1]
    dy += along * outlines[target, 1] + across * outlines[target, 0]
    wrong = pose[2] - world.heading[observer]
    cos, sin = math.cos(wrong), math.sin(wrong)
    position[0] = pose[0] + dx * cos - dy * sin + sensor.noise * east
    position[1] = pose[1] + dx * sin + dy * cos + sensor.noise * north
    position[2] = CENTRE_HEIGHT[1] if world.kind[target] == TRUCK else CENTRE_HEIGHT[0]
    kind[0] = world.kind[target]
    return 1
