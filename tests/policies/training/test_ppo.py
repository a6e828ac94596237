"""PPO: what it begins with, what it keeps, and training that can be stopped."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from baselines.evaluation.settings import Settings
from baselines.paper.open_loop import FIRST_SEED
from baselines.paper.presets import PRESETS
from cad_env.envs.vector import CADVectorEnv
from cad_env.scoring.rollout import rollouts
from cad_env.types import Observation
from policies.model_folder import SavedModel, load_model, save_model
from policies.registry import spec_named
from policies.stgraph.network import StGraphConfig, StGraphNet
from policies.stgraph.policy import StGraphPolicy
from policies.training import ppo
from policies.training.config import DAGGER_SEEDS, EXPERT_SEEDS, FINAL_SEEDS, VALIDATION_SEEDS, TrainingConfig
from policies.training.ppo import PpoConfig, train_ppo
from policies.training.sb3_env import SEEDS
from policies.training.sb3_policy import actor_of

SCENES = ("left_turn", "overtaking")
SMALL = PpoConfig(batch=16, validation=2, critic_parts=1)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of a few decisions."""
    for name, value in (("SCENES_AT_ONCE", 4), ("ROLLOUT", 8), ("PART", 32)):
        monkeypatch.setattr(ppo, name, value)


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


@pytest.mark.usefixtures("short")
def test_what_is_saved_decides_as_the_learner_does():
    scenes = ppo._scenes(SMALL, SCENES)
    model = ppo._learner(scenes, SMALL, seed=1)
    ppo._learn(model, SMALL, 1, 0, 1)
    assert_decides_as(model, scenes.reset())


def assert_decides_as(model: Any, seen: Observation) -> None:
    """What would be saved is as sure as the learner is."""
    with torch.no_grad():
        tensors, _ = model.policy.obs_to_tensor(seen)
        wanted = model.policy.get_distribution(tensors).distribution.probs[:, 1].numpy()
    found = StGraphPolicy(actor_of(model, model.policy.features_extractor.network.config)).brake_probability(seen)
    np.testing.assert_allclose(found, wanted, atol=1e-5)


@pytest.mark.usefixtures("short")
def test_a_new_network_goes_as_often_as_its_bias_says():
    model = ppo._learner(ppo._scenes(SMALL, SCENES), replace(SMALL, go_bias=1.5), seed=1)
    tensors, _ = model.policy.obs_to_tensor(model.get_env().reset())
    with torch.no_grad():
        brakes = model.policy.get_distribution(tensors).distribution.probs[:, 1].numpy()
    np.testing.assert_allclose(brakes, 1 / (1 + np.exp(1.5)), atol=0.02)


class StoppedError(Exception):
    """Somebody pressed Ctrl-C."""


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("where", ["after a part", "while it is validated"])
def test_a_run_that_is_stopped_goes_on_as_if_it_had_not(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def stop(*_: object) -> None:
        raise StoppedError

    train_ppo(tmp_path / "whole", 96, 5, SCENES, config=SMALL)
    with monkeypatch.context() as patch:
        if where == "while it is validated":
            patch.setattr(ppo, "drive_episodes", stop)
        with pytest.raises(StoppedError):
            train_ppo(tmp_path / "stopped", 96, 5, SCENES, stop, SMALL)
    train_ppo(tmp_path / "stopped", 96, 5, SCENES, config=SMALL)
    for name in ("model.safetensors", "metrics.csv", "config.json"):
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "stopped" / name).read_bytes()
    policy = load_model(tmp_path / "whole").policy()
    episodes = list(rollouts(CADVectorEnv(2, scenario="left_turn"), policy, range(2)))
    assert len(episodes) == 2


