"""A model folder gives back what was put in, and says in one line what is wrong with it otherwise."""

import hashlib
import json
import os
import pickle
from pathlib import Path

import pytest
import safetensors.torch
import torch

from baselines.evaluation.job import job_of
from baselines.evaluation.settings import Settings
from cad_env.files import FileError
from policies.model_folder import CONFIG, WEIGHTS, SavedModel, load_model, save_model
from policies.stgraph.network import StGraphConfig, StGraphNet

torch.set_num_threads(1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    network = StGraphNet(StGraphConfig(velocity=True), seed=3)
    save_model(tmp_path / "stgraph", SavedModel(network, 0.3, {"scene": "left_turn", "epochs": 4}))
    return tmp_path / "stgraph"


def change(folder: Path, **keys: object) -> None:
    config = json.loads((folder / CONFIG).read_text())
    (folder / CONFIG).write_text(json.dumps(config | keys))


def change_weights(folder: Path, name: str, value: torch.Tensor | None) -> None:
    """Replace or drop a tensor and make the hash fit, as an honest but mistaken tool would."""
    weights = safetensors.torch.load_file(folder / WEIGHTS)
    weights.pop(name, None)
    if value is not None:
        weights[name] = value
    data = safetensors.torch.save(weights)
    (folder / WEIGHTS).write_bytes(data)
    change(folder, sha256=hashlib.sha256(data).hexdigest())


def assert_refused(folder: Path, file: str, reason: str) -> None:
    with pytest.raises(FileError) as caught:
        load_model(folder)
    message = str(caught.value)
    assert file in message
    assert reason in message
    assert "\n" not in message


def test_a_model_comes_back_as_it_was(folder: Path) -> None:
    model = load_model(folder)
    assert model.network.config == StGraphConfig(velocity=True)
    assert model.threshold == 0.3
    assert model.training == {"scene": "left_turn", "epochs": 4}
    before = StGraphNet(StGraphConfig(velocity=True), seed=3).state_dict()
    assert all(torch.equal(before[name], value) for name, value in model.network.state_dict().items())
    assert model.policy().threshold == 0.3


def test_a_model_of_before_further_commands_has_the_six(folder: Path) -> None:
    knobs = json.loads((folder / CONFIG).read_text())["network"]
    assert knobs.pop("commands") == 6
    change(folder, network=knobs)
    assert load_model(folder).network.config == StGraphConfig(velocity=True)


def test_saving_again_replaces_the_model_and_leaves_nothing_else(folder: Path) -> None:
    save_model(folder, SavedModel(StGraphNet(), 0.5))
    assert load_model(folder).network.config == StGraphConfig()
    assert sorted(path.name for path in folder.iterdir()) == [CONFIG, WEIGHTS]


def test_the_same_model_saves_to_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    save_model(tmp_path / "again", load_model(folder))
    for name in (CONFIG, WEIGHTS):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


@pytest.mark.parametrize("file", [CONFIG, WEIGHTS])
def test_a_missing_file_is_refused(folder: Path, file: str) -> None:
    (folder / file).unlink()
    assert_refused(folder, file, "No such file")


@pytest.mark.parametrize("keep", [0, 7, 100, -1])
def test_truncated_weights_are_refused(folder: Path, keep: int) -> None:
    (folder / WEIGHTS).write_bytes((folder / WEIGHTS).read_bytes()[:keep])
    assert_refused(folder, WEIGHTS, "truncated or altered")


def test_one_altered_bit_is_refused(folder: Path) -> None:
    data = bytearray((folder / WEIGHTS).read_bytes())
    data[-3] ^= 1
    (folder / WEIGHTS).write_bytes(data)
    assert_refused(folder, WEIGHTS, "truncated or altered")


@pytest.mark.parametrize("text", ["", "{", '{"format": 1,', "[" * 100_000])
def test_a_config_that_is_not_json_is_refused(folder: Path, text: str) -> None:
    (folder / CONFIG).write_text(text)
    assert_refused(folder, CONFIG, "not JSON")


def test_a_key_that_comes_twice_is_refused(folder: Path) -> None:
    (folder / CONFIG).write_text((folder / CONFIG).read_text().replace('"format": 1', '"format": 1, "format": 1'))
    assert_refused(folder, CONFIG, "'format' comes twice")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are of POSIX")
@pytest.mark.parametrize("file", [CONFIG, WEIGHTS])
def test_a_pipe_is_refused_and_not_waited_for(folder: Path, file: str) -> None:
    (folder / file).unlink()
    os.mkfifo(folder / file)
    assert_refused(folder, file, "must be a regular file, is a named pipe")
    with pytest.raises(FileError, match="is a named pipe"):
        job_of(Settings(models=(folder.parent,)), "left_turn", "stgraph")


def test_a_huge_config_is_refused(folder: Path) -> None:
    with (folder / CONFIG).open("r+b") as file:
        file.truncate(2**40)  # it takes no room on the disk
    assert_refused(folder, CONFIG, "must have at most 67108864 bytes, has 1099511627776")


def test_a_config_that_is_not_text_is_refused(folder: Path) -> None:
    (folder / CONFIG).write_bytes(b"\xff\xfe\x00")
    assert_refused(folder, CONFIG, "not JSON")


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"format": 2}, "format must be 1, got 2"),
        ({"format": True}, "format must be 1"),
        ({"spec": "treegraph"}, "unknown spec 'treegraph'"),
        ({"spec": 3}, "spec must be a str"),
        ({"colour": "red"}, "unknown key 'colour'"),
        ({"fromat": 1}, "; did you mean format?"),
        ({"threshold": 10**400}, "threshold must be"),
        ({"format": 10**400}, "format must be 1"),
        ({"spec": "s" * 10**6}, "unknown spec 'sss"),
        ({"threshold": 1.5}, "threshold must be"),
        ({"threshold": None}, "threshold must be"),
        ({"threshold": float("nan")}, "threshold must be"),
        ({"network": []}, "network must be a dict"),
        ({"network": {}}, "missing network key"),
        ({"training": 3}, "training must be a dict"),
        ({"sha256": 3}, "sha256 must be a str"),
        ({"sha256": "0" * 64}, "truncated or altered"),
    ],
)
def test_a_config_that_says_something_else_is_refused(folder: Path, keys: dict[str, object], reason: str) -> None:
    change(folder, **keys)
    assert_refused(folder, WEIGHTS if "altered" in reason else CONFIG, reason)


