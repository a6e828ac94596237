"""Frames that are slow to make, kept on the disk: the same for all training seeds of a method, and after a restart.

Frames of points take minutes of casting rays to see again; those of graphs are replayed faster than they are worth
keeping. A file that is missing, damaged or of something else is made anew, so the folder may be deleted at any time.
"""

import hashlib
import json
from contextlib import suppress
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

from torch import nn

from cad_env.envs.vector import CADVectorEnv
from cad_env.files import FileError
from cad_env.simulation.setup import Setup
from cad_env.version import code_digest
from policies.spec import Frames, NetworkSpec
from policies.training.array_file import read_arrays, write_arrays
from policies.training.demonstrations import Demonstrations, replay, scenes_of
from policies.version import network_version

FORMAT = 2


def frames_of(
    folder: Path, recorded: Demonstrations, envs: CADVectorEnv, spec: NetworkSpec, network: nn.Module
) -> Frames:
    """The frames of recorded episodes as `spec` sees them in `envs`: from `folder`, or replayed and put there.

    Raises ReplayError as `replay` does, and nothing because of the folder.
    """
    if spec.kept_as is None:
        return spec.frames(*replay(recorded, envs, spec.look))
    key, episodes = _key(envs.batch.simulations[0].setup, spec, network), _digest_of(recorded)
    path = folder / f"{spec.name}_{hashlib.sha256(key.encode()).hexdigest()[:16]}" / f"{episodes}.npz"
    frames = _read(path, key + episodes, spec.kept_as)
    if frames is None:
        frames = spec.frames(*replay(recorded, envs, spec.look))
        with suppress(OSError):  # a full or a read-only disk costs time the next time, and no more
            _write(path, key + episodes, frames)
    return frames


def _key(setup: Setup, spec: NetworkSpec, network: nn.Module) -> str:
    """All that frames depend on beside their episodes, as JSON."""
    made_with = {
        **vars(setup), **scenes_of(setup), "format": FORMAT, "spec": spec.name,
        "looked with": spec.looked_with(network.config), "code": _code_of(type(spec).__module__),
    }  # fmt: skip
    return json.dumps(made_with, default=_settings, sort_keys=True)


def _settings(of: object) -> dict[str, Any]:
    """Those of a sensor, a radio or clouds; the codec is the spec's, and what it reads is in `looked_with`."""
    return {name: value for name, value in vars(of).items() if name != "codec"}


@cache
def _code_of(module: str) -> str:
    """Digest of the code of a spec's networks and of what sees frames here: an edit may change what is kept."""
    return network_version(module) + code_digest([Path(__file__).parent])


def _digest_of(recorded: Demonstrations) -> str:
    known = hashlib.sha256()
    for name, value in vars(recorded).items():
        known.update(f"{name} {value.dtype} {value.shape}".encode() + value.tobytes())
    return known.hexdigest()[:24]


def _read(path: Path, key: str, kind: type) -> Frames | None:
    """None for a file that is not there, or not what was written under this key."""
    try:
        found, arrays = read_arrays(path)
    except FileError:
        return None
    if found != key or set(arrays) != {part.name for part in fields(kind)}:
        return None
    frames: Frames = kind(**{name: part if part.ndim else part.item() for name, part in arrays.items()})
    return frames


def _write(path: Path, key: str, frames: Frames) -> None:
    """Write the frames whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_arrays(path, key, vars(frames))
