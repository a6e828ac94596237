"""A model on disk: `model.safetensors` and `config.json` in one folder, no pickle, nothing that can run code.

`config.json` names the format, the spec, the network's every knob, the brake threshold, the SHA-256 of the weights
and whatever the training wants to remember.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from cad_env.checks import check_path, check_range, did_you_mean, plain
from cad_env.files import MOST_DATA_BYTES, FileError, read_file, read_json_object, replace_file, replace_text, shortened
from cad_env.types import COMMANDS
from policies.registry import spec_named
from policies.spec import LearnedPolicy, NetworkSpec

FORMAT = 1
WEIGHTS, CONFIG = "model.safetensors", "config.json"
# Knobs that models of before do not name, and what they were.
_ADDED = {"commands": COMMANDS, "ego_way": False, "frame_stride": 1, "coverage": False}
_KEYS = {"format", "spec", "network", "threshold", "sha256", "training"}


@dataclass(frozen=True)
class SavedModel:
    """What a model folder holds."""

    network: nn.Module
    threshold: float  # brake when P(brake) reaches it
    training: dict[str, Any] = field(default_factory=dict)  # free-form, what JSON can hold
    spec: NetworkSpec = field(default_factory=lambda: spec_named("stgraph"))

    def policy(self) -> LearnedPolicy:
        """The model as a policy."""
        return self.spec.policy(self.network, self.threshold)

    def environment(self) -> dict[str, Any]:
        """The options of the environment that it needs, beside scenario, radio and depth."""
        return self.spec.environment(self.network)


def save_model(folder: str | Path, model: SavedModel) -> None:
    """Write a model folder, each file whole or not at all; weights first, so that a torn pair is found by its hash.

    Raises FileError for weights that are not finite, a threshold outside [0, 1] or training notes that JSON refuses.
    """
    folder = check_path("folder", folder)
    weights = {name: value.detach().float().contiguous() for name, value in model.network.state_dict().items()}
    _check_finite(folder / WEIGHTS, weights)
    data = safetensors.torch.save(weights)
    config = {
        "format": FORMAT,
        "spec": model.spec.name,
        "network": asdict(_config_of(model.network)),
        "threshold": plain(model.threshold),
        "sha256": hashlib.sha256(data).hexdigest(),
        "training": model.training,
    }
    try:
        check_range("threshold", model.threshold, 0.0, 1.0)
        text = json.dumps(config, indent=2, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise FileError(folder / CONFIG, error) from None
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(folder / WEIGHTS, data)
    replace_text(folder / CONFIG, text)


def _config_of(network: nn.Module) -> Any:
    return network.config


def load_model(folder: str | Path) -> SavedModel:
    """Read a model folder; any damage, and a spec that is not registered, raises FileError."""
    folder = check_path("folder", folder)
    config = _read_config(folder / CONFIG)
    data = read_file(folder / WEIGHTS, MOST_DATA_BYTES)
    if hashlib.sha256(data).hexdigest() != config["sha256"]:
        raise FileError(folder / WEIGHTS, f"its SHA-256 is not the one in {CONFIG}: truncated or altered")
    try:
        spec = spec_named(config["spec"])
    except ValueError as error:
        raise FileError(folder / CONFIG, error) from None
    network = _network(folder / CONFIG, spec, config["network"])
    network.load_state_dict(_weights(folder / WEIGHTS, data, network.state_dict()))
    return SavedModel(network.eval(), float(config["threshold"]), config["training"], spec)


def _read_config(path: Path) -> dict[str, Any]:
    config = read_json_object(path)
    # The version comes first: another version may have other keys.
    if type(config.get("format")) is not int or config["format"] != FORMAT:
        raise FileError(path, f"format must be {FORMAT}, got {config.get('format')!r}")
    _check_keys(path, "key", config, _KEYS)
    try:
        check_range("threshold", config["threshold"], 0.0, 1.0)
    except ValueError as error:
        raise FileError(path, error) from None
    for name, kind in (("spec", str), ("network", dict), ("sha256", str), ("training", dict)):
        if not isinstance(config[name], kind):
            raise FileError(path, f"{name} must be a {kind.__name__}, got {shortened(repr(config[name]))}")
    return config


def _check_keys(path: Path, what: str, given: dict[str, Any], wanted: set[str]) -> None:
    if unknown := sorted(given.keys() - wanted):
        choices = f"choose among {', '.join(sorted(wanted))}{did_you_mean(unknown[0], wanted)}"
        raise FileError(path, f"unknown {what} {shortened(unknown[0])!r}: {choices}")
    if missing := sorted(wanted - given.keys()):
        raise FileError(path, f"missing {what} {missing[0]!r}")


def _network(path: Path, spec: NetworkSpec, knobs: dict[str, Any]) -> nn.Module:
    known = {knob.name for knob in fields(spec.config_type)}
    knobs = {**{name: value for name, value in _ADDED.items() if name in known}, **knobs}
    _check_keys(path, "network key", knobs, known)
    try:
        return spec.build(spec.config_type(**knobs), seed=0)
    except (ValueError, TypeError) as error:
        raise FileError(path, error) from None


def _weights(path: Path, data: bytes, wanted: dict[str, Tensor]) -> dict[str, Tensor]:
    try:
        weights = safetensors.torch.load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise FileError(path, f"not safetensors: {error}") from None
    _check_keys(path, "tensor", weights, set(wanted))
    for name, value in weights.items():
        if value.dtype != torch.float32:
            raise FileError(path, f"{name} must be torch.float32, got {value.dtype}")
        if value.shape != wanted[name].shape:
            raise FileError(path, f"{name} must have shape {tuple(wanted[name].shape)}, got {tuple(value.shape)}")
    _check_finite(path, weights)
    return weights


def _check_finite(path: Path, weights: dict[str, Tensor]) -> None:
    for name, value in weights.items():
        if not bool(value.isfinite().all()):
            raise FileError(path, f"{name} holds numbers that are not finite")
