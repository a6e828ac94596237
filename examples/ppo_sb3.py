"""Stable-Baselines3's own PPO learns to drive the ego, with a graph network that reads the scene.

python examples/ppo_sb3.py --steps 200000

It prints how the network did before and after, on seeds that it did not learn from. Decisions hold for half a second
while it learns, and at first lean towards going: without these two the ego stands still, and meets nothing to learn of.
docs/reinforcement-learning.md says what this reaches.
"""

import torch
import tyro
from stable_baselines3 import PPO

import cad_env
from policies.stgraph.config import StGraphConfig
from policies.training.sb3_env import CADVecEnv
from policies.training.sb3_policy import GraphFeatures, SB3Policy, lean_towards_go


def main(
    scenario: str = "left_turn", steps: int = 200_000, episodes: int = 200, scenes: int = 32, seed: int = 0
) -> str:
    """Score, learn, score again; the table, printed."""
    torch.set_num_threads(1)  # the network is small: threads would wait for each other
    network = StGraphConfig(velocity=True, ego_way=True, frame_stride=3)
    envs = CADVecEnv(scenes, network.reads, scenario=scenario, radio="dsrc", hold=5, reward="time-and-safety")
    graph = {"features_extractor_class": GraphFeatures, "features_extractor_kwargs": {"config": network}}
    model = PPO("MultiInputPolicy", envs, 1e-3, 64, 128, 3, ent_coef=0.02, policy_kwargs=graph, seed=seed, device="cpu")
    lean_towards_go(model, 1.5)
    test = cad_env.CADVectorEnv(scenes, scenario=scenario, radio="dsrc")
    seeds = range(1_000_000, 1_000_000 + episodes)
    found = list(cad_env.rollouts(test, SB3Policy(model), seeds, "before"))
    model.learn(steps)
    table = cad_env.table(cad_env.scorecards([*found, *cad_env.rollouts(test, SB3Policy(model), seeds, "after")]))
    print(table)
    return table


if __name__ == "__main__":
    tyro.cli(main)
