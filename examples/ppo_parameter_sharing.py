"""Parameter sharing: one PPO network of Stable-Baselines3 learns to drive every vehicle, by way of SuperSuit.

pip install -c constraints.txt -e ".[examples]"
python examples/ppo_parameter_sharing.py --steps 100000

It prints how fleets of the network did before and after, with intervals; docs/reinforcement-learning.md says what it
reaches. Decisions hold for half a second while it learns, and at first lean towards going. `FixedAgents` keeps
everybody in the scene to its end, as SuperSuit wants it. PPO's own log would show no successes: SuperSuit overwrites
the last `info` of an episode with the first one of the next.
"""

from dataclasses import dataclass
from typing import Any

import supersuit
import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from cad_env.envs.fixed_agents import FixedAgents
from cad_env.envs.hold import HoldParallel
from cad_env.envs.parallel import CADParallelEnv
from cad_env.scoring.fleet import FleetEpisode, fleet_scores, fleet_table, rollout_fleet
from policies.training.sb3_policy import SB3Policy, lean_towards_go


@dataclass(frozen=True)
class Settings:
    """Train one network for all vehicles, and score it before and after."""

    scenario: str = "left_turn"
    steps: int = 100_000
    """decisions to learn from, over all agents"""
    scenes: int = 4
    """at once; each has four agents"""
    rollout: int = 128
    """decisions of each agent between two updates"""
    episodes: int = 100
    """to score on, before and after"""
    seed: int = 0


class Bar(BaseCallback):
    """A progress bar over the decisions learnt from."""

    def _on_training_start(self) -> None:
        self.bar = tqdm(total=self.locals["total_timesteps"], desc="learning", disable=None)

    def _on_step(self) -> bool:
        self.bar.update(self.training_env.num_envs)
        return True

    def _on_training_end(self) -> None:
        self.bar.close()


def many_scenes(settings: Settings) -> VecEnv:
    """Every agent of several scenes as an environment of one vector environment."""
    scene = FixedAgents(CADParallelEnv(scenario=settings.scenario, reward="time-and-safety"))
    agents = supersuit.pettingzoo_env_to_vec_env_v1(HoldParallel(scene, 5))
    # One process: a scene costs less than sending it to another.
    scenes: Any = supersuit.concat_vec_envs_v1(agents, settings.scenes, num_cpus=1, base_class="stable_baselines3")
    scenes.venv.reset(seed=settings.seed)  # SuperSuit has no other way to seed, and so PPO must not be given a seed
    return scenes


def scored(settings: Settings, model: PPO, name: str) -> list[FleetEpisode]:
    """The episodes of the network as it is now, on seeds that it does not learn from."""
    env, policy = CADParallelEnv(scenario=settings.scenario), SB3Policy(model)
    seeds = range(1_000_000, 1_000_000 + settings.episodes)
    return [rollout_fleet(env, policy, seed, name) for seed in tqdm(seeds, desc=name, disable=None)]


def main(settings: Settings) -> str:
    """Score, learn, score again; the table, printed."""
    torch.set_num_threads(1)  # the network is small: threads would wait for each other
    set_random_seed(settings.seed)
    env = many_scenes(settings)
    batch = min(256, settings.rollout * env.num_envs)
    model = PPO("MultiInputPolicy", env, n_steps=settings.rollout, batch_size=batch, n_epochs=4, device="cpu")
    lean_towards_go(model, 1.5)
    before = scored(settings, model, "before")
    model.learn(settings.steps, callback=Bar())
    table = fleet_table(fleet_scores([*before, *scored(settings, model, "after")]))
    print(table)
    return table


if __name__ == "__main__":
    main(tyro.cli(Settings))
