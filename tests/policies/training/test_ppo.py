"""PPO: the scenes as Stable-Baselines3 wants them, and training that can be stopped."""

from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.evaluation.settings import Settings
from baselines.paper.open_loop import FIRST_SEED
from baselines.paper.presets import PRESETS
from cad_env.envs.vector import CADVectorEnv
from cad_env.scoring.rollout import rollouts
from cad_env.types import BRAKE, GO, MAX_STEPS
from policies.model_folder import load_model
from policies.stgraph.network import StGraphConfig
from policies.stgraph.policy import StGraphPolicy
from policies.training import ppo
from policies.training.config import DAGGER_SEEDS, EXPERT_SEEDS, FINAL_SEEDS, VALIDATION_SEEDS, TrainingConfig
from policies.training.ppo import PpoConfig, actor_of, train_ppo
from policies.training.sb3_env import SEEDS, Scenes

SCENES = ("left_turn", "overtaking")


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of a few decisions."""
    for name, value in (("SCENES_AT_ONCE", 4), ("ROLLOUT", 8), ("PART", 32)):
        monkeypatch.setattr(ppo, name, value)


def test_an_episode_ends_with_its_last_sight_and_the_next_begins_in_the_same_step():
    scenes = Scenes(2, SCENES, "none", StGraphConfig())
    scenes.seed(3)
    first = scenes.reset()
    assert scenes.observation_space.contains({name: part[0] for name, part in first.items()})
    for _ in range(MAX_STEPS):
        seen, _, over, infos = scenes.step(np.full(2, BRAKE))
    assert over.all()  # who brakes always runs out of time
    for place, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert info["episode"]["l"] == MAX_STEPS
        assert not np.array_equal(info["terminal_observation"]["tracks"], seen["tracks"][place])
    assert scenes.scenes.batch.infos(np.ones(2, np.bool_))["seed"].max() < SEEDS


def test_who_arrives_or_collides_in_the_last_decision_was_not_cut_short(monkeypatch: pytest.MonkeyPatch):
    scenes = Scenes(2, SCENES, "none", StGraphConfig())
    scenes.seed(3)
    scenes.reset()
    step = scenes.scenes.step

    def late(actions: np.ndarray) -> tuple:
        seen, rewards, ended, cut, told = step(actions)
        return seen, rewards, ended, cut | ended, told

    monkeypatch.setattr(scenes.scenes, "step", late)
    over = np.zeros(2, bool)
    while not over.any():
        _, _, over, infos = scenes.step(np.full(2, GO))
    assert not any(info.get("TimeLimit.truncated") for info in infos)


def test_seeds_that_judge_are_not_learned_from():
    assert SEEDS <= VALIDATION_SEEDS
    for preset in PRESETS.values():
        config = TrainingConfig(**preset.training)
        corrected = [DAGGER_SEEDS + turn * 10_000 for turn in range(1, config.dagger_rounds + 1)]
        parts = [
            range(EXPERT_SEEDS, EXPERT_SEEDS + config.episodes),
            *(range(first, first + config.dagger_episodes) for first in corrected),
            range(FIRST_SEED, FIRST_SEED + preset.open_loop),
            range(VALIDATION_SEEDS, VALIDATION_SEEDS + config.validation),
            range(FINAL_SEEDS, FINAL_SEEDS + config.final_validation),
            range(Settings().first_seed, Settings().first_seed + preset.scored),
        ]
        assert len(set().union(*parts)) == sum(map(len, parts))


def test_the_same_seed_draws_the_same_episodes():
    def drawn(seed: int) -> list[int]:
        scenes = Scenes(2, SCENES, "none", StGraphConfig())
        scenes.seed(seed)
        scenes.reset()
        return scenes.scenes.batch.infos(np.ones(2, np.bool_))["seed"].tolist()

    assert drawn(1) == drawn(1) != drawn(2)


@pytest.mark.usefixtures("short")
def test_what_is_saved_decides_as_the_learner_does():
    config = PpoConfig(batch=16)
    scenes = Scenes(4, SCENES, "dsrc", config.network)
    model = ppo._learner(scenes, config, seed=1)
    ppo._learn(model, 1, 0)
    seen = scenes.reset()
    with torch.no_grad():
        tensors, _ = model.policy.obs_to_tensor(seen)
        wanted = model.policy.get_distribution(tensors).distribution.probs[:, 1].numpy()
    found = StGraphPolicy(actor_of(model, config.network)).brake_probability(seen)
    np.testing.assert_allclose(found, wanted, atol=1e-5)


@pytest.mark.usefixtures("short")
def test_a_run_that_is_stopped_goes_on_as_if_it_had_not(tmp_path: Path):
    config, models = PpoConfig(batch=16), []
    for name, stops in (("whole", [96]), ("stopped", [32, 96])):
        for steps in stops:
            (tmp_path / name / "ppo" / "config.json").unlink(missing_ok=True)
            train_ppo(tmp_path / name / "ppo", steps, 5, SCENES, config=config)
        models.append((tmp_path / name / "ppo" / "model.safetensors").read_bytes())
    assert models[0] == models[1]
    policy = load_model(tmp_path / "whole" / "ppo").policy()
    episodes = list(rollouts(CADVectorEnv(2, scenario="left_turn"), policy, range(2)))
    assert len(episodes) == 2


def test_nonsense_is_refused_in_one_line(tmp_path: Path):
    with pytest.raises(ValueError, match="discount must be a number from 0 to 1, got 2"):
        PpoConfig(discount=2)
    with pytest.raises(ValueError, match="steps must be a whole number"):
        train_ppo(tmp_path, 0)
    with pytest.raises(ValueError, match="left_trun"):
        train_ppo(tmp_path, 100, scenarios=("left_trun",))
