"""Reinforcement learning: PPO of Stable-Baselines3 on the observations of the others, from scratch or from a clone.

Schulman, Wolski, Dhariwal, Radford and Klimov, "Proximal policy optimization algorithms", 2017. The actor is a graph
network of `policies.stgraph`, so what is saved is a model as any other; the critic, a small network on the same
embedding, is forgotten. A decision holds for half a second and at first leans towards going: by chance alone the ego
would stand still, as a brake takes three times what going adds, and never meet what it must learn of. Training goes in
parts of `PART` decisions: a killed run resumes after the last one it finished. Each part draws its random numbers from
(seed, part), so stopping changes nothing. After each part the network drives validation episodes, ten decisions a
second as it will be scored, and the part that is worth most is kept.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

from cad_env.checks import check_path, check_seed, check_several, check_whole
from cad_env.envs.vector import CADVectorEnv
from cad_env.scenarios import SHIPPED, scenario_named
from policies.model_folder import SavedModel, load_model, save_model
from policies.spec import fitting
from policies.stgraph.policy import StGraphPolicy
from policies.training.cloning import drive_episodes, load_state, save_state
from policies.training.config import NOMINAL, VALIDATION_SEEDS, small_seed
from policies.training.ppo_config import ROLLOUT, SCENES_AT_ONCE, PpoConfig
from policies.training.sb3_env import CADVecEnv
from policies.training.sb3_policy import (
    Kept,
    actor_of,
    begin_with,
    freeze_actor,
    graph_model,
    lean_towards_go,
    policy_settings,
)
from policies.training.validation_log import Log, summary

PART = 4 * SCENES_AT_ONCE * ROLLOUT  # decisions between two checkpoints
THRESHOLD = 0.5  # brake where that is the likelier decision
PARTS_LOG = "metrics.csv"  # what the network was worth after each part


@dataclass(frozen=True)
class _Run:
    """What the parts of a training run work with."""

    folder: Path
    config: PpoConfig
    scenarios: tuple[str, ...]
    seed: int
    parts: int  # in all
    model: PPO
    log: Log  # of every part

    def checkpoint(self, part: int) -> Path:
        """Where the learner is kept as it was after a part."""
        return self.folder / "checkpoints" / f"part_{part}.safetensors"

    def keep(self, part: int) -> None:
        """Write the learner as it is now."""
        save_state(self.checkpoint(part), Kept(self.model.policy), self.model.policy.optimizer)  # type: ignore[arg-type]

    def load(self, part: int) -> None:
        """Go back to the learner as it was after a part."""
        load_state(self.checkpoint(part), Kept(self.model.policy), self.model.policy.optimizer)  # type: ignore[arg-type]


def train_ppo(
    folder: str | Path,
    steps: int,
    seed: int = 0,
    scenarios: Sequence[str] = SHIPPED,
    advance: Callable[[float], object] = lambda done: None,
    config: PpoConfig | None = None,
) -> None:
    """Learn from `steps` decisions, rounded up to whole parts, of scenes of all scenarios; save a model in `folder`.

    Resumes where it stopped; `advance` is told of decisions as they are done.
    """
    config = config or PpoConfig()
    folder, steps, seed = check_path("folder", folder), check_whole("steps", steps, 1, 10**9), check_seed("seed", seed)
    scenarios = check_several("scenarios", scenarios, lambda _, name: scenario_named(name).name)
    clone = None if config.clone is None else graph_model(config.clone)
    config = replace(config, network=fitting(config.network if clone is None else clone.network.config, scenarios))
    parts = -(-steps // PART)
    if (folder / "config.json").exists():
        load_model(folder)
        advance(parts * PART)
        return
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    model = _learner(_scenes(config, scenarios), config, seed, clone)
    run = _Run(folder, config, tuple(scenarios), seed, parts, model, Log(folder / PARTS_LOG))
    for part in range(parts):
        _do_part(run, part)
        advance(PART)
    _keep_best(run)


def _scenes(config: PpoConfig, scenarios: Sequence[str]) -> CADVecEnv:
    """The scenes to learn in."""
    return CADVecEnv(
        SCENES_AT_ONCE, config.network.reads, scenario=scenarios, radio=config.radio, hold=config.hold,
        reward=config.reward, coverage=config.network.coverage,
    )  # fmt: skip


def _learner(scenes: CADVecEnv, config: PpoConfig, seed: int, clone: SavedModel | None = None) -> PPO:
    """The algorithm around a network: a new one, of which `seed` draws the first weights, or that of a clone."""
    set_random_seed(small_seed(seed))
    model = PPO(
        "MultiInputPolicy", scenes, learning_rate=config.learning_rate, n_steps=ROLLOUT, batch_size=config.batch,
        n_epochs=config.epochs, gamma=config.discount, gae_lambda=config.advantage, clip_range=config.clip,
        ent_coef=config.entropy, device="cpu", policy_kwargs=policy_settings(config.network, small_seed(seed)),
    )  # fmt: skip
    if clone is not None:
        begin_with(model, clone)
    else:
        lean_towards_go(model, config.go_bias)
    return model


def _do_part(run: _Run, part: int) -> None:
    """Learn one part and find what it is worth, or what of that is not done yet."""
    if not run.checkpoint(part).exists():
        _learn(run.model, run.config, run.seed, part, run.parts)
        run.keep(part)
    elif not run.checkpoint(part + 1).exists() or not run.log.of(part, 0, THRESHOLD):
        run.load(part)
    _validate(run, part)


def _learn(model: PPO, config: PpoConfig, seed: int, part: int, parts: int) -> None:
    """One part, on episodes of its own."""
    set_random_seed(small_seed(seed + 1_000_003 * part))  # the library draws from global chance
    scenes = model.get_env()
    assert scenes is not None
    scenes.seed(seed + 1_000_003 * part)
    model.set_env(scenes, force_reset=True)
    fallen = (1.0 - config.final_rate) * part / max(parts - 1, 1)
    model.lr_schedule = lambda _: config.learning_rate * (1.0 - fallen)
    freeze_actor(model, part < config.critic_parts, embedding=config.clone is not None)
    model.learn(PART, reset_num_timesteps=False)


def _validate(run: _Run, part: int) -> None:
    """Note what the network is worth in closed loop, in every scenario of which that is not yet known."""
    config, known = run.config, {row["scenario"] for row in run.log.of(part, 0, THRESHOLD)}
    policy = StGraphPolicy(actor_of(run.model, config.network), THRESHOLD)
    seeds = range(VALIDATION_SEEDS, VALIDATION_SEEDS + config.validation)
    for scenario in (name for name in run.scenarios if config.validation and name not in known):
        envs = CADVectorEnv(32, scenario=scenario, radio=config.radio, coverage=config.network.coverage)
        found = summary(drive_episodes(policy, envs, seeds, lambda done: None))
        which = {"round": part, "segment": 0, "loss": 0.0, "threshold": THRESHOLD}
        run.log.add({**which, "scenario": scenario, "condition": NOMINAL, **found})


def _keep_best(run: _Run) -> None:
    """Save the part that was worth most as the model, or the last one where none was validated."""
    config, ranked = run.config, run.log.ranked()
    clone = None if config.clone is None else Path(config.clone).name  # not where it was on this machine
    best = ranked[0][0] if ranked else run.parts - 1
    run.load(best)
    notes = {
        "ppo": {**asdict(config), "clone": clone}, "decisions": run.parts * PART, "seed": run.seed,
        "scenarios": list(run.scenarios),
        "chosen": run.log.note(*ranked[0]) if ranked else {"round": best},
    }  # fmt: skip
    save_model(run.folder, SavedModel(actor_of(run.model, config.network), THRESHOLD, notes))
