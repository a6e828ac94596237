"""The one way this project compiles a function: numba, cached, with a cache that cannot go stale.

Numba's own cache notices a change in the file of a compiled function, but not in the files of the functions
it calls. Here the cache folder is named after the content of every source file of the function's package and of
this one, so any edit starts a new cache; but for the rooms of this package that nothing compiled may import. It lives
in the user's cache folder, so a read-only installation works.
"""

import atexit
import hashlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import config as numba_config

_PACKAGE = Path(__file__).parent.parent  # cad_env
# Rooms above all that is compiled: the import contracts keep compiled code from reading anything there.
_NOT_COMPILED = ("animation.py", "envs", "rendering")
Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function` to machine code at its first call; with NUMBA_DISABLE_JIT=1 return it as it is."""
    return _compiled(function, from_python=True)


def compiled_part(function: Function) -> Function:
    """As `compiled`, without a way in from Python, which compiles faster. Only compiled functions may call the result.

    Called from Python it ends the process: numba does not check.
    """
    return _compiled(function, from_python=False)


def inlined(function: Function) -> Function:
    """As `compiled`, and copied into its compiled callers, for what inner loops call.

    A record of arrays is handed over as hundreds of numbers: such a call costs 0.1 us.
    """
    return _compiled(function, from_python=True, inline=True)


def inlined_part(function: Function) -> Function:
    """As `inlined`, without a way in from Python: see `compiled_part`."""
    return _compiled(function, from_python=False, inline=True)


def _compiled(function: Function, from_python: bool, inline: bool = False) -> Function:
    before = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(cache_folder(_package(function)))
    try:
        # error_model="numpy": a division by zero gives inf as in numpy, and the check costs nothing.
        compiler = numba.njit(  # type: ignore[call-overload]  # the last three are not in numba's stubs
            cache=True, error_model="numpy", forceinline=inline, no_cpython_wrapper=not from_python,
            no_cfunc_wrapper=not from_python,
        )  # fmt: skip
        return cast(Function, compiler(function))
    finally:
        numba_config.CACHE_DIR = before


@cache
def announce_compilation(function: str) -> None:
    """Say once on stderr that the machine code of `module.function` is yet to be made, which takes a while."""
    here = cache_folder()
    if not numba_config.DISABLE_JIT and next(here.rglob(f"{function}-*.nbi"), None) is None:
        print("cad_env: compiling the simulation for this machine, about half a minute, once", file=sys.stderr)


def _package(function: Callable[..., Any]) -> Path:
    """The folder of the top-level package, or of the single module, that a function is from."""
    module = sys.modules[function.__module__.partition(".")[0]]
    if hasattr(module, "__path__"):
        return Path(next(iter(module.__path__)))
    return Path(module.__file__).parent if module.__file__ else _PACKAGE


@cache
def cache_folder(package: Path = _PACKAGE) -> Path:
    """The folder of machine code that belongs to exactly this version of the sources in `package` and here."""
    digest = hashlib.sha256()
    for folder in sorted({package, _PACKAGE}):
        for source in sorted(folder.rglob("*.py")):
            if folder != _PACKAGE or source.relative_to(folder).parts[0] not in _NOT_COMPILED:
                digest.update(source.read_bytes())
    name = digest.hexdigest()[:16]
    for parent in _candidate_parents():
        folder = parent / "cad-env" / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return _temporary_folder(name)


def _candidate_parents() -> list[Path]:
    """Where a cache may be, the user's choice first. Paths that are not absolute are no cache or home folders.

    A user who is not known to the system and has no HOME has no home: there `~` stays `~`.
    """
    chosen, home = os.environ.get("NUMBA_CACHE_DIR"), os.path.join(os.path.expanduser("~"), ".cache")
    usual = [parent for parent in (os.environ.get("XDG_CACHE_HOME"), home) if parent and os.path.isabs(parent)]
    return [Path(parent) for parent in ([chosen] if chosen else []) + usual]


def _temporary_folder(name: str) -> Path:
    """The folder of this user under the temporary one, for all processes; one for this process if that is not safe.

    Everybody may write to the temporary folder, and what is in a cache is run.
    """
    user = os.getuid() if hasattr(os, "getuid") else "user"  # on Windows everybody has a temporary folder of their own
    parent = Path(tempfile.gettempdir()) / f"cad-env-{user}"
    try:
        parent.mkdir(mode=0o700, exist_ok=True)
        if _is_own(parent):
            folder = parent / name
            folder.mkdir(mode=0o700, exist_ok=True)
            return folder
    except OSError:
        pass
    own = tempfile.mkdtemp(prefix="cad-env-")
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    return Path(own)


def _is_own(folder: Path) -> bool:
    """Whether a folder, and no link to one, is this user's, and nobody else may write to it."""
    found = folder.lstat()
    if not hasattr(os, "getuid"):
        return stat.S_ISDIR(found.st_mode)
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022
