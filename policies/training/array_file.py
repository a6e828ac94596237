"""Arrays in one file: a compressed npz with a text that says what they are, and the SHA-256 of it all at the end."""

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cad_env.files import replace_file

_CHECKSUM = hashlib.sha256().digest_size  # bytes; the checksums of zip leave its headers out
_TEXT = "text"


class ArrayFileError(ValueError):
    """A file that is missing or damaged; one line with its path and the reason."""


def write_arrays(path: Path, text: str, arrays: Mapping[str, Any]) -> None:
    """Write a file whole or not at all."""
    archive = io.BytesIO()
    np.savez_compressed(archive, **{_TEXT: np.array(text), **arrays})
    data = archive.getvalue()
    replace_file(path, data + hashlib.sha256(data).digest())


def read_arrays(path: Path) -> tuple[str, dict[str, NDArray[Any]]]:
    """The text and the arrays of a file; ArrayFileError if it is missing or not as it was written."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ArrayFileError(f"{path}: {error.strerror or 'cannot be read'}") from None
    archive = data[:-_CHECKSUM]
    if hashlib.sha256(archive).digest() != data[-_CHECKSUM:]:
        raise ArrayFileError(f"{path}: truncated or altered")
    with np.load(io.BytesIO(archive), allow_pickle=False) as parts:
        arrays = {name: parts[name] for name in parts.files}
    return str(arrays.pop(_TEXT)), arrays
