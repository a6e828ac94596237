"""Arrays in one file: a compressed npz with a text that says what they are, and the SHA-256 of it all at the end."""

import hashlib
import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cad_env.files import MOST_DATA_BYTES, FileError, read_file, replace_file

_CHECKSUM = hashlib.sha256().digest_size  # bytes; the checksums of zip leave its headers out
_TEXT = "text"
# What zipfile and numpy raise for bytes that are no npz, or one that nobody writes here.
_NO_ARCHIVE = (
    zipfile.BadZipFile, zlib.error, ValueError, TypeError, KeyError, EOFError, OSError, RuntimeError, MemoryError,
    OverflowError, SyntaxError,
)  # fmt: skip


def write_arrays(path: Path, text: str, arrays: Mapping[str, Any]) -> None:
    """Write a file whole or not at all."""
    archive = io.BytesIO()
    np.savez_compressed(archive, **{_TEXT: np.array(text), **arrays})
    data = archive.getvalue()
    replace_file(path, data + hashlib.sha256(data).digest())


def read_arrays(path: Path) -> tuple[str, dict[str, NDArray[Any]]]:
    """The text and the arrays of a file; FileError if it is missing or not as it was written."""
    data = read_file(path, MOST_DATA_BYTES)
    archive = data[:-_CHECKSUM]
    if hashlib.sha256(archive).digest() != data[-_CHECKSUM:]:
        raise FileError(path, "truncated or altered")
    try:
        arrays = _unpacked(archive)
    except _NO_ARCHIVE as error:
        raise FileError(path, f"not an archive of arrays: {error}") from None
    text = arrays.pop(_TEXT, None)
    if text is None or text.ndim or text.dtype.kind != "U":
        raise FileError(path, f"{_TEXT} must be one text")
    return str(text), arrays


def _unpacked(archive: bytes) -> dict[str, NDArray[Any]]:
    """The arrays in the bytes of an npz, by name."""
    with zipfile.ZipFile(io.BytesIO(archive)) as parts:
        names = [name.removesuffix(".npy") for name in parts.namelist()]
    if len(set(names)) < len(names):
        raise ValueError("a name comes twice")
    with np.load(io.BytesIO(archive), allow_pickle=False) as arrays:
        return {name: np.asarray(arrays[name]) for name in arrays.files}
