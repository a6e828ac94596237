"""What nobody has seen is reckoned with: a receiver's hidden places hold every vehicle on the lanes that it meets."""

from typing import NamedTuple

import numpy as np
import pytest
from scenes import started, steps

from cad_env.config import RadioConfig
from cad_env.scenarios import SHIPPED
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, GO, STEP
from cad_env.world.lanes import PLACE, PLACES
from cad_env.world.state import OFF

PERFECT = {"miss": 0.0, "noise": 0.0}
SEEDS = 5_000_000
TRACKED = 3.0  # m from the newest node of a track, within which a vehicle is taken to be the one that is tracked


class Met(NamedTuple):
    """What was found in an episode."""

    steps: int  # of a receiver
    violated: int  # of them with a vehicle that is neither tracked nor in a hidden place
    unseen: int  # vehicles that were in a hidden place and not tracked, summed over every tenth step


def options(rng: np.random.Generator) -> dict:
    """A penetration, losses and a delay by chance."""
    loss, delay = rng.uniform(0.0, 0.7), 0.1 * rng.integers(0, 6)
    burst = float(rng.choice([1.0, 5.0])) if loss > 0.0 else 1.0
    radio = RadioConfig(loss=float(loss), delay=float(delay), burst=burst)
    return {"penetration": float(rng.uniform()), "radio": radio, "traffic": str(rng.choice(["none", "light", "dense"]))}


def untracked(simulation: Simulation, receiver: int, row: int) -> bool:
    """Whether a vehicle is nowhere near the newest node of any track in the receiver's merged graph."""
    known, place = simulation.merged_graph(receiver), simulation.world.position[row]
    for position, mask in zip(known.position, known.mask, strict=True):
        newest = int(np.flatnonzero(mask)[-1])
        late = (mask.shape[0] - 1 - newest) * STEP
        if np.hypot(*(position[newest, :2] - place)) < TRACKED + late * simulation.world.speed[row]:
            return False
    return True


def outside(simulation: Simulation, receiver: int) -> tuple[int, int]:
    """Of a receiver's lanes: vehicles neither tracked nor in a hidden place; in every tenth step, those that are."""
    world, lanes, hidden = simulation.world, simulation.map.lanes, simulation.fleet.hidden
    own, lost, unseen = int(simulation.agents[receiver]), 0, 0
    for k, lane in enumerate(lanes.other[world.route[own]].tolist()):
        for row in np.flatnonzero((world.route == lane) & (world.driver != OFF)).tolist() if lane >= 0 else []:
            place = int((world.progress[row] - lanes.start[lane]) // PLACE)
            if row == own or place < 0 or world.progress[row] > lanes.exit[world.route[own], k]:
                continue
            assert place < PLACES
            there = bool(hidden.places[receiver, k, place])
            if not there:
                lost += untracked(simulation, receiver, row)
            elif simulation.steps % 10 == 0:  # to know that the law is not empty
                unseen += untracked(simulation, receiver, row)
    return lost, unseen


def met(seed: int, **options) -> Met:
    """Follow an episode, in which the ego goes or brakes by chance."""
    rng = np.random.default_rng(seed)
    simulation = started(seed, coverage=True, **options)
    brakes, found = rng.integers(0, 60), Met(0, 0, 0)
    for step in steps(simulation, action=lambda agent: BRAKE if agent == 0 and seed % 2 else GO):
        receivers = range(len(simulation.agents)) if step == brakes else [0]
        for receiver in receivers:
            if simulation.world.driver[simulation.agents[receiver]] == OFF:
                continue
            lost, unseen = outside(simulation, receiver)
            found = Met(found.steps + 1, found.violated + (lost > 0), found.unseen + unseen)
    return found


def summed(scenario: str, episodes: int, sensor: dict) -> Met:
    """Over many episodes of a scene."""
    total = np.zeros(3, int)
    for episode in range(episodes):
        total += met(SEEDS + episode, scenario=scenario, sensor=sensor, **options(np.random.default_rng(episode)))
    return Met(*total.tolist())


@pytest.mark.parametrize("scenario", SHIPPED)
@pytest.mark.parametrize("episodes", [4, pytest.param(300, marks=pytest.mark.slow)])
def test_with_perfect_sensing_nobody_is_where_nobody_can_be(scenario: str, episodes: int) -> None:
    found = summed(scenario, episodes, PERFECT)
    assert found.violated == 0
    assert found.unseen > 2 * episodes


@pytest.mark.parametrize("scenario", SHIPPED)
@pytest.mark.parametrize("episodes", [4, pytest.param(300, marks=pytest.mark.slow)])
def test_with_the_usual_sensing_hardly_anybody_is(scenario: str, episodes: int) -> None:
    found = summed(scenario, episodes, {})
    assert found.violated <= 0.005 * found.steps
