"""What vehicles know of their own poses: odometry, GNSS, and their place on the map; all of it with errors.

Three frames meet here. A vehicle's *odometry frame* begins where the vehicle does, with it as the x axis: there it
senses, tracks and keeps its graph. A *fix* is its pose in the world as its receiver has smoothed it over its odometry,
with its stated accuracy. Its *place* is its pose on the map: along its way as the fix says, or without any fix as it
was at the start and has moved since; beside it and in heading as a camera sees the markings of its lane, without error
(the simulation steers as well).

Errors of GNSS are drawn along the axes of a vehicle's first heading, so that turning the world turns them too.
"""

import math
from typing import NamedTuple

import numpy as np

from cad_env.config import PLACINGS, PoseConfig
from cad_env.numerics.jit import compiled, compiled_part, inlined_part
from cad_env.numerics.philox import normals_and_uniform, uniform
from cad_env.numerics.rigid import Pose, between, compose, from_to, pose_of, put_pose_in, turned
from cad_env.types import FRAMES, STEP, Floats, Ints
from cad_env.world.dynamics import heading_at, place_on_route
from cad_env.world.state import Routes, World

USUAL_WAY = 1.0  # m in a step, for which smoothing is tuned
# The last counter of each stream; the others are step and row.
_BIAS, _YAW_BIAS, _NOISE, _YAW_NOISE, _OUTAGE, _SCALE, _YAW_RATE, _START = range(8)
_FIRST = 1 << 21  # in place of a step: what is drawn once an episode


class PoseModel(NamedTuple):
    """A PoseConfig as compiled code sees it."""

    bias: float  # m
    yaw_bias: float  # rad
    remembered: float  # share of a bias that stays in a step
    noise: float  # m
    yaw_noise: float  # rad
    outage: float  # share of time
    outage_ends: float  # probability in a step
    denied: bool
    start: float  # m
    scale: float
    yaw_rate: float  # rad/s
    placing: int  # index of PLACINGS
    gain: float  # least weight of a new fix in the smoothed one, position
    yaw_gain: float  # and heading


class Poses(NamedTuple):
    """The poses of V vehicles; of none where poses are exact."""

    model: PoseModel
    before: Floats  # (V, 3) true pose in the newest frame; never leaves the simulation
    first: Floats  # (V,) rad, true heading at the start
    bias: Floats  # (V, 3) m, m, rad
    out: Ints  # (V,) 1 during an outage
    fixes: Ints  # (V,) how many there have been
    fix: Floats  # (V, 3) the smoothed one, moved on by odometry
    blind: Floats  # (V, 2) m and s since the newest fix
    accuracy: Floats  # (V, 2) m, rad: standard deviations of `fix`, as its vehicle states them
    along: Floats  # (V,) m along its route, as it takes itself to be
    place: Floats  # (V, 3) on the map


def pose_model(config: PoseConfig) -> PoseModel:
    """The compiled stages' view of a configuration."""
    return PoseModel(
        bias=float(config.bias),
        yaw_bias=float(config.yaw_bias),
        remembered=math.exp(-STEP / config.bias_time),
        noise=float(config.noise),
        yaw_noise=float(config.yaw_noise),
        outage=float(config.outage),
        outage_ends=STEP / config.outage_time,
        denied=bool(config.denied),
        start=float(config.start),
        scale=float(config.scale),
        yaw_rate=float(config.yaw_rate),
        placing=PLACINGS.index(config.placing),
        gain=_least_gain(USUAL_WAY * config.scale, config.noise),
        yaw_gain=_least_gain(STEP * config.yaw_rate, config.yaw_noise),
    )


def _least_gain(drift: float, noise: float) -> float:
    """The weight at which what odometry drifts meanwhile, drift / gain, is as large as what noise is left.

    >>> _least_gain(0.01, 1.0), _least_gain(0.01, 0.0)
    (0.05848035476425733, 1.0)
    """
    return 1.0 if noise == 0.0 else min(max((2.0 * (drift / noise) ** 2) ** (1.0 / 3.0), 0.01), 1.0)


