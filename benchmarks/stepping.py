"""How long steps take: every environment of ours, and the peers, each stepped in its plainest loop. CPU time."""

import time
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  registers the peer
import numba
import numpy as np
from crowd import crowds

import cad_env
from cad_env.simulation.scene_step import scene_at
from cad_env.world.state import OFF
from cad_env.world.step import advance

PEER_ID, AGENTS_PEER_ID = "intersection-v0", "intersection-multi-agent-v0"
IDLE = 1  # the peers' "keep lane and speed"
EPISODE = 80  # steps of the bare world between two draws of its scenes: 8 s, about an episode
VEHICLES, SCENES = 12, 64  # of the bare world


@dataclass
class Measured:
    """Steps and resets of one repeat, and the CPU time they took, s."""

    steps: int = 0
    stepping: float = 0.0
    resets: int = 0
    resetting: float = 0.0
    vehicles: int = 0  # summed over the steps

    @property
    def rate(self) -> float:
        """Steps a second."""
        return self.steps / self.stepping


def single(env: gym.Env[Any, Any], action: Any, steps: int, first_seed: int) -> Measured:
    """Step a Gymnasium environment, a new seed whenever an episode ends."""
    result = Measured()
    while result.steps < steps:
        start = time.process_time()
        env.reset(seed=first_seed + result.resets)
        reset = time.process_time()
        over, taken = False, 0
        while not over and result.steps + taken < steps:
            _, _, terminated, truncated, _ = env.step(action)
            over, taken = terminated or truncated, taken + 1
        result.stepping += time.process_time() - reset
        result.resetting += reset - start
        result.resets, result.steps = result.resets + 1, result.steps + taken
        result.vehicles += taken * len(env.unwrapped.road.vehicles)  # as many as at the end of the episode
    return result


def parallel(env: Any, steps: int, first_seed: int) -> Measured:
    """Step the multi-agent environment while all its agents are there."""
    result = Measured()
    while result.steps < steps:
        env.reset(seed=first_seed + result.resets)
        everyone, actions = len(env.agents), dict.fromkeys(env.agents, cad_env.GO)
        start, taken = time.process_time(), 0
        while len(env.agents) == everyone and result.steps + taken < steps:
            env.step(actions)
            taken += 1
        result.stepping += time.process_time() - start
        result.resets, result.steps = result.resets + 1, result.steps + taken
    return result


def vector(env: Any, steps: int, first_seed: int) -> Measured:
    """Step a vector environment, all of whose scenes go; episodes that end are reset on the clock, as its users do."""
    result = Measured()
    start = time.process_time()
    env.reset(seed=first_seed)
    result.resetting, result.resets = time.process_time() - start, env.num_envs
    go = np.full(env.num_envs, cad_env.GO)
    start = time.process_time()
    while result.steps < steps:
        env.step(go)
        result.steps += env.num_envs
    result.stepping = time.process_time() - start
    return result


@numba.njit
def _advance_all(records: Any, times: int) -> None:
    for _ in range(times):
        for place in range(SCENES):
            scene = scene_at(records, place)
            advance(scene.world, scene.routes, scene.fleet.rows, scene.actions, scene.scratch)


class World:
    """The bare world of many scenes side by side, twelve vehicles in each: drivers, motion and contact."""

    def __init__(self) -> None:
        self._ensemble = crowds(SCENES, VEHICLES, connected=1)

    def stepped(self, steps: int, first_seed: int) -> Measured:
        """Step it."""
        result = Measured()
        while result.steps < steps:
            for place in range(SCENES):
                self._ensemble.start(place, first_seed + result.resets + place, hazard=True)
            start = time.process_time()
            _advance_all(self._ensemble.batch_state.records, EPISODE)
            result.stepping += time.process_time() - start
            result.resets, result.steps = result.resets + SCENES, result.steps + SCENES * EPISODE
            result.vehicles += sum(EPISODE * int((s.world.driver != OFF).sum()) for s in self._ensemble.simulations)
        return result


def peer(simulation_hz: int, env_id: str = PEER_ID, **config: Any) -> gym.Env[Any, Any]:
    """highway-env's own intersection, deciding at 10 Hz as ours does."""
    gym.logger.min_level = gym.logger.ERROR  # that there is a v2 of it is known; v0 is the faster one
    return gym.make(env_id, config={"policy_frequency": 10, "simulation_frequency": simulation_hz, **config})
