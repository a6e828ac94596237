"""How an object moves, by the nodes of its track: a straight motion, and the lane that an oncoming vehicle keeps to."""

import math

from cad_env.numerics.jit import compiled
from cad_env.types import FRAMES, STEP, Floats, Ints

FIT_FRAMES = 6  # newest nodes of a track that its velocity is fitted to
SIGNIFICANT = 3.0 * 0.2  # m: a fitted speed counts if it is three standard errors at 0.2 m of noise from zero
ONCOMING = 0.2  # rad from the opposite of the way, within which a vehicle drives along it
STRAIGHT, BENT = 4, 0.02  # points of the way that are straight if their headings differ by less than so many rad


@compiled
def fit_motion(track: Floats, mask: Ints, odometry: Floats, motion: Floats) -> bool:
    """Fit a straight motion to a track's nodes and write x, y (m, now), heading (rad), speed (m/s).

    track (T, 3) in the ego frame of each frame, odometry (T, 3) those frames in the newest one. The whole window
    tells where it heads, its newest nodes how fast: a driver changes speed sooner than direction. False if fewer than
    two nodes are known.
    """
    nodes, _, _, vx, vy, _ = fit_line(track, mask, odometry, FRAMES)
    if nodes < 2:
        return False
    heading = math.atan2(vy, vx)
    _, x, y, vx, vy, lever = fit_line(track, mask, odometry, FIT_FRAMES)
    speed = vx * math.cos(heading) + vy * math.sin(heading)
    if speed < SIGNIFICANT / lever:
        speed = 0.0  # a young track of a waiting vehicle looks as if it crept
    motion[0], motion[1], motion[2], motion[3] = x, y, heading, speed
    return True


@compiled
def lane_heading(way: Floats, heading: float) -> float:
    """The heading of an oncoming vehicle, which keeps to its lane: against the way, where that is straight.

    An error of 0.03 rad, as a fit has it, would put a vehicle that is 60 m away into the next lane. Any other heading
    is returned as it is.
    """
    for first in (0, way.shape[0] - 1 - STRAIGHT):
        dx, dy = way[first, 0] - way[first + 1, 0], way[first, 1] - way[first + 1, 1]
        last = first + STRAIGHT
        further = math.atan2(way[last - 1, 1] - way[last, 1], way[last - 1, 0] - way[last, 0])
        against = math.atan2(dy, dx)
        if math.cos(further - against) > math.cos(BENT) and math.cos(heading - against) > math.cos(ONCOMING):
            return against
    return heading


@compiled
def fit_line(track: Floats, mask: Ints, odometry: Floats,
             newest: int) -> tuple[int, float, float, float, float, float]:  # fmt: skip
    """Least squares over a track's newest nodes: how many, x and y now (m), their slopes (m/s), and the lever (s).

    The standard error of a slope is that of a node over the lever.
    """
    weight = sum_t = sum_tt = sum_x = sum_y = sum_tx = sum_ty = 0.0
    for back in range(FRAMES):
        t = FRAMES - 1 - back
        if mask[t] == 0 or weight >= newest:
            continue
        cos, sin = math.cos(odometry[t, 2]), math.sin(odometry[t, 2])
        x = odometry[t, 0] + track[t, 0] * cos - track[t, 1] * sin
        y = odometry[t, 1] + track[t, 0] * sin + track[t, 1] * cos
        time = -STEP * back
        weight += 1.0
        sum_t += time
        sum_tt += time * time
        sum_x += x
        sum_y += y
        sum_tx += time * x
        sum_ty += time * y
    if weight < 2.0:
        return int(weight), 0.0, 0.0, 0.0, 0.0, 0.0
    spread = weight * sum_tt - sum_t * sum_t
    vx, vy = (weight * sum_tx - sum_t * sum_x) / spread, (weight * sum_ty - sum_t * sum_y) / spread
    x, y = (sum_x - vx * sum_t) / weight, (sum_y - vy * sum_t) / weight
    return int(weight), x, y, vx, vy, math.sqrt(spread / weight)