def new_poses(vehicles: int, config: PoseConfig) -> Poses:
    """The poses of so many vehicles before the first frame; of none if they are exact."""
    count = 0 if config.exact else vehicles
    return Poses(
        model=pose_model(config),
        before=np.zeros((count, 3)),
        first=np.zeros(count),
        bias=np.zeros((count, 3)),
        out=np.zeros(count, np.int64),
        fixes=np.zeros(count, np.int64),
        fix=np.zeros((count, 3)),
        blind=np.zeros((count, 2)),
        accuracy=np.zeros((count, 2)),
        along=np.zeros(count),
        place=np.zeros((count, 3)),
    )


@inlined_part
def true_pose(world: World, row: int) -> Pose:
    """The pose of a vehicle of the world."""
    return (world.position[row, 0], world.position[row, 1], world.heading[row])


@compiled_part
def move(poses: Poses, v: int, world: World, routes: Routes, row: int, key: Ints, step: int, trail: Floats) -> None:
    """One frame of what vehicle v, in `row` of the world, knows of its pose; trail[-1] becomes that by odometry."""
    truth = true_pose(world, row)
    if step == 0:
        put_pose_in(poses.before[v], truth)
        poses.first[v] = truth[2]
    way = _odometry(poses, v, row, key, between(pose_of(poses.before[v]), truth))
    put_pose_in(poses.before[v], truth)
    put_pose_in(trail[FRAMES - 1], compose(pose_of(trail[FRAMES - 2]), way))
    _drift(poses, v, row, key, step)
    if step == 0:
        _begin(poses, v, world, row, key, truth)
    else:
        put_pose_in(poses.fix[v], compose(pose_of(poses.fix[v]), way))
    _take_fix(poses, v, row, key, step, truth, math.hypot(way[0], way[1]))
    _find_place(poses, v, world, routes, row, truth)


@inlined_part
def _odometry(poses: Poses, v: int, row: int, key: Ints, way: Pose) -> Pose:
    """What wheels and gyro say of a motion of one step, in the frame of its beginning."""
    model = poses.model
    east, _, _ = normals_and_uniform(key, _FIRST, row, 0, _SCALE)
    turn, _, _ = normals_and_uniform(key, _FIRST, row, 0, _YAW_RATE)
    scale = 1.0 + model.scale * east
    moves = abs(way[0]) + abs(way[1]) + abs(way[2]) > 0.0  # a vehicle at rest knows that it is
    return (way[0] * scale, way[1] * scale, turned(way[2]) + (STEP * model.yaw_rate * turn if moves else 0.0))


@inlined_part
def _drift(poses: Poses, v: int, row: int, key: Ints, step: int) -> None:
    """One step of the bias and of the outages."""
    model, bias = poses.model, poses.bias[v]
    x, y, _ = normals_and_uniform(key, step, row, 0, _BIAS)
    turn, _, _ = normals_and_uniform(key, step, row, 0, _YAW_BIAS)
    chance = uniform(key, step, row, 0, _OUTAGE)
    kept = 0.0 if step == 0 else model.remembered
    fresh = math.sqrt(1.0 - kept * kept)
    bias[0] = kept * bias[0] + fresh * model.bias * x
    bias[1] = kept * bias[1] + fresh * model.bias * y
    bias[2] = kept * bias[2] + fresh * model.yaw_bias * turn
    begins = model.outage if step == 0 else model.outage_ends * model.outage / (1.0 - model.outage)
    if step > 0 and poses.out[v] != 0:
        poses.out[v] = chance >= model.outage_ends
    else:
        poses.out[v] = chance < begins


