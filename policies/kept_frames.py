"""Frames that are dear to make, kept on the disk: the same for all training seeds of a row, and after a restart.

Frames of points take minutes of casting rays to see again; those of graphs are replayed faster than they are worth
keeping. A file that is missing, damaged or of something else is made anew, so the folder may be deleted at any time.
"""

import hashlib
import io
import json
import sys
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cad_env.files import replace_file
from policies.family import Family, Frames
from policies.recording import Recording


def kept(
    folder: Path, made_with: Mapping[str, Any], family: Family, recorded: Recording, make: Callable[[], Frames]
) -> Frames:
    """The frames of recorded episodes, of a file in `folder` or, where there is none, as `make` gives them.

    `made_with` (of JSON) is all that they depend on beside the episodes and the code of the networks.
    """
    kind = family.kept_as
    if kind is None:
        return make()
    path = folder / f"{_name(made_with, family, recorded)}.npz"
    frames = _read(path, kind, recorded)
    if frames is None:
        frames = make()
        _write(path, frames)
    return frames


def _name(made_with: Mapping[str, Any], family: Family, recorded: Recording) -> str:
    known = hashlib.sha256(json.dumps({**made_with, "code": _code_of(type(family).__module__)}).encode())
    for name, value in vars(recorded).items():
        known.update(f"{name} {value.dtype} {value.shape}".encode() + value.tobytes())
    return known.hexdigest()[:24]


@cache
def _code_of(module: str) -> str:
    """Digest of the code of a family and of all that stands beside it, and here: an edit may change what is kept."""
    folders = {Path(__file__).parent, Path(str(sys.modules[module].__file__)).parent}
    sources = sorted(path for folder in folders for path in folder.glob("*.py"))
    return hashlib.sha256(b"".join(path.name.encode() + path.read_bytes() for path in sources)).hexdigest()


def _read(path: Path, kind: type, recorded: Recording) -> Frames | None:
    """None for a file that is not there or not what was written."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            parts = {field.name: archive[field.name] for field in fields(kind)}
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, zlib.error, EOFError):
        return None
    frames: Frames = kind(**{name: part if part.ndim else part.item() for name, part in parts.items()})
    return frames if np.array_equal(frames.label, recorded.label) else None


def _write(path: Path, frames: Frames) -> None:
    archive = io.BytesIO()
    np.savez_compressed(archive, **vars(frames))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, archive.getvalue())
    except OSError:
        pass  # a full or a read-only disk costs time the next time, and no more
