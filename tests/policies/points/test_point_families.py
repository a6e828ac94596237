"""The specs of points in real scenes: training sees what driving sees, and a model comes back as it was."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from cad_env.config import RadioConfig
from cad_env.envs.vector import CADVectorEnv
from cad_env.lidar.points import thinned
from policies.model_folder import SavedModel, load_model, save_model
from policies.points.compressed import CompressedConfig, CompressedNet, LearnedFeatures, SizedOnly
from policies.registry import SPECS, spec_named
from policies.spec import NetworkSpec

torch.set_num_threads(1)


def after_some_steps(spec: NetworkSpec, network: torch.nn.Module, radio: str) -> tuple[CADVectorEnv, dict[str, Any]]:
    """Two scenes under way, and what is observed in them."""
    envs = CADVectorEnv(2, scenario="left_turn", radio=radio, **spec.environment(network))
    envs.reset(seed=3)
    for _ in range(4):
        observed = envs.step(np.zeros(2, np.int64))[0]
    return envs, observed


def looked_at(spec: NetworkSpec, envs: CADVectorEnv) -> dict[str, Any]:
    """The batch of training for the same frames."""
    scenes = enumerate(envs.batch.simulations)
    looks = [spec.look(simulation, envs.batch.observation(place)) for place, simulation in scenes]
    return spec.frames(looks, [0, 1]).batch(np.arange(2))


@pytest.mark.parametrize("radio", ["ideal", "none"])
def test_a_merged_cloud_is_trained_on_as_it_is_driven_on(radio: str) -> None:
    spec = spec_named("point_transformer")
    envs, observed = after_some_steps(spec, spec.build(spec.config_type(), seed=0), radio)
    batch = looked_at(spec, envs)
    assert np.array_equal(batch["cloud_mask"], observed["cloud_mask"])
    assert observed["cloud_mask"].any(1).all()
    np.testing.assert_allclose(batch["cloud"], observed["cloud"], rtol=0, atol=0.0051)
    assert np.array_equal(batch["command"], observed["command"])


@pytest.mark.parametrize("radio", ["ideal", "dsrc", "none"])
def test_what_the_clouds_of_all_vehicles_give_is_what_their_messages_give(radio: str) -> None:
    spec = spec_named("compressed")
    network = spec.build(spec.config_type(), seed=0)
    envs, observed = after_some_steps(spec, network, radio)
    batch = looked_at(spec, envs)
    vehicles = batch["clouds_mask"].any(2).sum(1)
    if radio != "dsrc":  # which refuses some messages and carries others
        assert (vehicles >= 3).all() if radio == "ideal" else (vehicles == 1).all()
    assert np.array_equal(batch["clouds_mask"].sum((1, 2)), observed["cloud_mask"].sum(1))
    trained = {name: torch.from_numpy(part) for name, part in batch.items()}
    wanted = torch.softmax(spec.logits(network, trained), 1)[:, 1].detach().numpy()
    np.testing.assert_allclose(spec.policy(network, 0.5).brake_probability(observed), wanted, rtol=0, atol=1e-3)


@pytest.mark.parametrize("radio", ["ideal", "dsrc", "none", RadioConfig(loss=0.5, delay=0.1, range=60.0)])
@pytest.mark.parametrize("name", SPECS)
def test_episodes_are_replayed_in_scenes_where_a_look_sees_the_same(name: str, radio: str | RadioConfig) -> None:
    spec = spec_named(name)
    network = spec.build(spec.config_type(), seed=0)
    options = (spec.environment(network), spec.replayed(network))
    usual, other = (CADVectorEnv(2, scenario="left_turn", radio=radio, **needs) for needs in options)
    for envs in (usual, other):
        envs.reset(seed=3)
    for _ in range(4):
        one, two = looked_at(spec, usual), looked_at(spec, other)
        assert one.keys() == two.keys()
        assert all(one[part].tobytes() == two[part].tobytes() for part in one)
        for envs in (usual, other):
            envs.step(np.zeros(2, np.int64))


@pytest.mark.parametrize("config", [CompressedConfig(), CompressedConfig(points=512, levels=2, width=4)])
def test_what_is_replayed_is_as_large_as_what_is_sent(config: CompressedConfig) -> None:
    rng = np.random.default_rng(1)
    clouds = [rng.uniform(-60, 60, (count, 3)) * [1, 1, 0.05] for count in (0, 1, 5, 17, 400, 3000)]
    sent, replayed = LearnedFeatures(CompressedNet(config)), SizedOnly(config)
    wanted = [len(payload) for payload in sent.encode(clouds)]
    payloads = replayed.encode(clouds)
    assert [len(payload) for payload in payloads] == wanted
    assert sent.reads == replayed.reads
    assert all(replayed.decode(payload).shape == (0, 3) for payload in payloads)
    few = [thinned(cloud, config.points) for cloud in clouds]
    assert sent.encode(few) == sent.encode(clouds)


def test_a_network_of_other_clouds_than_those_kept_is_not_trained() -> None:
    spec = spec_named("compressed")
    with pytest.raises(ValueError, match=r"points must be 128 .*, got 64"):
        spec.replayed(CompressedNet(CompressedConfig(points=64)))


@pytest.mark.parametrize("name", ["point_transformer", "compressed"])
def test_a_saved_model_decides_as_it_did(name: str, tmp_path: Path) -> None:
    spec = spec_named(name)
    network = spec.build(spec.config_type(mlp_width=8), seed=5)
    save_model(tmp_path / "model", SavedModel(network, 0.4, spec=spec))
    model = load_model(tmp_path / "model")
    assert model.network.config == network.config
    rng = np.random.default_rng(0)
    width = model.environment()["cloud"].codec.width
    mask = np.arange(30) < np.array([[30], [4], [0]])
    observed = {
        "cloud": (rng.normal(0, 20, (3, 30, 3 + width)) * mask[..., None]).astype(np.float32),
        "cloud_mask": mask.astype(np.int8),
        "command": np.eye(6, dtype=np.int8)[:3],
    }
    before = spec.policy(network, 0.4).brake_probability(observed)
    assert np.array_equal(model.policy().brake_probability(observed), before)
    assert len(set(before)) == 3
