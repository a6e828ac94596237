"""Files: written whole or not at all, and read with one line that names the file for whatever is wrong with it."""

import csv
import io
import json
import math
import os
import stat
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cad_env.checks import ConfigError

MOST_BYTES = 2**26  # of a file of settings or a table
MOST_DATA_BYTES = 2**34  # of a file of episodes, arrays, weights or pictures
MOST_NESTED = 64  # levels of lists and objects in JSON
MOST_DIGITS = 4300  # of a whole number: as many as Python writes; what holds a number says how large it may be
MOST_REASON = 600  # letters of a message: what was found in a file may be of any length

_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a named pipe", stat.S_IFSOCK: "a socket"}


class FileError(ConfigError):
    """A file that cannot be used: one line with its path and the reason, which names the field where there is one."""

    def __init__(self, path: Path, reason: object) -> None:
        super().__init__(path, str(reason))  # as they came: a worker process hands the error on by its arguments

    def __str__(self) -> str:
        reason = " ".join(self.args[1].split())
        return " ".join(f"{self.args[0]}:".split()) + " " + shortened(reason, MOST_REASON)


def shortened(text: str, most: int = 60) -> str:
    """A text of at most so many letters.

    >>> shortened("0" * 100, 10)
    '0000000...'
    """
    return text if len(text) <= most else text[: most - 3] + "..."


def replace_file(path: Path, data: bytes) -> None:
    """Write a file so that a reader, or a kill at any moment, finds the old content or the new, never a part."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)  # mkstemp lets nobody else read
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)  # an interruption may come when it has just been renamed
        raise


def replace_text(path: Path, text: str) -> None:
    """The same for text, in UTF-8; what that cannot write, such as bytes of a path that were no text, as escapes."""
    replace_file(path, text.encode("utf-8", "backslashreplace"))


def read_file(path: Path, most: int = MOST_BYTES) -> bytes:
    """The bytes of a regular file; FileError for one that is missing, of another kind, or of more bytes than `most`.

    A named pipe is refused and not waited for.
    """
    try:
        # Opened before it is looked at, so that it cannot be exchanged in between; O_NONBLOCK, for pipes.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        raise FileError(path, getattr(error, "strerror", None) or error) from None
    try:
        found = os.fstat(handle)
        check_regular(path, found)
        if found.st_size > most:
            raise FileError(path, f"must have at most {most} bytes, has {found.st_size}")
        with open(handle, "rb", closefd=False) as file:
            data = file.read()
    except OSError as error:
        raise FileError(path, error.strerror or "cannot be read") from None
    finally:
        os.close(handle)
    if len(data) > most:
        raise FileError(path, f"must have at most {most} bytes, has more")
    return data


def check_regular(path: Path, found: os.stat_result | None = None) -> None:
    """Refuse whatever is no regular file with a FileError: to open a named pipe may wait for ever.

    `found` is what is known of it already; a path where there is nothing is no error.
    """
    try:
        mode = (found or os.stat(path)).st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        raise FileError(path, f"must be a regular file, is {_KINDS.get(stat.S_IFMT(mode), 'a device')}")


def read_text(path: Path, most: int = MOST_BYTES) -> str:
    """The text of a file in UTF-8; FileError as `read_file`, and for bytes that are no text."""
    try:
        return read_file(path, most).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(path, f"not UTF-8 text: byte {error.start}") from None


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds; ConfigError, one line with the field, for text that is none, and for what is refused.

    Refused are keys that come twice, numbers that are not finite or of more than `MOST_DIGITS` digits, and more than
    `MOST_NESTED` levels.

    >>> parse_json('{"radio": {"loss": [0.5, 1e999]}}')
    Traceback (most recent call last):
    cad_env.checks.ConfigError: radio.loss[1] must be a finite number, got inf
    """
    try:
        decoded = text.decode("utf-8") if isinstance(text, bytes) else text
        found = json.loads(decoded, object_pairs_hook=_object, parse_int=_whole)
    except ConfigError:
        raise
    except RecursionError:
        raise ConfigError(f"not JSON of at most {MOST_NESTED} levels") from None
    except ValueError as error:
        raise ConfigError(f"not JSON: {' '.join(str(error).split())}") from None
    _check_values(found, "", 0)
    return found


class _TooLong(int):
    """In the place of a whole number with this many digits."""


def _whole(digits: str) -> int:
    return int(digits) if len(digits) <= MOST_DIGITS else _TooLong(len(digits))


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ConfigError(f"not JSON with every key once: {shortened(repr(twice))} comes twice")
    return found


def _check_values(value: object, field: str, level: int) -> None:
    """Refuse what Python's reader lets through; `field` is where the value is."""
    if isinstance(value, dict | list):
        if level >= MOST_NESTED:
            raise ConfigError(f"not JSON of at most {MOST_NESTED} levels")
        if isinstance(value, dict):
            for name, part in value.items():
                _check_values(part, f"{field}.{shortened(name)}" if field else shortened(name), level + 1)
        else:
            for place, part in enumerate(value):
                _check_values(part, f"{field}[{place}]", level + 1)
    elif isinstance(value, _TooLong):
        raise ConfigError(f"{field or 'it'} must have at most {MOST_DIGITS} digits, has {int(value)}")
    elif isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{field or 'it'} must be a finite number, got {value}")


def read_json(path: Path, most: int = MOST_BYTES) -> Any:
    """What a JSON file holds; FileError as `read_file`, and for whatever `parse_json` refuses."""
    try:
        return parse_json(read_file(path, most))
    except FileError:
        raise
    except ConfigError as error:
        raise FileError(path, error) from None


def read_json_object(path: Path, most: int = MOST_BYTES) -> dict[str, Any]:
    """The same for a file that must hold an object."""
    found = read_json(path, most)
    if not isinstance(found, dict):
        raise FileError(path, f"must hold a JSON object, got {type(found).__name__}")
    return found


def read_rows(path: Path, columns: Sequence[str], most: int = MOST_BYTES) -> list[tuple[int, Mapping[str, str]]]:
    """The rows of a CSV file with these columns, each with the number of its last line.

    A last line without its end, as an interrupted write leaves it, does not count. FileError for other columns and
    for a row that has not as many fields.
    """
    text = read_text(path, most)
    whole = text[: text.rfind("\n") + 1]
    reader = csv.reader(io.StringIO(whole, newline=""), strict=True)
    rows: list[tuple[int, Mapping[str, str]]] = []
    try:
        if next(reader, None) != list(columns):
            raise FileError(path, f"line 1 must name the columns {', '.join(columns)}")
        for fields in reader:
            if len(fields) != len(columns) or "\0" in "".join(fields):
                raise FileError(path, f"line {reader.line_num} must have {len(columns)} fields of text")
            rows.append((reader.line_num, dict(zip(columns, fields, strict=True))))
    except csv.Error as error:
        raise FileError(path, f"line {reader.line_num}: {error}") from None
    return rows
