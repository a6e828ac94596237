"""Who presses the pedals: the Intelligent Driver Model on bumper gaps, red lights, and the GO/BRAKE command.

IDM: Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic
simulations", Phys. Rev. E 62 (2000). Gaps are measured from bumper to bumper and a leader is whoever's route
runs along the own one, so that a truck is seen as long as it is.

A STREAM driver follows who drives on its own route. For anybody else in its way, who crosses it, merges into it or
comes towards it, it brakes by the same model only if it is attentive, and only after its reaction time.

A YIELDING driver is an IDM driver that stops at the line of its route while it has to give way there.
"""

import math

from cad_env.numerics.jit import compiled, inlined
from cad_env.types import BRAKE
from cad_env.world.priority import BEFORE_LINE, distance_to_line, gives_way
from cad_env.world.state import OFF, SCRIPTED, STANDING, STREAM, YIELDING, Routes, World

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
SLOWER = 0.05  # m/s by which a leader must be slower for a STREAM driver to brake for it


@inlined
def gap_to_leader(world: World, routes: Routes, i: int) -> tuple[float, float]:
    """(bumper gap m, leader's speed m/s) to the nearest vehicle in the way on i's route; (inf, 0) if none.

    For a STREAM driver only who has the same route is a leader; `gap_to_intruder` is about all others.
    """
    gap, leader_speed = math.inf, 0.0
    own, narrow = world.route[i], world.driver[i] == STREAM
    last = routes.projection.shape[2] - 1
    for j in range(world.speed.shape[0]):
        if j == i or world.driver[j] == OFF or (narrow and world.route[j] != own):
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
def acceleration_of(world: World, routes: Routes, i: int, dt: float) -> float:
    """What vehicle i's driver does now, m/s2; dt: s since it decided last."""
    if world.struck[i] >= 0:
        return -HARDEST_BRAKING
    if world.command[i, 0] == BRAKE:
        return -COMMANDED_BRAKING
    if world.driver[i] == SCRIPTED:
        return 0.0
    speed, target = world.speed[i], world.target_speed[i]
    gap, leader_speed = gap_to_leader(world, routes, i)
    if world.driver[i] == STREAM and leader_speed > speed - SLOWER:
        gap = math.inf
    acceleration = idm_acceleration(speed, target, gap, leader_speed)
    to_line = world.stop_at[i] - world.progress[i] - 0.5 * world.size[i, 0]
    if to_line < LOOK_AHEAD:
        acceleration = min(acceleration, _acceleration_to_line(world, i, to_line))
    if world.driver[i] == YIELDING and gives_way(world, routes, i):
        # It stands a little before its line: at the line itself nobody could tell whether it goes on.
        ahead = distance_to_line(world, routes, i) - BEFORE_LINE
        acceleration = min(acceleration, idm_acceleration(speed, target, ahead + MIN_GAP, 0.0))
    if world.attention[i] < math.inf:
        gap, other_speed = gap_to_intruder(world, i)
        world.noticed[i] = world.noticed[i] + dt if gap < math.inf else 0.0
        if world.noticed[i] >= world.attention[i]:
            acceleration = min(acceleration, idm_acceleration(speed, target, gap, other_speed))
    return acceleration


@compiled
def gap_to_intruder(world: World, i: int) -> tuple[float, float]:
    """(m from i's front, m/s along i's way) of the nearest vehicle of another route in i's way; (inf, 0) if none.

    i's way is taken to be straight on. What stands for the whole episode is no surprise.
    """
    gap, other_speed = math.inf, 0.0
    cos, sin = math.cos(world.heading[i]), math.sin(world.heading[i])
    for j in range(world.speed.shape[0]):
        if j == i or not drives(world.driver[j]) or world.route[j] == world.route[i]:
            continue
        dx, dy = world.position[j, 0] - world.position[i, 0], world.position[j, 1] - world.position[i, 1]
        ahead = dx * cos + dy * sin
        if not 0.0 < ahead < LOOK_AHEAD:
            continue
        turn = world.heading[j] - world.heading[i]
        along, across = abs(math.cos(turn)), abs(math.sin(turn))
        wide = 0.5 * (world.size[j, 0] * across + world.size[j, 1] * along)
        if abs(dy * cos - dx * sin) > wide + 0.5 * world.size[i, 1] + SIDE_MARGIN:
            continue
        free = ahead - 0.5 * (world.size[j, 0] * along + world.size[j, 1] * across) - 0.5 * world.size[i, 0]
        if free < gap:
            gap, other_speed = free, world.speed[j] * math.cos(turn)
    return gap, other_speed


@compiled
def _acceleration_to_line(world: World, i: int, to_line: float) -> float:
    """What a red light asks of vehicle i, whose front is `to_line` m before it, m/s2; inf for nothing yet."""
    speed, late = world.speed[i], world.late_braking[i]
    needed = 0.5 * speed * speed / max(to_line - SHORT_OF_LINE, 0.1)
    if late > 0.0 and speed > SLOW:
        # Braking by no more than is needed keeps what is needed from falling, so whoever has begun goes on.
        return -min(needed, HARDEST_BRAKING) if needed >= late else math.inf
    # The light is a standing vehicle whose rear bumper is MIN_GAP behind the line.
    return idm_acceleration(speed, world.target_speed[i], to_line + MIN_GAP, 0.0)


@compiled
def drives(driver: int) -> bool:
    """True for a vehicle that can move at all."""
    return driver != OFF and driver != STANDING
