"""Truth -> points of one vehicle's lidar: rays in the plane, and where on what they meet each beam ends.

The sensor is that of `sense`, in the same place, and meets the same boxes. In the plane the first box on a ray hides
all behind it, whatever the heights, as it does from the line of sight: what has a return is visible to `sense`.
"""

import math
from typing import NamedTuple

import numpy as np

from cad_env.chance import normals_and_uniform
from cad_env.compiled import compiled, inlined
from cad_env.pipeline.sense import CENTRE_HEIGHT, MOUNT, Sensing
from cad_env.types import Floats, Ints
from cad_env.world.state import OFF, World

HEIGHT = 1.8  # m of the sensor above the road
LOWEST, HIGHEST = math.radians(-24.8), math.radians(2.0)  # elevations of a 64-beam lidar (Velodyne HDL-64E)
RANGE_NOISE = 0.1  # of the noise of a detection: a range is ten times as certain as the centre of a vehicle
NOTHING = -1  # in place of the row of a vehicle that a ray meets


class Rays(NamedTuple):
    """A azimuths, the first straight ahead and then to the left, with B beams each."""

    direction: Floats  # (A, 2) cos and sin
    slope: Floats  # (B,) m of height a metre of way, ascending
    ground: Floats  # (B,) m to where a beam meets the road, inf for one that does not fall


def rays_of(azimuths: int, beams: int) -> Rays:
    """The rays of a lidar; one beam alone is horizontal."""
    angle = 2.0 * math.pi / azimuths * np.arange(azimuths)
    slope = np.tan(np.linspace(LOWEST, HIGHEST, beams)) if beams > 1 else np.zeros(1)
    ground = np.array([HEIGHT / -one if one < 0.0 else math.inf for one in slope.tolist()])
    return Rays(np.stack([np.cos(angle), np.sin(angle)], axis=1), slope, ground)


@compiled
def meet(world: World, outlines: Floats, observer: int, reach: float, rays: Rays, distance: Floats,
         struck: Ints) -> None:  # fmt: skip
    """Write for every azimuth which row it meets first within reach, struck (A,), and where, distance (A,) m.

    outlines (N, 3) as from `sense.outline`. A ray that meets nobody has NOTHING and inf.
    """
    for a in range(distance.shape[0]):
        distance[a], struck[a] = math.inf, NOTHING
    cos, sin = outlines[observer, 0], outlines[observer, 1]
    ahead = MOUNT * world.size[observer, 0]
    for k in range(outlines.shape[0]):
        if k == observer or world.driver[k] == OFF:
            continue
        dx = world.position[k, 0] - world.position[observer, 0]
        dy = world.position[k, 1] - world.position[observer, 1]
        # In the sensor's frame: the box's centre, and cos and sin of its heading.
        x, y = dx * cos + dy * sin - ahead, dy * cos - dx * sin
        along, across = outlines[k, 0] * cos + outlines[k, 1] * sin, outlines[k, 1] * cos - outlines[k, 0] * sin
        _meet_box(
            x, y, along, across, 0.5 * world.size[k, 0], 0.5 * world.size[k, 1], outlines[k, 2], k, reach, rays,
            distance, struck,
        )  # fmt: skip


@inlined
def _meet_box(x: float, y: float, cos: float, sin: float, length: float, width: float, radius: float, row: int,
              reach: float, rays: Rays, distance: Floats, struck: Ints) -> None:  # fmt: skip
    """Note on which rays a box of half a length and half a width is nearer than what they met before."""
    azimuths = distance.shape[0]
    away = math.hypot(x, y)
    if away > reach + radius:
        return
    first, count = 0, azimuths
    if away > radius:  # no ray that misses the circle around the box can meet it; one more on each side is for safety
        turn, half = math.atan2(y, x), math.asin(radius / away)
        first = math.floor((turn - half) * azimuths / (2.0 * math.pi))
        count = min(azimuths, math.ceil((turn + half) * azimuths / (2.0 * math.pi)) - first + 1)
    start_x, start_y = -(x * cos + y * sin), x * sin - y * cos
    for offset in range(count):
        a = (first + offset) % azimuths
        dx, dy = rays.direction[a, 0], rays.direction[a, 1]
        place = _slab(start_x, dx * cos + dy * sin, length, start_y, dy * cos - dx * sin, width)
        if place <= reach and place < distance[a]:
            distance[a], struck[a] = place, row


@inlined
def _slab(start_x: float, step_x: float, half_x: float, start_y: float, step_y: float, half_y: float) -> float:
    """m along a ray to a box that its start and direction are given in the frame of; inf if it misses."""
    near, far = 0.0, math.inf
    for start, step, half in ((start_x, step_x, half_x), (start_y, step_y, half_y)):
        if abs(step) < 1e-12:
            if abs(start) > half:
                return math.inf
        else:
            one, other = (-half - start) / step, (half - start) / step
            near = max(near, min(one, other))
            far = min(far, max(one, other))
    return near if near <= far else math.inf


@compiled
def cast(world: World, outlines: Floats, observer: int, sensor: Sensing, key: Ints, step: int, rays: Rays,
         cloud: Floats) -> int:  # fmt: skip
    """Fill cloud (A * B, 3) m with the returns of one observer, by azimuth, then beam; return how many.

    They are in the observer's own frame: x ahead and y to the left of its centre, z above the road. A beam that meets
    the road first, within the sensor's range, is a return of height 0; one that passes over the box returns nothing.
    """
    azimuths, beams = rays.direction.shape[0], rays.slope.shape[0]
    distance, struck = np.empty(azimuths), np.empty(azimuths, np.int64)
    meet(world, outlines, observer, sensor.range, rays, distance, struck)
    ahead, count = MOUNT * world.size[observer, 0], 0
    for a in range(azimuths):
        error = 0.0
        if sensor.noise > 0.0:
            error, _, _ = normals_and_uniform(key, step, observer, a, 0)
            error *= sensor.noise * RANGE_NOISE
        cos, sin, way = rays.direction[a, 0], rays.direction[a, 1], distance[a]
        free, b = min(way, sensor.range), 0
        while b < beams and rays.ground[b] < free:
            place = rays.ground[b] + error
            cloud[count, 0], cloud[count, 1], cloud[count, 2] = ahead + place * cos, place * sin, 0.0
            count, b = count + 1, b + 1
        if struck[a] == NOTHING:
            continue
        middle, place = CENTRE_HEIGHT[world.kind[struck[a]]], max(way + error, 0.0)
        if beams == 1:
            cloud[count, 0], cloud[count, 1], cloud[count, 2] = ahead + place * cos, place * sin, middle
            count += 1
            continue
        while b < beams:
            height = HEIGHT + way * rays.slope[b]
            if height > 2.0 * middle:
                break
            cloud[count, 0], cloud[count, 1], cloud[count, 2] = ahead + place * cos, place * sin, height
            count, b = count + 1, b + 1
    return count
