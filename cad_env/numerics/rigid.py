"""Poses in the plane as tuples (x, y, heading) in m and rad: each is also the motion that takes its body to the world.

`compose(a, b)` is where b is, said in the frame of a, in the frame that a is said in.
"""

import math

from cad_env.numerics.jit import inlined
from cad_env.types import Floats

Pose = tuple[float, float, float]


@inlined
def pose_of(row: Floats) -> Pose:
    """The pose in the first three numbers of a row."""
    return (row[0], row[1], row[2])


@inlined
def put_pose_in(row: Floats, pose: Pose) -> None:
    """Write a pose to the first three numbers of a row."""
    row[0], row[1], row[2] = pose[0], pose[1], pose[2]


@inlined
def turned(angle: float) -> float:
    """The angle in [-pi, pi]."""
    return math.atan2(math.sin(angle), math.cos(angle))


@inlined
def compose(a: Pose, b: Pose) -> Pose:
    """A pose b in the frame of a, in the frame of which a is said."""
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return (a[0] + b[0] * cos - b[1] * sin, a[1] + b[0] * sin + b[1] * cos, a[2] + b[2])


@inlined
def between(a: Pose, b: Pose) -> Pose:
    """A pose b, said in the same frame as a, in the frame of a."""
    cos, sin = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return (dx * cos + dy * sin, dy * cos - dx * sin, b[2] - a[2])


@inlined
def from_to(a: Pose, b: Pose) -> Pose:
    """The change of frames that takes what is said as a to what is said as b: compose(from_to(a, b), a) is b."""
    angle = b[2] - a[2]
    cos, sin = math.cos(angle), math.sin(angle)
    return (b[0] - a[0] * cos + a[1] * sin, b[1] - a[0] * sin - a[1] * cos, angle)
