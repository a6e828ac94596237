"""The scenes as Stable-Baselines3 wants them."""

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from cad_env.envs.scaling import scaled_observation
from cad_env.envs.vector import CADVectorEnv
from cad_env.scoring.rollout import rollouts
from cad_env.types import BRAKE, GO, MAX_STEPS
from policies.stgraph.config import StGraphConfig
from policies.training.sb3_env import SEEDS, CADVecEnv
from policies.training.sb3_policy import GraphFeatures, SB3Policy

SCENES = ("left_turn", "overtaking")
READS = StGraphConfig().reads


def started(**options: object) -> CADVecEnv:
    """Two scenes, seeded."""
    envs = CADVecEnv(2, READS, scenario=SCENES, radio="none", **options)
    envs.seed(3)
    return envs


def seeds(envs: CADVecEnv) -> list[int]:
    """Of the episodes under way."""
    return envs.scenes.batch.infos(np.ones(2, np.bool_))["seed"].tolist()


@pytest.mark.parametrize("hold", [1, 5])
def test_an_episode_ends_with_its_last_sight_and_the_next_begins_in_the_same_step(hold: int):
    envs = started(hold=hold)
    first = envs.reset()
    assert envs.observation_space.contains({name: part[0] for name, part in first.items()})
    for _ in range(MAX_STEPS // hold):
        seen, _, over, infos = envs.step(np.full(2, BRAKE))
    assert over.all()  # who brakes always runs out of time
    for place, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert not info["is_success"]
        assert info["episode"]["l"] == MAX_STEPS // hold
        assert not np.array_equal(info["terminal_observation"]["tracks"], seen["tracks"][place])
    assert max(seeds(envs)) < SEEDS


def test_it_is_the_vector_environment():
    envs, bare = started(hold=3, reward="time-and-safety"), CADVectorEnv(
        2, "Disabled", scenario=SCENES, radio="none", hold=3, reward="time-and-safety"
    )  # fmt: skip
    seen = envs.reset()
    wanted, _ = bare.reset(seed=seeds(envs))
    earned, total = np.zeros(2), np.zeros(2)
    for k in range(MAX_STEPS):
        for name in READS:
            np.testing.assert_array_equal(seen[name], wanted[name])
        actions = np.array([int(k % 3 == 0), GO])
        seen, rewards, over, infos = envs.step(actions)
        wanted, paid, ended, cut, told = bare.step(actions)
        np.testing.assert_array_equal(rewards, paid.astype(np.float32))
        np.testing.assert_array_equal(over, ended | cut)
        earned, total = earned + paid, total + rewards
        if over.any():
            break
    place = int(np.flatnonzero(over)[0])
    assert infos[place]["episode"]["r"] == earned[place]
    assert infos[place]["is_success"] == told["is_success"][place]


def test_who_arrives_or_collides_in_the_last_decision_was_not_cut_short(monkeypatch: pytest.MonkeyPatch):
    envs = started()
    envs.reset()
    step = envs.scenes.step

    def late(actions: np.ndarray) -> tuple:
        seen, rewards, ended, cut, told = step(actions)
        return seen, rewards, ended, cut | ended, told

    monkeypatch.setattr(envs.scenes, "step", late)
    over = np.zeros(2, bool)
    while not over.any():
        _, _, over, infos = envs.step(np.full(2, GO))
    assert not any(info.get("TimeLimit.truncated") for info in infos)


def test_the_same_seed_draws_the_same_episodes():
    drawn = []
    for seed in (1, 1, 2):
        envs = started()
        envs.seed(seed)
        envs.reset()
        drawn.append(seeds(envs))
    assert drawn[0] == drawn[1] != drawn[2]


def test_scaled_it_shows_what_the_wrapper_shows():
    envs, bare = started(scaled=True), started()
    one, other = envs.reset(), bare.reset()
    for name, part in scaled_observation(other).items():
        np.testing.assert_array_equal(one[name], part)
    assert envs.observation_space.contains({name: part[0] for name, part in one.items()})
    for _ in range(MAX_STEPS):
        _, _, over, infos = envs.step(np.full(2, GO))
        _, _, _, bare_infos = bare.step(np.full(2, GO))
        if over.any():
            break
    place = int(np.flatnonzero(over)[0])
    last = scaled_observation(bare_infos[place]["terminal_observation"])
    np.testing.assert_array_equal(infos[place]["terminal_observation"]["tracks"], last["tracks"])


def test_the_library_learns_in_it_with_the_graph_network_and_without():
    config = {"features_extractor_kwargs": {"config": StGraphConfig()}}
    graph = {"features_extractor_class": GraphFeatures, **config}
    for envs, settings in ((started(hold=5), graph), (VecNormalize(started(scaled=True), norm_obs=False), {})):
        model = PPO("MultiInputPolicy", envs, n_steps=8, batch_size=8, n_epochs=1, device="cpu", policy_kwargs=settings)
        before = [value.clone() for value in model.policy.parameters()]
        model.learn(16)
        assert not all(
            np.array_equal(a.detach(), b.detach()) for a, b in zip(before, model.policy.parameters(), strict=True)
        )


@pytest.mark.parametrize("scaled", [False, True])
def test_what_the_library_learned_drives(scaled: bool):
    envs = CADVecEnv(2, ("ego", "command"), scaled, scenario="left_turn")
    model = PPO("MultiInputPolicy", envs, n_steps=8, batch_size=8, n_epochs=1, device="cpu", seed=1)
    policy, seen = SB3Policy(model, scaled), CADVectorEnv(3, scenario="left_turn").reset(seed=5)[0]
    shown = {name: seen[name] for name in ("ego", "command")}
    wanted, _ = model.predict(scaled_observation(shown) if scaled else shown, deterministic=True)
    np.testing.assert_array_equal(policy.act_batch(seen), wanted)
    assert [policy.act({name: part[k] for name, part in seen.items()}) for k in range(3)] == wanted.tolist()
    assert len(list(rollouts(CADVectorEnv(2, scenario="left_turn"), policy, range(2)))) == 2


def test_parts_that_are_not_there_are_refused_in_one_line():
    with pytest.raises(ValueError, match=r"^unknown part of an observation track="):
        CADVecEnv(2, ("track",))
    with pytest.raises(ValueError, match="hold must be a whole number"):
        CADVecEnv(2, hold=0)