@inlined_part
def _begin(poses: Poses, v: int, world: World, row: int, key: Ints, truth: Pose) -> None:
    """Where a vehicle takes itself to be before its first fix."""
    along, _, _ = normals_and_uniform(key, _FIRST, row, 0, _START)
    along *= poses.model.start
    put_pose_in(poses.fix[v], compose(truth, (along, 0.0, 0.0)))
    poses.along[v] = world.progress[row] + along


@inlined_part
def _take_fix(poses: Poses, v: int, row: int, key: Ints, step: int, truth: Pose, way: float) -> None:
    """Smooth the fix of this frame, if there is one, into those before, and say how accurate the result is."""
    model, fix, blind = poses.model, poses.fix[v], poses.blind[v]
    blind[0] += way
    blind[1] += STEP
    if not model.denied and poses.out[v] == 0:
        x, y, _ = normals_and_uniform(key, step, row, 0, _NOISE)
        turn, _, _ = normals_and_uniform(key, step, row, 0, _YAW_NOISE)
        bias, cos, sin = poses.bias[v], math.cos(poses.first[v]), math.sin(poses.first[v])
        x, y = bias[0] + model.noise * x, bias[1] + model.noise * y
        poses.fixes[v] += 1
        gain, yaw_gain = max(1.0 / poses.fixes[v], model.gain), max(1.0 / poses.fixes[v], model.yaw_gain)
        fix[0] += gain * (truth[0] + x * cos - y * sin - fix[0])
        fix[1] += gain * (truth[1] + x * sin + y * cos - fix[1])
        fix[2] += yaw_gain * turned(truth[2] + bias[2] + model.yaw_noise * turn - fix[2])
        blind[0] = blind[1] = 0.0
    _state_accuracy(poses, v)


@inlined_part
def _state_accuracy(poses: Poses, v: int) -> None:
    """Slow errors, what is left of noise, and what odometry has drifted since the fixes that count."""
    model, blind, count = poses.model, poses.blind[v], max(poses.fixes[v], 1)
    gain, yaw_gain = max(1.0 / count, model.gain), max(1.0 / count, model.yaw_gain)
    slow = model.bias if poses.fixes[v] > 0 else model.start
    drift = model.scale * (blind[0] + USUAL_WAY / gain)
    yaw_drift = model.yaw_rate * (blind[1] + STEP / yaw_gain)
    poses.accuracy[v, 0] = math.sqrt(slow**2 + gain * model.noise**2 + drift**2)
    poses.accuracy[v, 1] = math.sqrt(model.yaw_bias**2 + yaw_gain * model.yaw_noise**2 + yaw_drift**2)


@inlined_part
def _find_place(poses: Poses, v: int, world: World, routes: Routes, row: int, truth: Pose) -> None:
    """Find the place on the map: along the way by the fix, beside it and in heading by the markings of the lane."""
    route, fix = world.route[row], poses.fix[v]
    true_along, beside = place_on_route(routes, route, truth[0], truth[1], world.progress[row])
    poses.along[v], _ = place_on_route(routes, route, fix[0], fix[1], poses.along[v])
    along = poses.along[v]
    heading = heading_at(routes, route, along)
    index = min(max(int(along / routes.spacing), 0), routes.point.shape[1] - 1)
    rest = along - index * routes.spacing
    place = poses.place[v]
    place[0] = routes.point[route, index, 0] + rest * math.cos(heading) - beside * math.sin(heading)
    place[1] = routes.point[route, index, 1] + rest * math.sin(heading) + beside * math.cos(heading)
    place[2] = heading + truth[2] - heading_at(routes, route, true_along)


@inlined_part
def has_fix(poses: Poses, v: int) -> bool:
    """Whether vehicle v has a fix to say."""
    return bool(poses.fixes[v] > 0)


@compiled
def frame_to(trail: Floats, place: Floats, frame: Floats) -> None:
    """Write the change of frames from that of a trail (T, 3) to the one in which its newest pose is `place`."""
    put_pose_in(frame, from_to(pose_of(trail[FRAMES - 1]), pose_of(place)))
