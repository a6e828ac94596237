"""What a vehicle's sensor can see of the ground, as a polygon: the line of sight of `pipeline.sense`, all around."""

import numpy as np

from cad_env.pipeline.sense import MOUNT
from cad_env.types import Bools, Floats
from cad_env.world.state import OFF, World

CIRCLE = np.radians(np.arange(-180.0, 180.0))  # rad; a circle of 80 m deviates from these chords by 3 mm
BESIDE = 1e-6  # rad to both sides of a corner, where the view jumps from the box to what is behind it
CORNERS = np.array([(0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5)])  # of a box, in lengths and widths


def corners(world: World, row: int) -> Floats:
    """(4, 2) m: front left, front right, rear right, rear left of a vehicle's box."""
    cos, sin = np.cos(world.heading[row]), np.sin(world.heading[row])
    placed: Floats = (CORNERS * world.size[row]) @ np.array([[cos, sin], [-sin, cos]]) + world.position[row]
    return placed


def sensor_of(world: World, row: int) -> Floats:
    """(2,) m: where a vehicle's sensor is mounted."""
    heading = world.heading[row]
    ahead = MOUNT * world.size[row, 0] * np.array([np.cos(heading), np.sin(heading)])
    place: Floats = world.position[row] + ahead
    return place


def in_sight(world: World, row: int, reach: float) -> Floats:
    """(n, 2) m, counter-clockwise: the ground that `row` can see within `reach` m, past all other vehicles."""
    sensor = sensor_of(world, row)
    hiding = [k for k in range(len(world.heading)) if k != row and world.driver[k] != OFF]
    boxes = [corners(world, k) for k in hiding]
    angle = np.sort(np.concatenate([CIRCLE, *(_turns(box - sensor, reach) for box in boxes)]))
    ray = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    distance = np.full(len(ray), reach)
    for k in hiding:
        distance = np.minimum(distance, _first_hit(world, k, sensor, ray))
    seen: Floats = sensor + distance[:, None] * ray
    return seen


def _turns(box: Floats, reach: float) -> Floats:
    """(m,) rad: the directions where the view past a box (4, 2), seen from the origin, may jump or bend."""
    corner = np.arctan2(box[:, 1], box[:, 0])
    edge = np.roll(box, -1, axis=0) - box
    # Where an edge leaves the circle of the reach: |box + share * edge| = reach.
    a, b, c = (edge**2).sum(1), (box * edge).sum(1), (box**2).sum(1) - reach**2
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    share = np.stack([(-b - root) / a, (-b + root) / a])
    point = (box + share[..., None] * edge)[(share >= 0.0) & (share <= 1.0)]
    leaving = np.arctan2(point[:, 1], point[:, 0])
    return np.concatenate([corner - BESIDE, corner, corner + BESIDE, leaving])


def _first_hit(world: World, row: int, start: Floats, ray: Floats) -> Floats:
    """(n,) m from `start` along each unit ray to the box of a vehicle, inf where it misses (slab test)."""
    cos, sin = np.cos(world.heading[row]), np.sin(world.heading[row])
    turn = np.array([[cos, -sin], [sin, cos]])
    origin, step = (start - world.position[row]) @ turn, ray @ turn
    step = np.where(np.abs(step) < 1e-12, 1e-12, step)
    half = 0.5 * world.size[row]
    first, second = (-half - origin) / step, (half - origin) / step
    near = np.maximum(np.minimum(first, second).max(axis=1), 0.0)  # 0 from inside the box: it hides everything
    far = np.maximum(first, second).min(axis=1)
    hit: Bools = near <= far
    return np.where(hit, near, np.inf)
