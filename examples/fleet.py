"""Drive every connected vehicle of a scene at once, and print how the fleets did.

python examples/fleet.py --scenario left_turn --episodes 100

Three fleets on the same seeds: every vehicle drives on as its driver would (`always-go`), every vehicle decides by the
rules on what it sees and is sent (`planner-shared`), and every vehicle is driven by the network that ships with the
package (`stgraph`), which was trained to drive the ego.
"""

from dataclasses import dataclass

import tyro
from tqdm import tqdm

from baselines.evaluation.job import job_of
from baselines.evaluation.settings import Settings as ScoringSettings
from baselines.methods import method_named
from cad_env.envs.parallel import CADParallelEnv
from cad_env.scoring.fleet import FleetEpisode, fleet_scores, fleet_table, rollout_fleet


@dataclass(frozen=True)
class Settings:
    """Score fleets in closed loop."""

    scenario: str = "left_turn"
    method: tuple[str, ...] = ("always-go", "planner-shared", "stgraph")
    """who drives every vehicle, by the names of evaluate.py"""
    episodes: int = 100
    first_seed: int = 1_000_000
    traffic: str = "light"
    """none, light or dense"""
    collaborators: int = 3
    """connected vehicles besides the ego"""


def driven(settings: Settings, name: str) -> list[FleetEpisode]:
    """The episodes of one method."""
    method = method_named(name)
    policy = job_of(ScoringSettings(), settings.scenario, name).policy
    env = CADParallelEnv(
        scenario=settings.scenario, radio="dsrc" if method.shares else "none", traffic=settings.traffic,
        ranges={"collaborators": (settings.collaborators, settings.collaborators)},
    )  # fmt: skip
    seeds = range(settings.first_seed, settings.first_seed + settings.episodes)
    return [rollout_fleet(env, policy, seed, name) for seed in tqdm(seeds, desc=name, disable=None)]


def main(settings: Settings) -> str:
    """The table, printed."""
    episodes = [episode for name in settings.method for episode in driven(settings, name)]
    table = fleet_table(fleet_scores(episodes))
    print(table)
    return table


if __name__ == "__main__":
    main(tyro.cli(Settings))
