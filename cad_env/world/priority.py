"""Who goes first where no light says so: priority to the right, on the truth, as a YIELDING driver keeps it.

Whoever is on the left of another gives way to it, and who turns left to those that come towards it. A STREAM driver
gives way to nobody. A driver waits at its line until everybody whom it lets pass, and who is near enough to matter,
is through, and until the junction is free of all whose way crosses its own. Where all that wait would wait for each
other, the one whose front is nearest to its line goes first.
"""

import math

from cad_env.numerics.jit import compiled
from cad_env.world.state import OFF, STANDING, STREAM, Routes, World

BEGINS = 45.0  # m before its line, from where on a driver looks out for others
_APART = 1.0  # s between one and another on the same ground
STOPS = 6.0  # m/s2: whoever would have to brake harder for its line goes on
STARTS = 2.0  # m/s2
BEFORE_LINE = 1.0  # m before its line, where whoever gives way comes to stand
AT_LINE = 4.0  # m before its line, within which a vehicle that stands waits there
_STANDS = 0.3  # m/s


@compiled
def distance_to_line(world: World, routes: Routes, i: int) -> float:
    """m from the front of vehicle i to the line of its route; negative beyond it, inf where there is none."""
    return float(routes.line[world.route[i]] - world.progress[i] - 0.5 * world.size[i, 0])


@compiled
def is_committed(world: World, routes: Routes, i: int) -> bool:
    """True if vehicle i is beyond its line, or can stop there no more, or gives way to nobody."""
    return bool(world.driver[i] == STREAM or 0.5 * world.speed[i] ** 2 / STOPS > distance_to_line(world, routes, i))


@compiled
def waits_at_line(world: World, routes: Routes, i: int) -> bool:
    """True if vehicle i stands at its line."""
    return bool(
        world.speed[i] < _STANDS and 0.0 <= distance_to_line(world, routes, i) < AT_LINE and world.driver[i] != STANDING
    )


@compiled
def seconds_to(speed: float, wanted: float, distance: float) -> float:
    """s that a vehicle takes for a distance, m, if it speeds up to the speed it wants."""
    if distance <= 0.0:
        return 0.0
    until = max(wanted * wanted - speed * speed, 0.0) / (2.0 * STARTS)  # m until it is that fast
    if distance <= until:
        return (math.sqrt(speed * speed + 2.0 * STARTS * distance) - speed) / STARTS
    fastest = max(wanted, speed)
    return (fastest - speed) / STARTS + (distance - until) / fastest


@compiled
def meets_in_time(world: World, routes: Routes, i: int, j: int) -> bool:
    """True if vehicles i and j would be less than _APART apart on the ground that both need."""
    a, b = world.route[i], world.route[j]
    front, rear = world.progress[i] + 0.5 * world.size[i, 0], world.progress[i] - 0.5 * world.size[i, 0]
    other_front, other_rear = world.progress[j] + 0.5 * world.size[j, 0], world.progress[j] - 0.5 * world.size[j, 0]
    if math.isnan(routes.meets[a, b, 0]) or other_rear > routes.meets[a, b, 3] or rear > routes.meets[a, b, 1]:
        return False
    into = seconds_to(world.speed[i], world.target_speed[i], routes.meets[a, b, 0] - front)
    out = seconds_to(world.speed[i], world.target_speed[i], routes.meets[a, b, 1] - rear)
    other_into = seconds_to(world.speed[j], world.target_speed[j], routes.meets[a, b, 2] - other_front)
    other_out = (routes.meets[a, b, 3] - other_rear) / max(world.speed[j], _STANDS)
    return out + _APART > other_into and other_out + _APART > into


@compiled
def goes_first(world: World, routes: Routes, i: int) -> bool:
    """True if vehicle i is nearer to its line than everybody else who stands at one."""
    own = distance_to_line(world, routes, i)
    for j in range(world.speed.shape[0]):
        if j != i and world.driver[j] != OFF and waits_at_line(world, routes, j):
            other = distance_to_line(world, routes, j)
            if other < own or (other == own and j < i):
                return False
    return own < AT_LINE


@compiled
def gives_way(world: World, routes: Routes, i: int) -> bool:
    """True if vehicle i, which has not passed its line, has to let somebody pass."""
    if distance_to_line(world, routes, i) > BEGINS or is_committed(world, routes, i):
        return False
    stuck = False
    for j in range(world.speed.shape[0]):
        if j == i or world.driver[j] == OFF or world.driver[j] == STANDING or not meets_in_time(world, routes, i, j):
            continue
        if is_committed(world, routes, j):
            return True
        if routes.yields[world.route[i], world.route[j]]:
            if world.speed[j] > _STANDS:
                return True
            stuck = stuck or waits_at_line(world, routes, j)  # who stands farther back has somebody before it
    return stuck and not goes_first(world, routes, i)
