"""Every learned row of the tables can do what the others can: learn, be kept, and drive."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn.functional import cross_entropy

from baselines.evaluation.job import job_of
from baselines.evaluation.settings import Settings
from baselines.methods import LEARNED, SHARED, learned_named, method_named
from baselines.training.config import TrainingTask, claim_folder, training_config
from cad_env.envs.vector import CADVectorEnv
from cad_env.scoring.rollout import rollouts
from policies.model_folder import SavedModel, save_model
from policies.registry import SPECS, spec_named
from policies.spec import Frames, NetworkSpec
from policies.training.cloning import load_state, save_state
from policies.training.config import TrainingConfig
from policies.training.demonstrations import Demonstrations, joined, record, replay

torch.set_num_threads(1)

RUN = {
    "scenarios": ("left_turn",),
    "episodes": 6,
    "dagger_rounds": 1,
    "steps": 4,
    "validation": 5,
    "dagger_episodes": 5,
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Demonstrations:
    return joined(record(tmp_path_factory.mktemp("two"), CADVectorEnv(2, radio="none"), None, (3, 4), lambda n: None))


def config_and_spec(name: str) -> tuple[TrainingConfig, NetworkSpec]:
    made = training_config(learned_named(name), {**RUN, "seed": 1})
    return made, spec_named(made.spec)


def some_frames(name: str, recorded: Demonstrations) -> Frames:
    made, spec = config_and_spec(name)
    network = spec.build(made.network, seed=1)
    envs = CADVectorEnv(2, radio=made.radio, depth=made.depth, **spec.environment(network))
    return spec.frames(*replay(recorded, envs, spec.look))


@pytest.mark.parametrize("name", LEARNED)
def test_a_row_learns_is_kept_and_drives(name: str, recorded: Demonstrations, tmp_path: Path) -> None:
    made, spec = config_and_spec(name)
    network, frames = spec.build(made.network, seed=1), some_frames(name, recorded)
    assert len(frames) == len(recorded.label)
    batch = {key: torch.from_numpy(part) for key, part in frames.batch(np.arange(0, len(frames), 9)).items()}
    logits = spec.logits(network, batch)
    assert logits.shape == (len(batch["command"]), 2)
    cross_entropy(logits, torch.arange(len(logits)) % 2).backward()
    for part, weights in network.named_parameters():
        assert weights.grad is not None, part
        assert bool(weights.grad.isfinite().all()), part
        assert bool(weights.grad.any()), part
    folder = tmp_path / learned_named(name).model
    save_model(folder, SavedModel(network, 1.0, {}, spec))  # it goes, so that the episode is short
    settings = Settings(scenario=("left_turn",), method=(name,), models=(tmp_path,), radio=made.radio)
    policy, job = spec.policy(network, 1.0), job_of(settings, "left_turn", name)
    again, envs = job.policy, CADVectorEnv(2, **job.options)
    seen, _ = envs.reset(seed=3)
    np.testing.assert_array_equal(policy.brake_probability(seen), again.brake_probability(seen))
    first = next(rollouts(envs, again, [3]))
    assert first.outcome in ("success", "collision")
    assert (first.messages_sent.sum() > 0) == method_named(name).shares


@pytest.mark.parametrize("name", LEARNED)
def test_the_same_seed_gives_the_same_first_weights_and_another_does_not(name: str) -> None:
    made, spec = config_and_spec(name)
    one, same, other = (spec.build(made.network, seed).state_dict() for seed in (1, 1, 2))
    assert all(torch.equal(one[part], same[part]) for part in one)
    assert any(not torch.equal(one[part], other[part]) for part in one)


def test_rows_say_what_they_share_and_own_views_share_nothing() -> None:
    assert {row.shares for row in LEARNED.values()} <= set(SHARED)
    assert {row.spec for row in LEARNED.values()} <= set(SPECS)
    assert config_and_spec("gat")[0].radio == "none"
    assert config_and_spec("collab-gat")[0].depth == 1


def test_rows_of_points_are_validated_on_few_episodes_and_a_clone_takes_all_its_steps_at_once() -> None:
    run = {"scenarios": ("left_turn",), "episodes": 6, "dagger_rounds": 2, "steps": 10, "validation": 60}
    graph, points, clone = (
        training_config(learned_named(name), run) for name in ("stgraph", "raw-points", "stgraph-bc")
    )
    assert (graph.validation, points.validation, points.final_validation) == (60, 24, 40)
    assert (clone.dagger_rounds, clone.steps) == (0, 20)


def test_an_unknown_row_or_family_is_refused_with_the_choices() -> None:
    with pytest.raises(ValueError, match=r"unknown method 'gta': choose among stgraph, .*; did you mean gat\?"):
        learned_named("gta")
    with pytest.raises(ValueError, match=r"unknown spec 'gta': choose among stgraph, "):
        spec_named("gta")


def test_whoever_sees_only_the_command_learns_which_one_is_dangerous() -> None:
    spec = spec_named("command")
    network = spec.build(spec.config_type(), seed=0)
    optimiser = torch.optim.Adam(network.parameters(), lr=0.1)
    command = torch.eye(6)
    for _ in range(50):
        optimiser.zero_grad()
        cross_entropy(spec.logits(network, {"command": command}), (torch.arange(6) == 1).long()).backward()
        optimiser.step()
    seen = {"command": np.eye(6, dtype=np.int8)}
    assert spec.policy(network, 0.5).act_batch(seen).tolist() == [0, 1, 0, 0, 0, 0]


def test_a_checkpoint_of_another_row_is_refused(tmp_path: Path) -> None:
    networks = [config_and_spec(name)[1].build(config_and_spec(name)[0].network, 0) for name in ("stgraph", "gat")]
    save_state(tmp_path / "state", networks[0], torch.optim.Adam(networks[0].parameters()), 0.25)
    with pytest.raises(ValueError, match="not a checkpoint of this network"):
        load_state(tmp_path / "state", networks[1], torch.optim.Adam(networks[1].parameters()))


def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, arguments: str) -> str:
    """The name of a network spec in a new module of the current folder."""
    (tmp_path / f"{module}.py").write_text(
        "from policies.command import CommandConfig, CommandNet\n"
        "from policies.observation_spec import ObservationSpec\n"
        f"SPEC = ObservationSpec({module!r}, CommandConfig, lambda config: CommandNet(config, 0), {arguments})\n"
    )
    monkeypatch.chdir(tmp_path)
    return f"{module}:SPEC"


def test_a_network_from_outside_says_how_it_is_trained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    training = "training={'batch': 48, 'depth': 2}, shares='nothing'"
    name = outside(tmp_path, monkeypatch, "own_network_alone", training)
    made = training_config(learned_named(name), RUN)
    assert (made.batch, made.depth, made.radio, made.steps, made.spec) == (48, 2, "none", RUN["steps"], name)
    assert not method_named(name).shares
    assert method_named(name).depth == 2


def test_a_network_from_outside_that_asks_for_what_there_is_not_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValueError, match=r"must share one of nothing, graph, .*, got 'grahp'"):
        learned_named(outside(tmp_path, monkeypatch, "own_network_grahp", "shares='grahp'"))
    name = outside(tmp_path, monkeypatch, "own_network_bacth", "training={'bacth': 48}")
    with pytest.raises(ValueError, match=r"unknown training setting 'bacth' of own_network_bacth:SPEC: choose among"):
        training_config(learned_named(name), RUN)


def test_a_folder_of_a_network_from_outside_is_of_its_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = outside(tmp_path, monkeypatch, "own_network_edited", "keys=('command',)")
    task = TrainingTask(name, training_config(learned_named(name), RUN), tmp_path / "model", tmp_path)
    claim_folder(task)
    claim_folder(task)
    outside(tmp_path, monkeypatch, "own_network_edited", "keys=('command', 'ego')")
    with pytest.raises(ValueError, match="another source of own_network_edited:SPEC"):
        claim_folder(task)
