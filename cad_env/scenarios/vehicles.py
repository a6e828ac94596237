"""What actors and backgrounds are put together from: bodies, queues, vehicles in a row, hidden streams."""

import math
from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np

from cad_env.scenarios.ranges import Range
from cad_env.scenarios.scene import Placement
from cad_env.world.state import STREAM

EARLIEST = -5.0  # s, when the first vehicles of a stream came by


class Body(TypedDict):
    """The extent of a vehicle."""

    length: float  # m
    width: float  # m


def car_body(rng: np.random.Generator) -> Body:
    """A passenger car's."""
    return {"length": rng.uniform(4.2, 5.2), "width": rng.uniform(1.8, 2.0)}


def queue(rng: np.random.Generator, route: int, line: float, count: int) -> list[Placement]:
    """Cars waiting one behind the other at a red light, whose line is so many metres along their route."""
    return _standing(rng, route, line - rng.uniform(0.5, 2.0), count, line)


def queue_behind(rng: np.random.Generator, leader: Placement, count: int) -> list[Placement]:
    """Cars that stand behind a standing vehicle, and wait at its light if it does."""
    return _standing(rng, leader.route, leader.rear - rng.uniform(2.0, 3.5), count, leader.stop_at)


def _standing(rng: np.random.Generator, route: int, front: float, count: int, stop_at: float) -> list[Placement]:
    standing = []
    for _ in range(count):
        body = car_body(rng)
        target = rng.uniform(9.0, 13.0)
        standing.append(Placement(route, front - 0.5 * body["length"], 0.0, target, stop_at=stop_at, **body))
        front -= body["length"] + rng.uniform(2.0, 3.5)
    return standing


def vehicles_in_row(
    rng: np.random.Generator, route: int, front: float, speed: float, count: int,
    gap: tuple[float, float] = (18.0, 35.0), bystander: bool = False, stop_at: float = math.inf,
) -> list[Placement]:  # fmt: skip
    """Cars that drive one behind the other, centres so many metres apart, each a little faster than the one behind."""
    cars = []
    for k in range(count):
        pace = speed * (1.0 - 0.01 * k)
        cars.append(Placement(route, front, pace, pace, bystander=bystander, stop_at=stop_at, **car_body(rng)))
        front -= rng.uniform(*gap)
    return cars


def platoon_times(
    rng: np.random.Generator, platoon: tuple[int, int], headway: Range, gap: Range, until: float
) -> list[float]:
    """s at which the vehicles of a stream come by, from `EARLIEST` to `until`: platoons with gaps between them.

    platoon: how many vehicles it has, both ends included; headway: s from one to the next within it, front to front;
    gap: s from its last one to the first of the next.
    """
    # A stream that has been going on for ever: the longer a platoon the likelier it is met, at any moment of it alike.
    longest = platoon[1] * headway[1] + gap[1]
    waits, passed = _waits(rng, platoon, headway, gap), rng.uniform(0.0, longest)
    while sum(waits) <= passed:
        waits, passed = _waits(rng, platoon, headway, gap), rng.uniform(0.0, longest)
    times, time = [], EARLIEST - passed
    while time < until:
        for wait in waits:
            times.append(time)
            time += wait
        waits = _waits(rng, platoon, headway, gap)
    return [time for time in times if EARLIEST <= time < until]


def _waits(rng: np.random.Generator, platoon: tuple[int, int], headway: Range, gap: Range) -> list[float]:
    """s from each vehicle of a platoon to the next one, the last of which is the first of the next platoon."""
    within = int(rng.integers(*platoon, endpoint=True)) - 1
    return [*rng.uniform(*headway, within).tolist(), rng.uniform(*gap)]


def hidden_stream(rng: np.random.Generator, ranges: Any, route: int, conflict: float) -> list[Placement]:
    """The vehicles of a stream on a route, the first ones ahead, each of which comes by `conflict`, m along it.

    ranges: a StreamRanges with the further fields `stream_speed` (m/s, of all of them), `platoon`, `headway` and
    `platoon_gap` (see `platoon_times`). Nothing is asked about the ego.
    """
    speed, empty = rng.uniform(*ranges.stream_speed), rng.random() < ranges.empty_share
    times = platoon_times(rng, ranges.platoon, ranges.headway, ranges.platoon_gap, (conflict - 1.0) / speed)
    return [] if empty else [_streaming(rng, ranges, route, conflict - speed * time, speed) for time in times]


def _streaming(rng: np.random.Generator, ranges: Any, route: int, progress: float, speed: float) -> Placement:
    attentive, reaction = rng.random() < ranges.attentive_share, rng.uniform(*ranges.reaction)
    attention = reaction if attentive else math.inf
    return Placement(route, progress, speed, speed, STREAM, attention=attention, **car_body(rng))


def rows_from(first: int, vehicles: Sequence[Placement]) -> tuple[int, ...]:
    """The rows of some vehicles, the first of which is in row `first`."""
    return tuple(range(first, first + len(vehicles)))
