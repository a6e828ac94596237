"""Who presses the pedals: the Intelligent Driver Model on bumper gaps, red lights, and the GO/BRAKE command.

IDM: Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic
simulations", Phys. Rev. E 62 (2000). Gaps are measured from bumper to bumper and a leader is whoever's route
runs along the own one, so that a truck is seen as long as it is.
"""

import math

from cad_env.numerics.jit import compiled, inlined
from cad_env.types import BRAKE
from cad_env.world.state import IDM, OFF, STANDING, Routes, World

MAX_ACCELERATION = 2.0  # m/s2, comfortable start of a car
COMFORTABLE_BRAKING = 3.0  # m/s2
MIN_GAP = 2.0  # m
HEADWAY = 1.2  # s
EXPONENT = 4  # of the free-road term
HARDEST_BRAKING = 8.0  # m/s2, dry asphalt
COMMANDED_BRAKING = 6.0  # m/s2, what BRAKE asks for
SIDE_MARGIN = 0.3  # m to the side that a driver wants free
LOOK_AHEAD = 100.0  # m
SHORT_OF_LINE = 0.5  # m before its line, where a late braker comes to stand
SLOW = 1.0  # m/s, below which a late braker creeps to its line as anybody does


@inlined
def gap_to_leader(world: World, routes: Routes, i: int) -> tuple[float, float]:
    """(bumper gap m, leader's speed m/s) to the nearest vehicle in the way on i's route; (inf, 0) if none."""
    gap, leader_speed = math.inf, 0.0
    own = world.route[i]
    last = routes.projection.shape[2] - 1
    for j in range(world.speed.shape[0]):
        if j == i or world.driver[j] == OFF:
            continue
        sample = min(max(int(world.progress[j] / routes.spacing + 0.5), 0), last)
        beyond = world.progress[j] - sample * routes.spacing  # up to half a spacing either way
        ahead = routes.projection[own, world.route[j], sample, 0] + beyond - world.progress[i]
        if not 0.0 < ahead < LOOK_AHEAD:  # also refuses NaN: j's route does not run along i's there
            continue
        side = abs(routes.projection[own, world.route[j], sample, 1] + beside_route(world, routes, j, sample))
        if side > 0.5 * (world.size[i, 1] + world.size[j, 1]) + SIDE_MARGIN:
            continue
        free = ahead - 0.5 * (world.size[i, 0] + world.size[j, 0])
        if free < gap:
            gap, leader_speed = free, world.speed[j]
    return gap, leader_speed


@compiled
def beside_route(world: World, routes: Routes, j: int, sample: int) -> float:
    """m to the left of its route that vehicle j is, by the sample of the route nearest to it."""
    route = world.route[j]
    heading = routes.heading[route, sample]
    dx = world.position[j, 0] - routes.point[route, sample, 0]
    dy = world.position[j, 1] - routes.point[route, sample, 1]
    return float(dy * math.cos(heading) - dx * math.sin(heading))


@compiled
def idm_acceleration(speed: float, target_speed: float, gap: float, leader_speed: float) -> float:
    """The IDM acceleration, m/s2, never braking harder than the road allows."""
    free = 1.0 - (speed / max(target_speed, 0.1)) ** EXPONENT
    if gap == math.inf:
        return max(MAX_ACCELERATION * free, -COMFORTABLE_BRAKING)
    closing = speed * (speed - leader_speed) / (2.0 * math.sqrt(MAX_ACCELERATION * COMFORTABLE_BRAKING))
    wanted = MIN_GAP + max(0.0, speed * HEADWAY + closing)
    interaction = (wanted / max(gap, 0.1)) ** 2
    return max(MAX_ACCELERATION * (free - interaction), -HARDEST_BRAKING)


@inlined
def acceleration_of(world: World, routes: Routes, i: int) -> float:
    """What vehicle i's driver does now, m/s2."""
    if world.struck[i] >= 0:
        return -HARDEST_BRAKING
    if world.command[i, 0] == BRAKE:
        return -COMMANDED_BRAKING
    if world.driver[i] != IDM:  # scripted: at constant speed, whatever comes
        return 0.0
    gap, leader_speed = gap_to_leader(world, routes, i)
    acceleration = idm_acceleration(world.speed[i], world.target_speed[i], gap, leader_speed)
    to_line = world.stop_at[i] - world.progress[i] - 0.5 * world.size[i, 0]
    if to_line < LOOK_AHEAD:
        acceleration = min(acceleration, _acceleration_to_line(world, i, to_line))
    return acceleration


@compiled
def _acceleration_to_line(world: World, i: int, to_line: float) -> float:
    """What a red light asks of vehicle i, whose front is `to_line` m before it, m/s2; inf for nothing yet."""
    speed, late = world.speed[i], world.late_braking[i]
    needed = 0.5 * speed * speed / max(to_line - SHORT_OF_LINE, 0.1)
    if late > 0.0 and speed > SLOW:
        # Braking by no more than is needed keeps what is needed from falling, so whoever has begun goes on.
        return -needed if needed >= late else math.inf
    # The light is a standing vehicle whose rear bumper is MIN_GAP behind the line.
    return idm_acceleration(speed, world.target_speed[i], to_line + MIN_GAP, 0.0)


@compiled
def drives(driver: int) -> bool:
    """True for a vehicle that can move at all."""
    return driver != OFF and driver != STANDING
