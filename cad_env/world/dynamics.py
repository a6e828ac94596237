"""How a vehicle moves: highway-env's kinematic bicycle and its cascaded steering, along a sampled route.

The equations and gains are those of `highway_env.vehicle.kinematics.Vehicle.step` and
`highway_env.vehicle.controller.ControlledVehicle.steering_control`, so that a free vehicle follows highway-env's own.
"""

import math

from cad_env.numerics.jit import compiled, inlined
from cad_env.types import Floats
from cad_env.world.state import Routes, World

PURSUIT_TIME = 0.1  # s the steering looks ahead along the route
HEADING_GAIN = 5.0  # 1/s
LATERAL_GAIN = 1.0 / 0.6  # 1/s
MAX_STEERING = math.pi / 3  # rad
# Both gains go with 1 / speed: below 0.5 m/s, at 20 Hz, they would blow rounding errors up to centimetres.
LEAST_STEERING_SPEED = 1.0  # m/s


@inlined
def heading_at(routes: Routes, route: int, progress: float) -> float:
    """The heading of a route at an arc length, rad."""
    step = progress / routes.spacing
    last = routes.heading.shape[1] - 2
    index = min(max(int(step), 0), last)
    share = min(max(step - index, 0.0), 1.0)
    before, after = routes.heading[route, index], routes.heading[route, index + 1]
    return float(before + share * (after - before))


@inlined
def place_on_route(routes: Routes, route: int, x: float, y: float, progress: float) -> tuple[float, float]:
    """(arc length, lateral offset to the left) of a point, searched from a nearby arc length, m."""
    lateral = 0.0
    last = routes.point.shape[1] - 1
    for _ in range(2):  # two Newton steps: exact on straights, < 1 mm in the arcs of a junction
        index = min(max(int(progress / routes.spacing), 0), last)
        heading = heading_at(routes, route, progress)
        cos, sin = math.cos(heading), math.sin(heading)
        rest = progress - index * routes.spacing
        dx = x - routes.point[route, index, 0] - rest * cos
        dy = y - routes.point[route, index, 1] - rest * sin
        progress += dx * cos + dy * sin
        lateral = dy * cos - dx * sin
    return progress, lateral


@compiled
def wrapped(angle: float) -> float:
    """The angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@inlined
def steering(routes: Routes, route: int, progress: float, lateral: float, heading: float, speed: float,
             length: float) -> float:  # fmt: skip
    """The steering angle that follows the route, rad: lateral offset -> heading -> heading rate -> slip angle."""
    safe_speed = max(speed, LEAST_STEERING_SPEED)
    correction = math.asin(min(max(-LATERAL_GAIN * lateral / safe_speed, -1.0), 1.0))
    wanted = heading_at(routes, route, progress + speed * PURSUIT_TIME)
    wanted += min(max(correction, -math.pi / 4), math.pi / 4)
    rate = HEADING_GAIN * wrapped(wanted - heading)
    slip = math.asin(min(max(0.5 * length / safe_speed * rate, -1.0), 1.0))
    return min(max(math.atan(2.0 * math.tan(slip)), -MAX_STEERING), MAX_STEERING)


@inlined
def drive(world: World, routes: Routes, i: int, acceleration: float, dt: float) -> None:
    """Move vehicle i along its route for dt under an acceleration; it never rolls backwards."""
    position: Floats = world.position
    route = world.route[i]
    speed, heading, length = world.speed[i], world.heading[i], world.size[i, 0]
    progress, lateral = place_on_route(routes, route, position[i, 0], position[i, 1], world.progress[i])
    angle = steering(routes, route, progress, lateral, heading, speed, length)
    slip = math.atan(0.5 * math.tan(angle))
    position[i, 0] += speed * math.cos(heading + slip) * dt
    position[i, 1] += speed * math.sin(heading + slip) * dt
    world.heading[i] = heading + speed * math.sin(slip) / (0.5 * length) * dt
    world.speed[i] = max(speed + acceleration * dt, 0.0)
    world.acceleration[i] = (world.speed[i] - speed) / dt
    world.progress[i] = progress + speed * dt
