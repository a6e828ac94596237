"""How close it is: the time to contact if everybody keeps speed and heading."""

import math

from cad_env.numerics.jit import compiled
from cad_env.world.geometry import boxes_touch
from cad_env.world.state import OFF, World

_HORIZON = 5.0  # s, as nuPlan's time-to-collision metric looks ahead
RESOLUTION = 0.1  # s


@compiled
def time_to_contact(world: World, i: int) -> float:
    """Seconds until vehicle i's box touches another's at constant velocities; inf beyond the horizon."""
    soonest = math.inf
    vx, vy = world.speed[i] * math.cos(world.heading[i]), world.speed[i] * math.sin(world.heading[i])
    for j in range(world.speed.shape[0]):
        if j == i or world.driver[j] == OFF:
            continue
        dx, dy = world.position[j, 0] - world.position[i, 0], world.position[j, 1] - world.position[i, 1]
        ux = world.speed[j] * math.cos(world.heading[j]) - vx
        uy = world.speed[j] * math.sin(world.heading[j]) - vy
        # Nearest approach of the two circles: most pairs never come close, and cost no box test.
        square = ux * ux + uy * uy
        nearest = 0.0 if square < 1e-9 else min(max(-(dx * ux + dy * uy) / square, 0.0), _HORIZON)
        away = (dx + nearest * ux) ** 2 + (dy + nearest * uy) ** 2
        if away > (world.size[i, 0] + world.size[j, 0]) ** 2:  # no width is greater than its length: spares the roots
            continue
        reach = 0.5 * (math.hypot(world.size[i, 0], world.size[i, 1]) + math.hypot(world.size[j, 0], world.size[j, 1]))
        if away > reach * reach:
            continue
        for step in range(int(_HORIZON / RESOLUTION) + 1):
            time = step * RESOLUTION
            if time >= soonest:
                break
            if boxes_touch(
                0.0, 0.0, world.heading[i], world.size[i, 0], world.size[i, 1],
                dx + time * ux, dy + time * uy, world.heading[j], world.size[j, 0], world.size[j, 1],
            ):  # fmt: skip
                soonest = time
                break
    return soonest
