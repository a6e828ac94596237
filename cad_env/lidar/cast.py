"""Truth -> points of one vehicle's lidar: rays in the plane, and where on what they meet each beam ends.

The sensor is that of `sense`, in the same place, and meets the same boxes. In the plane the first box on a ray hides
all behind it, whatever the heights, as it does from the line of sight: what has a return is visible to `sense`.
"""

import math
from typing import NamedTuple

import numpy as np

from cad_env.lidar.points import POINT_REACH, nearest_cm
from cad_env.numerics.jit import compiled, inlined_part
from cad_env.numerics.philox import normals_and_uniform
from cad_env.pipeline.sense import CENTRE_HEIGHT, MOUNT, Sensing
from cad_env.types import Floats, Ints
from cad_env.world.state import OFF, World

HEIGHT = 1.8  # m of the sensor above the road
LOWEST, HIGHEST = math.radians(-24.8), math.radians(2.0)  # elevations of a 64-beam lidar (Velodyne HDL-64E)
RANGE_NOISE = 0.1  # of the noise of a detection: a range is ten times as certain as the centre of a vehicle
NOTHING = -1  # in place of the row of a vehicle that a ray meets
TOO_FAR = -1  # in place of the number of returns
_METRES, _CENTIMETRES = False, True


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


@inlined_part
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


@inlined_part
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
         ground: bool, cloud: Floats) -> int:  # fmt: skip
    """Fill cloud (A * B, 3) m with the returns of one observer, by azimuth, then beam; return how many.

    They are in the observer's own frame: x ahead and y to the left of its centre, z above the road. A beam that meets
    the road first, within the sensor's range, is a return of height 0, left out unless `ground` is wanted; one that
    passes over the box returns nothing.
    """
    return _cast(world, outlines, observer, sensor, key, step, rays, ground, _METRES, cloud)


@compiled
def cast_centimetres(world: World, outlines: Floats, observer: int, sensor: Sensing, key: Ints, step: int, rays: Rays,
                     cloud: Ints) -> int:  # fmt: skip
    """As `cast`, ground and all, to the nearest cm: cloud (A * B, 3) int16. TOO_FAR if it cannot hold a coordinate."""
    return _cast(world, outlines, observer, sensor, key, step, rays, True, _CENTIMETRES, cloud)


@inlined_part
def _cast(world: World, outlines: Floats, observer: int, sensor: Sensing, key: Ints, step: int, rays: Rays,
          ground: bool, whole: bool, cloud: Floats) -> int:  # fmt: skip
    """As `cast`, in whole cm if so asked."""
    azimuths, beams = rays.direction.shape[0], rays.slope.shape[0]
    distance, struck = np.empty(azimuths), np.empty(azimuths, np.int64)
    along, across = np.empty(beams, cloud.dtype), np.empty(beams, cloud.dtype)
    meet(world, outlines, observer, sensor.range, rays, distance, struck)
    ahead, count, fits = MOUNT * world.size[observer, 0], 0, True
    for a in range(azimuths):
        if struck[a] == NOTHING and not ground:
            continue
        error = 0.0
        if sensor.noise > 0.0:
            error, _, _ = normals_and_uniform(key, step, observer, a, 0)
            error *= sensor.noise * RANGE_NOISE
        cos, sin, way = rays.direction[a, 0], rays.direction[a, 1], distance[a]
        free, b = min(way, sensor.range), 0
        while b < beams and rays.ground[b] < free:
            b += 1
        if ground:
            for g in range(b):  # apart from the writing below, so that it is done several beams at a time
                place = rays.ground[g] + error
                along[g], across[g] = _said(ahead + place * cos, whole), _said(place * sin, whole)
            for g in range(b):
                cloud[count + g, 0], cloud[count + g, 1], cloud[count + g, 2] = along[g], across[g], 0
            if b > 0:  # between its first and its last return the ground of an azimuth is no farther than these
                fits &= _fits(ahead + (rays.ground[0] + error) * cos, (rays.ground[0] + error) * sin, whole)
                fits &= _fits(ahead + (rays.ground[b - 1] + error) * cos, (rays.ground[b - 1] + error) * sin, whole)
            count += b
        if struck[a] == NOTHING:
            continue
        middle, place = CENTRE_HEIGHT[world.kind[struck[a]]], max(way + error, 0.0)
        x, y = ahead + place * cos, place * sin
        fits &= _fits(x, y, whole)
        if beams == 1:
            _put(cloud, count, x, y, middle, whole)
            count += 1
            continue
        while b < beams:
            height = HEIGHT + way * rays.slope[b]
            if height > 2.0 * middle:
                break
            _put(cloud, count, x, y, height, whole)
            count, b = count + 1, b + 1
    return count if fits else TOO_FAR


@inlined_part
def _put(cloud: Floats, at: int, x: float, y: float, z: float, whole: bool) -> None:
    """Write a point (m), in whole cm if so asked."""
    cloud[at, 0], cloud[at, 1], cloud[at, 2] = _said(x, whole), _said(y, whole), _said(z, whole)


@inlined_part
def _said(coordinate: float, whole: bool) -> float:
    """A coordinate (m) as it is written."""
    return nearest_cm(coordinate) if whole else coordinate


@inlined_part
def _fits(x: float, y: float, whole: bool) -> bool:
    """Whether what is written of a place (m) can be; no vehicle is too high."""
    return not whole or (abs(x) <= POINT_REACH and abs(y) <= POINT_REACH)
