"""Who knows the truth and shows how to drive: the rules on the truth, or what a scenario brings of its own."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cad_env.numerics.jit import compiled
from cad_env.rules.planner import PlannerConfig, Rule, decide, oncoming_stretch, stopping_distance
from cad_env.scenarios import scenario_named
from cad_env.scenarios.scenario import Scenario
from cad_env.simulation.scene_step import Truths, scene_at
from cad_env.types import ROUTE_SPACING, Ints, Policy
from cad_env.world.state import OFF, Routes, Truth, World


@compiled
def decide_on_truth(world: World, routes: Routes, row: int, rule: Rule) -> int:
    """The expert's decision for one vehicle of the world."""
    count = world.speed.shape[0]
    others = np.empty((count, 6))
    n = 0
    for k in range(count):
        if k == row or world.driver[k] == OFF:
            continue
        others[n, 0], others[n, 1] = world.position[k, 0], world.position[k, 1]
        others[n, 2], others[n, 3] = world.heading[k], world.speed[k]
        others[n, 4], others[n, 5] = world.size[k, 0], world.size[k, 1]
        n += 1
    last = routes.point.shape[1] - 1
    route = world.route[row]
    here = min(int(world.progress[row] / routes.spacing + 0.5), last)
    stretch = oncoming_stretch(routes.oncoming[route, here:], routes.spacing)
    seen = stopping_distance(world.speed[row]) + rule.clear
    if stretch[0] <= stopping_distance(world.speed[row]) + rule.gate:
        seen = max(seen, stretch[1])
    way = np.empty((int(seen / ROUTE_SPACING) + 3, 2))
    for p in range(way.shape[0]):
        index = min(int((world.progress[row] + p * ROUTE_SPACING) / routes.spacing + 0.5), last)
        way[p, 0], way[p, 1] = routes.point[route, index, 0], routes.point[route, index, 1]
    way[0, 0], way[0, 1] = world.position[row, 0], world.position[row, 1]
    ego = np.array([world.speed[row], world.target_speed[row], world.size[row, 0], world.size[row, 1]])
    return decide(way, ego, others[:n], stretch, rule)


@dataclass
class Expert:
    """The same rules on the truth: whom the networks imitate."""

    config: PlannerConfig = field(default_factory=PlannerConfig)
    privileged: bool = True

    def reset(self, seed: int) -> None:
        """Nothing to forget: the rules have no memory."""

    def act(self, observation: Truth) -> int:
        """GO or BRAKE on the truth."""
        return decide_on_truth(observation.world, observation.routes, observation.row, self.config.rule)

    def act_batch(self, observations: Truths) -> Ints:
        """GO or BRAKE, (n,), in n scenes."""
        chosen = np.empty(len(observations.which), np.int64)
        _decide(observations.batch_state.records, observations.which, self.config.rule, chosen)
        return chosen


@compiled
def _decide(records: Any, which: Ints, rule: Rule, chosen: Ints) -> None:
    for k in range(which.shape[0]):
        scene = scene_at(records, which[k])
        chosen[k] = decide_on_truth(scene.world, scene.routes, scene.fleet.rows[0], rule)


def expert_of(scenario: str | Scenario) -> Policy:
    """Whom the networks imitate in a scenario: its own expert if it brings one, else `Expert`.

    ValueError, one line, for one that is not privileged: labels follow from the truth.
    """
    made = scenario_named(scenario)
    expert: Policy = Expert() if made.expert is None else made.expert()
    if not expert.privileged:
        raise ValueError(f"the expert of {made.name!r} must be privileged, got {expert!r}")
    return expert


def decisions(expert: Any, truths: Truths) -> Ints:
    """GO or BRAKE, (n,), of an expert in n scenes; at once where it has `act_batch`. It must have no memory."""
    if hasattr(expert, "act_batch"):
        chosen: Ints = np.asarray(expert.act_batch(truths))
        return chosen
    return np.array([expert.act(truth) for truth in truths.each()], np.int64)
