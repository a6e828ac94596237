"""What a step is worth: a function of it, or the name of one of `REWARDS`, which all environments take as `reward=`.

>>> def in_time(step: StepOutcome) -> float:
...     return progress(step) - 0.01  # each decision costs a little
>>> from cad_env.envs.single import CADEnv
>>> env = CADEnv(reward=in_time)
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cad_env.checks import ConfigError, did_you_mean
from cad_env.simulation.simulation import FINAL_REWARD, Simulation
from cad_env.types import COLLISION, STEP, SUCCESS

COLLISION_COST = 2.0  # of the rewards that put safety first: that of one collision, in arrivals
SECOND_COST = 0.02  # of a second in `time-and-safety`: waiting until time is up (40 s) costs 0.8 arrivals


@dataclass(frozen=True)
class StepOutcome:
    """One decision of one agent and what came of it."""

    action: int  # GO or BRAKE
    travelled: float  # m along its route in this step
    progress: float  # the same as a share of the way from its start to its goal; 0 for an agent that can only wait
    speed: float  # m/s, now
    time: float  # s since the start of the episode
    outcome: str | None  # success, collision, timeout, waited, or None while the episode goes on for it
    hazard: bool  # whether the episode holds a hazard: known to nobody who drives
    min_ttc: float  # s, its least time to contact so far at the speeds and headings of each moment; inf beyond 5 s
    bytes_sent: int  # by this agent in this step


def ego_step(simulation: Simulation, action: int, before: float) -> StepOutcome:
    """The newest step of an ego that was `before` m along its route."""
    world, scene = simulation.world, simulation.scene
    travelled = float(world.progress[0]) - before
    return StepOutcome(
        action=action, travelled=travelled, progress=travelled / simulation.way, speed=float(world.speed[0]),
        time=simulation.time, outcome=simulation.outcome(), hazard=scene.hazard,
        min_ttc=simulation.min_ttc, bytes_sent=int(simulation.fleet.report.sent_bytes[0]),
    )  # fmt: skip


Reward = Callable[[StepOutcome], float]


def progress(step: StepOutcome) -> float:
    """The share of the way that was covered, +1 on arrival, -1 on a collision: the default."""
    return step.progress + FINAL_REWARD.get(step.outcome, 0.0)


def safety_first(step: StepOutcome) -> float:
    """The share of the way that was covered, +1 on arrival, -2 on a collision."""
    return step.progress + (step.outcome == SUCCESS) - COLLISION_COST * (step.outcome == COLLISION)


def time_and_safety(step: StepOutcome) -> float:
    """As `safety_first`, and -0.02 for every second: who cannot but wait for time to pass pays for it too."""
    return safety_first(step) - SECOND_COST * STEP


REWARDS: dict[str, Reward] = {
    "progress": progress,
    "safety-first": safety_first,
    "time-and-safety": time_and_safety,
}


def reward_named(given: Any) -> Reward:
    """A reward by its name, or a function as it is; ValueError that lists the choices for anything else."""
    if callable(given):
        found: Reward = given
        return found
    if not isinstance(given, str) or given not in REWARDS:
        choices = f"a function of a StepOutcome or one of {', '.join(REWARDS)}"
        raise ConfigError(f"reward must be {choices}, got {given!r}{did_you_mean(given, REWARDS)}")
    return REWARDS[given]
