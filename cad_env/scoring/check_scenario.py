"""Is a scenario worth scoring in? What must hold of one before a collision rate in it means anything.

>>> from cad_env.scoring.check_scenario import check_scenario, lines_of
>>> print(lines_of(check_scenario("left_turn", episodes=20)))  # doctest: +SKIP
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cad_env.checks import check_seed, check_whole
from cad_env.envs.vector import CADVectorEnv
from cad_env.rules.blind import BEFORE, Blind, Slow, Stop, conflict_of
from cad_env.rules.expert import expert_of
from cad_env.scenarios import scenario_named
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scenario import Scenario
from cad_env.scenarios.scene import EGO, place
from cad_env.scoring.oracle import best_time
from cad_env.scoring.rollout import Episode, rollouts
from cad_env.scoring.scorecard import record_of
from cad_env.scoring.table import text_table
from cad_env.scoring.time_lost import time_lost
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import COLLISION, GO, SUCCESS, Policy
from cad_env.world.state import crashed
from cad_env.world.step import note_contacts

_AT_ONCE = 16  # scenes side by side
LEAD = 2.0  # s before an ego that never brakes would be hit, when it must be told: it stops within that
ORACLE = 5  # one of so many episodes is searched for the best possible time: it takes a second each
SAFE, FAST = 0.05, 5.0  # a control with no more collisions and no more s lost than this passes with closed eyes


@dataclass(frozen=True)
class Verdict:
    """One line: what was looked at, what was found and wanted, and whether it holds."""

    what: str
    found: str
    wanted: str
    holds: bool


def check_scenario(
    scenario: str | Scenario, episodes: int = 200, first_seed: int = 0, traffic: str = "light"
) -> list[Verdict]:
    """Drive the seeds from `first_seed` on by an expert, an ego that never brakes and controls with closed eyes.

    200 episodes take about a minute on one core. ConfigError, one line, for what is no scenario or no number.
    """
    made = scenario_named(scenario)
    check_whole("episodes", episodes, 1, 100_000)
    check_seed("first_seed", first_seed)
    seeds, options = range(first_seed, first_seed + episodes), {"scenario": made.name, "traffic": traffic}
    going = _driven(Blind(0.0), seeds, options)
    expert = _driven(expert_of(made), seeds, options)
    return [
        _hazards(going),
        _arrives(going),
        *_of_the_expert(expert),
        _oracle(made, traffic, expert),
        _no_overlap(made, traffic, seeds),
        *_watched(seeds, options),
        *_frontier(made, seeds, options, going, expert),
    ]


def lines_of(verdicts: Sequence[Verdict]) -> str:
    """The verdicts as a table."""
    rows = [(each.what, each.found, each.wanted, "holds" if each.holds else "DOES NOT HOLD") for each in verdicts]
    return text_table(("what", "found", "wanted", "verdict"), rows, names=1)


def _driven(policy: Policy, seeds: range, options: dict[str, Any]) -> list[Episode]:
    envs = CADVectorEnv(min(_AT_ONCE, len(seeds)), radio="none", **options)
    return sorted(rollouts(envs, policy, seeds), key=lambda episode: episode.seed)


def _share(episodes: Sequence[Episode], outcome: str) -> float:
    return float(np.mean([episode.outcome == outcome for episode in episodes])) if episodes else math.nan


def _hazards(going: Sequence[Episode]) -> Verdict:
    share = float(np.mean([episode.hazard for episode in going]))
    return Verdict("episodes with a hazard", f"{100 * share:.1f} %", "20 to 80 %", 0.2 <= share <= 0.8)


def _arrives(going: Sequence[Episode]) -> Verdict:
    share = _share([episode for episode in going if not episode.hazard], SUCCESS)
    return Verdict("without one, who never brakes arrives", f"{100 * share:.1f} %", "99 % or more", share >= 0.99)


def _of_the_expert(expert: Sequence[Episode]) -> list[Verdict]:
    collisions, arrivals = _share(expert, COLLISION), _share(expert, SUCCESS)
    return [
        Verdict("the expert collides", f"{100 * collisions:.1f} %", "0.5 % or less", collisions <= 0.005),
        Verdict("the expert arrives in time", f"{100 * arrivals:.1f} %", "98 % or more", arrivals >= 0.98),
    ]


def _oracle(made: Scenario, traffic: str, expert: Sequence[Episode]) -> Verdict:
    """How much later than the best possible time the expert arrives."""
    ranges, conflict, lost = made.configured({}), conflict_of(made.name), []
    for episode in expert[::ORACLE]:
        best = best_time(made.scene(ranges, Traffic(traffic), episode.seed), made.map.routes, conflict)
        if best < math.inf and episode.outcome != COLLISION:
            lost.append(episode.time - best)
    mean = float(np.mean(lost)) if lost else math.nan
    return Verdict("the expert loses against the best possible", f"{mean:.2f} s", "3 s or less", mean <= 3.0)


def _no_overlap(made: Scenario, traffic: str, seeds: range) -> Verdict:
    ranges, found = made.configured({}), 0
    for seed in seeds:
        world = place(made.scene(ranges, Traffic(traffic), seed).placements, made.map.routes)
        note_contacts(world)
        found += bool(crashed(world).any())
    return Verdict("vehicles overlap at the start", f"{found} episodes", "0", found == 0)


def _watched(seeds: range, options: dict[str, Any]) -> list[Verdict]:
    """With an ego that acts at random: does anybody else touch? With one that goes: is it told in time?"""
    contacts, hazards, told = 0, 0, 0
    simulation = Simulation(setup_from(options))
    for seed in seeds:
        rng = np.random.default_rng(seed)
        simulation.start(seed, receivers=1)
        touched = False
        while simulation.outcome() is None:
            touched = touched or bool(crashed(simulation.world)[EGO + 1 :].any())
            _step(simulation, int(rng.random() < 0.5))
        # Whoever touched the ego ends the episode, so a contact seen before that was one without it.
        contacts += touched
        simulation.start(seed, receivers=1)
        if simulation.scene.hazard:
            hazards += 1
            told += _is_told(simulation)
    share = told / hazards if hazards else math.nan
    return [
        Verdict("others touch each other", f"{contacts} episodes", "0", contacts == 0),
        Verdict("another sees the hazard in time, the ego not", f"{100 * share:.1f} %", "80 % or more", share >= 0.8),
    ]


def _is_told(simulation: Simulation) -> bool:
    """True if, up to `LEAD` before it would be hit, another connected vehicle sees who hits it and the ego does not."""
    row, until = simulation.scene.hazard_row, simulation.scene.hazard_time - LEAD
    while simulation.time < until and simulation.outcome() is None:
        ego, *others = simulation.fleet.visible[:, row]
        if any(others) and not ego:
            return True
        _step(simulation, GO)
    return False


def _step(simulation: Simulation, action: int) -> None:
    actions = np.zeros(len(simulation.agents), np.int64)
    actions[0] = action
    simulation.step(actions)


def _frontier(
    made: Scenario, seeds: range, options: dict[str, Any], going: Sequence[Episode], expert: Sequence[Episode]
) -> list[Verdict]:
    """Of each control with closed eyes: does it pass?"""
    place_to_stop = conflict_of(made.name) - BEFORE
    controls: dict[str, Policy] = {f"blind-{wait:g}": Blind(wait) for wait in (1.0, 4.0, 12.0)}
    controls |= {f"stop-{wait:g}": Stop(place_to_stop, wait) for wait in (1.0, 8.0)}
    controls |= {f"slow-{speed:g}": Slow(speed) for speed in (4.0, 7.0)}
    best = [record_of(episode) for episode in expert]
    driven = {"blind-0": going} | {name: _driven(policy, seeds, options) for name, policy in controls.items()}
    found = []
    for name, episodes in driven.items():
        lost, collisions = time_lost([record_of(episode) for episode in episodes], best), _share(episodes, COLLISION)
        late = math.inf if lost is None else lost.mean.value
        said = f"{100 * collisions:.1f} %, {late:.1f} s lost"
        passes = collisions <= SAFE and late <= FAST
        found.append(Verdict(f"{name} collides", said, f"over {100 * SAFE:g} % or {FAST:g} s", not passes))
    return found
