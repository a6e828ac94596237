"""A highway-env road network -> routes sampled at even arc lengths, for the compiled world."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import RoadNetwork
from scipy.spatial import cKDTree

from cad_env.types import Command, Floats
from cad_env.world.state import Routes

SPACING = 0.5  # m between samples; an 8 m arc deviates from its chords by 4 mm
ALONG_WITHIN = 4.0  # m to the side that one route may run from another and still be "along" it
ALONG_ANGLE = np.radians(50)  # rad; a path that crosses at more than this is not in the same stream


@dataclass(frozen=True)
class RoutePlan:
    """A route by name: the lanes it follows, and what each asks of its driver."""

    name: str
    lanes: tuple[tuple[str, str, int], ...]
    commands: tuple[Command | int, ...]  # one a lane; numbers beyond Command are further ones of the scenario
    oncoming: tuple[float, float] | None = None  # m along it, from where to where a car's body is in an oncoming lane
    line: float = math.inf  # m along it, where whoever gives way waits; inf: nobody ever does


def sample_routes(network: RoadNetwork, plans: Sequence[RoutePlan]) -> Routes:
    """Every plan as a polyline with heading and command per sample, and the table that places one on another."""
    sampled = [_sample(network, plan) for plan in plans]
    samples = max(len(points) for points, _, _ in sampled) + 1
    shape = (len(plans), samples)
    point, heading = np.zeros((*shape, 2)), np.zeros(shape)
    command, oncoming = np.zeros(shape, np.int8), np.zeros(shape, np.int8)
    length = np.zeros(len(plans))
    for r, (points, headings, commands) in enumerate(sampled):
        n = len(points)
        length[r] = (n - 1) * SPACING
        beyond = np.arange(1, samples - n + 1)[:, None] * SPACING
        direction = np.array([np.cos(headings[-1]), np.sin(headings[-1])])
        point[r] = np.concatenate([points, points[-1] + beyond * direction])
        heading[r] = np.concatenate([headings, np.full(samples - n, headings[-1])])
        command[r] = np.concatenate([commands, np.full(samples - n, commands[-1])])
        first, last = plans[r].oncoming or (math.inf, math.inf)
        arc = np.arange(samples) * SPACING
        oncoming[r] = (first <= arc) & (arc <= last)
    projection = _projections(point, heading)
    nowhere, line = np.full((len(plans), len(plans), 4), np.nan), np.array([plan.line for plan in plans])
    nobody = np.zeros((len(plans), len(plans)), np.int8)
    return Routes(SPACING, length, point, heading, command, oncoming, projection, line, nowhere, nobody)


def _sample(network: RoadNetwork, plan: RoutePlan) -> tuple[Floats, Floats, Floats]:
    """(n, 2) points, (n,) headings and (n,) commands of one route at even arc lengths."""
    lanes: list[AbstractLane] = [network.get_lane(index) for index in plan.lanes]
    tables = [_arc_table(lane) for lane in lanes]
    ends = np.cumsum([arcs[-1] for arcs, _ in tables])
    arc = np.arange(0.0, ends[-1], SPACING)
    which = np.minimum(np.searchsorted(ends, arc, side="right"), len(lanes) - 1)
    rest = arc - np.concatenate([[0.0], ends])[which]
    along = np.array([np.interp(s, *tables[k]) for k, s in zip(which, rest, strict=True)])
    points = np.array([lanes[k].position(s, 0.0) for k, s in zip(which, along, strict=True)])
    headings = np.unwrap([lanes[k].heading_at(s) for k, s in zip(which, along, strict=True)])
    return points, headings, np.array(plan.commands)[which]


def _arc_table(lane: AbstractLane) -> tuple[Floats, Floats]:
    """(arc length, the lane's own coordinate) at points of a lane: highway-env measures a SineLane along its chord."""
    own = np.linspace(0.0, lane.length, 201)
    step = np.diff([lane.position(s, 0.0) for s in own], axis=0)
    chords = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    # The chords of an arc that the lane does measure along itself are a little short: trust its length there.
    return (own if chords[-1] < lane.length * (1 + 1e-9) else chords), own


def _projections(point: Floats, heading: Floats) -> Floats:
    """(R, R, P, 2): sample p of route b as (arc length, lateral offset) on route a, NaN where b leaves a's stream."""
    count, samples = heading.shape
    projection = np.full((count, count, samples, 2), np.nan)
    for a in range(count):
        distance, nearest = cKDTree(point[a]).query(point.reshape(-1, 2), distance_upper_bound=ALONG_WITHIN)
        near = np.isfinite(distance)
        nearest = np.where(near, nearest, 0)
        along = heading[a, nearest]
        offset = point.reshape(-1, 2) - point[a, nearest]
        turn = np.abs((heading.reshape(-1) - along + np.pi) % (2 * np.pi) - np.pi)
        arc = nearest * SPACING + offset[:, 0] * np.cos(along) + offset[:, 1] * np.sin(along)
        lateral = offset[:, 1] * np.cos(along) - offset[:, 0] * np.sin(along)
        placed = np.stack([arc, lateral], axis=-1)
        placed[~near | (turn > ALONG_ANGLE)] = np.nan
        projection[a] = placed.reshape(count, samples, 2)
    return projection


def crossing_of(routes: Routes, a: int, b: int) -> tuple[float, float]:
    """(m along route a, m along route b) to the place where the two cross or come nearest head-on."""
    turn = routes.heading[a][:, None] - routes.heading[b][None, :]
    apart = np.linalg.norm(routes.point[a][:, None] - routes.point[b][None, :], axis=-1)
    apart[np.cos(turn) > np.cos(ALONG_ANGLE)] = np.inf
    sample, other = np.unravel_index(int(np.argmin(apart)), apart.shape)
    return float(sample * routes.spacing), float(other * routes.spacing)