@pytest.mark.usefixtures("short")
def test_the_part_that_was_worth_most_is_the_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    collisions, calls = [2, 0, 1], []

    def driven(policy: Any, envs: Any, seeds: Any, advance: Any) -> list[Any]:
        calls.append(policy)
        hit = collisions[len(calls) - 1]
        outcomes = ["collision"] * hit + ["success"] * (3 - hit)
        return [SimpleNamespace(outcome=outcome, hazard=True, time=9.0, brakes=1) for outcome in outcomes]

    monkeypatch.setattr(ppo, "drive_episodes", driven)
    train_ppo(tmp_path, 96, 5, SCENES[:1], config=SMALL)
    saved = load_model(tmp_path)
    assert saved.training["chosen"]["round"] == 1
    seen = CADVectorEnv(4, scenario="left_turn").reset(seed=0)[0]
    found = [policy.brake_probability(seen) for policy in (saved.policy(), *calls)]
    np.testing.assert_array_equal(found[0], found[2])
    assert not np.array_equal(found[1], found[2])


@pytest.mark.usefixtures("short")
def test_the_rate_falls_from_part_to_part():
    model = ppo._learner(ppo._scenes(SMALL, SCENES), SMALL, seed=1)
    rates = []
    for part in range(3):
        ppo._learn(model, SMALL, 1, part, 3)
        rates.append(model.policy.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-3, 5.5e-4, 1e-4])


@pytest.mark.usefixtures("short")
def test_what_begins_with_a_clone_decides_as_it_does_until_the_critic_has_learned(tmp_path: Path):
    clone = SavedModel(StGraphNet(StGraphConfig(velocity=True, hidden=8), seed=3), 0.35)
    save_model(tmp_path, clone)
    config = replace(SMALL, clone=str(tmp_path), network=clone.network.config)
    scenes = ppo._scenes(config, SCENES)
    model = ppo._learner(scenes, config, 1, clone)
    seen = scenes.reset()
    sure = clone.policy().brake_probability(seen)

    def decided() -> np.ndarray:
        return StGraphPolicy(actor_of(model, config.network)).brake_probability(seen)

    odds = sure / (1 - sure) * (1 - 0.35) / 0.35  # it brakes from even odds on where the clone does from its threshold
    np.testing.assert_allclose(decided(), odds / (1 + odds), atol=1e-5)
    begun = decided()
    before = [value.clone() for value in model.policy.value_net.parameters()]
    ppo._learn(model, config, 1, 0, 2)
    np.testing.assert_array_equal(decided(), begun)
    assert not all(map(torch.equal, before, model.policy.value_net.parameters()))
    ppo._learn(model, config, 1, 1, 2)
    assert not np.array_equal(decided(), begun)
    assert_decides_as(model, seen)


@pytest.mark.usefixtures("short")
def test_from_scratch_the_critic_learns_first_and_the_embedding_with_it():
    model = ppo._learner(ppo._scenes(SMALL, SCENES), SMALL, seed=1)

    def weights() -> dict[str, torch.Tensor]:
        return {name: value.clone() for name, value in model.policy.state_dict().items()}

    before = weights()
    ppo._learn(model, SMALL, 1, 0, 2)
    moved = {name for name, value in weights().items() if not torch.equal(value, before[name])}
    assert not any("policy_net" in name or "action_net" in name for name in moved)
    assert {"features_extractor.network.project.weight", "value_net.weight"} <= moved
    before = weights()
    ppo._learn(model, SMALL, 1, 1, 2)
    assert not torch.equal(weights()["action_net.bias"], before["action_net.bias"])


def test_a_clone_of_another_kind_is_refused(tmp_path: Path):
    other = spec_named("command")
    save_model(tmp_path, SavedModel(other.build(other.config_type(), 0), 0.5, spec=other))
    with pytest.raises(ValueError, match=r"^a clone to begin with must be a graph network .*, got one of command$"):
        train_ppo(tmp_path / "ppo", 32, scenarios=SCENES, config=PpoConfig(clone=str(tmp_path)))


def test_nonsense_is_refused_in_one_line(tmp_path: Path):
    with pytest.raises(ValueError, match="discount must be a number from 0 to 1, got 2"):
        PpoConfig(discount=2)
    with pytest.raises(ValueError, match="reward must be one of progress, safety-first, time-and-safety, got 'safe'"):
        PpoConfig(reward="safe")
    with pytest.raises(ValueError, match="steps must be a whole number"):
        train_ppo(tmp_path, 0)
    with pytest.raises(ValueError, match="left_trun"):
        train_ppo(tmp_path, 100, scenarios=("left_trun",))