@pytest.mark.parametrize(
    ("knobs", "reason"),
    [
        ({"wings": 2}, "unknown network key 'wings'"),
        ({"heads": 0}, "network heads must be"),
        ({"commands": 5}, "network commands must be a whole number from 6 to 127, got 5"),
        ({"fusion": ["last"]}, "network fusion must be"),
        ({"hidden": None}, "network hidden must be"),
        ({"hidden": 10**400}, "network hidden must be"),
        ({"position_scale": 10**400}, "position_scale"),
        ({"layers": [[]]}, "network layers must be"),
    ],
)
def test_a_network_that_cannot_be_is_refused(folder: Path, knobs: dict[str, object], reason: str) -> None:
    network = json.loads((folder / CONFIG).read_text())["network"]
    change(folder, network=network | knobs)
    assert_refused(folder, CONFIG, reason)


def test_a_config_that_is_a_list_is_refused(folder: Path) -> None:
    (folder / CONFIG).write_text("[1]")
    assert_refused(folder, CONFIG, "must hold a JSON object, got list")


def test_weights_of_another_network_are_refused(folder: Path) -> None:
    network = json.loads((folder / CONFIG).read_text())["network"]
    change(folder, network=network | {"hidden": 13})
    assert_refused(folder, WEIGHTS, "must have shape")


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (None, "missing tensor 'project.bias'"),
        (torch.zeros(11), "project.bias must have shape (12,), got (11,)"),
        (torch.zeros(12, dtype=torch.float64), "project.bias must be torch.float32"),
        (torch.full((12,), torch.nan), "project.bias holds numbers that are not finite"),
    ],
)
def test_a_tensor_that_does_not_fit_is_refused(folder: Path, value: torch.Tensor | None, reason: str) -> None:
    change_weights(folder, "project.bias", value)
    assert_refused(folder, WEIGHTS, reason)


def test_a_tensor_too_many_is_refused(folder: Path) -> None:
    change_weights(folder, "project.extra", torch.zeros(2))
    assert_refused(folder, WEIGHTS, "unknown tensor 'project.extra'")


def test_bytes_that_are_not_safetensors_are_refused(folder: Path) -> None:
    (folder / WEIGHTS).write_bytes(b"hello")
    change(folder, sha256=hashlib.sha256(b"hello").hexdigest())
    assert_refused(folder, WEIGHTS, "not safetensors")


@pytest.mark.parametrize(
    ("threshold", "training"), [(2.0, {}), (0.5, {"loss": float("nan")}), (0.5, {"rng": object()})]
)
def test_what_cannot_be_saved_leaves_the_old_model(folder: Path, threshold: float, training: dict[str, object]) -> None:
    with pytest.raises(FileError):
        save_model(folder, SavedModel(StGraphNet(), threshold, training))
    assert load_model(folder).threshold == 0.3


def test_weights_that_are_not_finite_are_not_saved(tmp_path: Path) -> None:
    network = StGraphNet()
    network.project.bias.data[0] = torch.inf
    with pytest.raises(FileError, match="not finite"):
        save_model(tmp_path, SavedModel(network, 0.5))
    assert not list(tmp_path.iterdir())


def test_an_error_comes_whole_out_of_another_process():
    error = pickle.loads(pickle.dumps(FileError(Path("run") / "config.json", "not JSON:\n line 1")))
    assert str(error) == str(FileError(Path("run") / "config.json", "not JSON:\n line 1"))
    assert str(error) == f"{Path('run') / 'config.json'}: not JSON: line 1"
