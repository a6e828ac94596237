"""Tiny hand-made worlds, and whole episodes as numbers: what several tests stand on."""

import hashlib
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.road.road import RoadNetwork

from cad_env.envs.parallel import parallel_env
from cad_env.envs.single import CADEnv
from cad_env.scenarios import registry
from cad_env.scenarios.routes import RoutePlan, sample_routes
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.scene import Placement, place
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, CAR, GO, MAX_STEPS, Command
from cad_env.world.state import STANDING, Routes, World, empty_world
from cad_env.world.step import advance

everybody = partial(parallel_env, waiting=True)  # the multi-agent environment, in which who can only wait is an agent

# Routes of `cross()`: along +x and back on the same line, along +x one lane to the left, and across at x = 0.
EAST, WEST, BESIDE, NORTH = range(4)
ARM = 300.0  # m from the start of a route to the crossing
LANE = 3.5  # m


@cache
def cross() -> Routes:
    """Two straight roads that cross in the origin; whoever drives WEST is a ghost driver for whoever drives EAST."""
    ends = (((-ARM, 0), (ARM, 0)), ((ARM, 0), (-ARM, 0)), ((-ARM, LANE), (ARM, LANE)), ((0, -ARM), (0, ARM)))
    network, plans = RoadNetwork(), []
    for number, (start, end) in enumerate(ends):
        network.add_lane(f"from{number}", f"to{number}", StraightLane(start, end, LANE))
        plans.append(RoutePlan(str(number), ((f"from{number}", f"to{number}", 0),), (Command.FOLLOW_LANE,)))
    return sample_routes(network, plans)


def world_of(*vehicles: Placement) -> World:
    """A world on `cross()` with these vehicles in it."""
    return place(vehicles, cross())


def boxes(*placed: tuple[float, ...], kind: int = CAR) -> World:
    """Standing vehicles anywhere: x (m), y (m), heading (rad), and length and width (m) if not those of a car."""
    world = empty_world(len(placed))
    for row, (x, y, heading, *size) in enumerate(placed):
        world.position[row], world.heading[row] = (x, y), heading
        world.size[row] = size or (4.8, 1.9)
    world.kind[:], world.driver[:] = kind, STANDING
    return world


def moments(world: World, seconds: float, agents: tuple[int, ...] = (), action: int = GO) -> Iterator[float]:
    """Let the world go on, and yield the time, s, after every decision."""
    rows, scratch = np.array(agents, np.int64), np.zeros(len(world.speed))
    for step in range(round(seconds * 10)):
        advance(world, cross(), rows, np.full(len(rows), action), scratch)
        yield 0.1 * (step + 1)


def go_on(world: World, seconds: float, agents: tuple[int, ...] = (), action: int = GO) -> None:
    """Let the world go on."""
    for _ in moments(world, seconds, agents, action):
        pass


class Twitchy:
    """Brakes or goes by the digits of all it sees: any difference, anywhere, soon changes the episode."""

    privileged = False

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: dict[str, Any]) -> int:
        """BRAKE in about one decision of four."""
        digest = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in observation.values()))
        return BRAKE if digest.digest()[0] < 64 else GO

    def act_batch(self, observations: dict[str, Any]) -> np.ndarray:
        """What it would do one by one."""
        count = len(observations["mask"])
        return np.array([self.act({name: part[k] for name, part in observations.items()}) for k in range(count)])


class Steady:
    """The same action, whatever comes."""

    privileged = False

    def __init__(self, action: int) -> None:
        self.action = action

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Any) -> int:
        """The action."""
        return self.action


def started(seed: int, hazard: bool | None = None, **options: Any) -> Simulation:
    """A simulation at the start of the episode of a seed."""
    simulation = Simulation(setup_from(options))
    simulation.start(seed, hazard)
    return simulation


def steps(
    simulation: Simulation, count: int = MAX_STEPS, action: Callable[[int], int] = lambda agent: GO
) -> Iterator[int]:
    """Yield the step number at the start and after every decision, until the ego's episode ends or for `count`."""
    yield 0
    chosen = np.array([action(agent) for agent in range(len(simulation.agents))])
    while simulation.outcome() is None and simulation.steps < count:
        simulation.step(chosen)
        yield simulation.steps


def whole_episode(seed: int, count: int = MAX_STEPS, **options: Any) -> tuple[dict[str, np.ndarray], list[Any]]:
    """Every observation of an episode that Twitchy drives, stacked, and (reward, ended, info) of every step."""
    env, policy = CADEnv(**options), Twitchy()
    observation, info = env.reset(seed=seed)
    seen, rest = [observation], [(0.0, False, info)]
    while not rest[-1][1] and len(seen) <= count:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        seen.append(observation)
        rest.append((reward, terminated or truncated, info))
    env.close()
    return {name: np.stack([one[name] for one in seen]) for name in seen[0]}, rest


def digest(seed: int, **options: Any) -> str:
    """A whole episode as one number."""
    seen, rest = whole_episode(seed, **options)
    sha = hashlib.sha256(repr(rest).encode())
    for name, part in sorted(seen.items()):
        sha.update(name.encode() + part.tobytes())
    return sha.hexdigest()


def forget(scenario: Scenario) -> None:
    """Undo `cad_env.register`: other tests are of the scenarios that ship."""
    registry._known.pop(scenario.name, None)
    registry._found_at.pop(scenario.name, None)
    gym.registry.pop(scenario.gym_id, None)
