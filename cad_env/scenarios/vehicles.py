"""What casts and backgrounds are put together from: bodies, queues, streams, and who meets whom when."""

import math
from typing import TypedDict

import numpy as np

from cad_env.numerics.jit import compiled
from cad_env.scenarios.scene import Placement
from cad_env.types import STEP
from cad_env.world.drivers import idm_acceleration


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


def stream(
    rng: np.random.Generator, route: int, front: float, speed: float, count: int,
    gap: tuple[float, float] = (18.0, 35.0), bystander: bool = False,
) -> list[Placement]:  # fmt: skip
    """Cars that drive one behind the other, centres so many metres apart, each a little faster than the one behind."""
    cars = []
    for k in range(count):
        pace = speed * (1.0 - 0.01 * k)
        cars.append(Placement(route, front, pace, pace, bystander=bystander, **car_body(rng)))
        front -= rng.uniform(*gap)
    return cars


@compiled
def unbraked_time(speed: float, target_speed: float, distance: float) -> float:
    """Seconds an undisturbed IDM driver takes for a distance, m."""
    time, travelled, dt = 0.0, 0.0, STEP / 2
    while travelled < distance:
        travelled += speed * dt
        speed += idm_acceleration(speed, target_speed, math.inf, 0.0) * dt
        time += dt
    return time


def time_to(vehicle: Placement, place: float) -> float:
    """Seconds until an undisturbed driver is so many metres along its route."""
    return float(unbraked_time(vehicle.speed, vehicle.target_speed, place - vehicle.progress))
