"""One decision's worth of world: drivers, motion and contact, at 20 Hz."""

import math

from cad_env.numerics.jit import compiled, inlined
from cad_env.types import STEP, Floats, Ints
from cad_env.world.drivers import acceleration_of, drives
from cad_env.world.dynamics import drive
from cad_env.world.geometry import ALONG, boxes_touch
from cad_env.world.state import OFF, Routes, World

# At 40 m/s closing speed two cars approach by 2 m a sub-step, less than the length of either: nothing tunnels.
SUBSTEPS = 2
SUBSTEP = STEP / SUBSTEPS


@compiled
def command(world: World, i: int, action: int) -> None:
    """Queue GO or BRAKE for vehicle i; it takes force COMMAND_DELAY decisions later."""
    queue = world.command[i]
    for k in range(queue.shape[0] - 1):
        queue[k] = queue[k + 1]
    queue[-1] = action


@inlined
def substep(world: World, routes: Routes, acceleration: Floats, dt: float) -> None:
    """Everybody decides on what is, then everybody moves, then contacts are noted. `acceleration`: (N,) scratch."""
    count = world.speed.shape[0]
    for i in range(count):
        if drives(world.driver[i]):
            acceleration[i] = acceleration_of(world, routes, i, dt)
    for i in range(count):
        if drives(world.driver[i]):
            drive(world, routes, i, acceleration[i], dt)
            if world.progress[i] >= routes.length[world.route[i]]:
                world.driver[i] = OFF
    note_contacts(world)


@inlined
def note_contacts(world: World) -> None:
    """Mark every pair of vehicles that touch; a vehicle remembers the first it touched."""
    position, heading, size, struck = world.position, world.heading, world.size, world.struck
    count = heading.shape[0]
    for i in range(count):
        if world.driver[i] == OFF:
            continue
        for j in range(i + 1, count):
            if world.driver[j] == OFF or (struck[i] >= 0 and struck[j] >= 0):
                continue
            dx, dy = position[i, 0] - position[j, 0], position[i, 1] - position[j, 1]
            if dx * dx + dy * dy > 400.0:  # no two vehicles of up to 18 m touch beyond 20 m
                continue
            if boxes_touch(
                position[i, 0], position[i, 1], heading[i], size[i, 0], size[i, 1],
                position[j, 0], position[j, 1], heading[j], size[j, 0], size[j, 1],
            ):  # fmt: skip
                if struck[i] < 0:
                    struck[i] = j
                if struck[j] < 0:
                    struck[j] = i


@compiled
def struck_from_behind(world: World, i: int) -> bool:
    """True if the first vehicle that touched vehicle i came from behind it and heads where it does, within 40 degrees.

    It says where the other was, not whose fault it was.
    """
    j = world.struck[i]
    if j < 0:
        return False
    cos, sin = math.cos(world.heading[i]), math.sin(world.heading[i])
    ahead = (world.position[j, 0] - world.position[i, 0]) * cos + (world.position[j, 1] - world.position[i, 1]) * sin
    return bool(ahead < 0.0 and math.cos(world.heading[j] - world.heading[i]) > ALONG)


@compiled
def advance(world: World, routes: Routes, agents: Ints, actions: Ints, acceleration: Floats) -> None:
    """One decision (0.1 s): queue the action of each agent (row), then move the world. `acceleration`: scratch."""
    for k in range(agents.shape[0]):
        command(world, agents[k], actions[k])
    for _ in range(SUBSTEPS):
        substep(world, routes, acceleration, SUBSTEP)
