"""Where the machine code is kept: one place for all processes of a user, whatever they may write to."""

import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from cad_env.numerics import jit

PLACES = ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR")
PROGRAM = """
import pwd
def unknown(uid):
    raise KeyError(uid)
pwd.getpwuid = unknown  # as in a container that runs as some number
import numpy as np
from cad_env.numerics.jit import cache_folder
from cad_env.numerics.philox import uniform
uniform(np.zeros(2, np.uint64), 1, 2, 3, 4)
print(cache_folder(), sum(uniform.stats.cache_hits.values()))
"""


def said_by(folder: Path, **places: str) -> tuple[Path, bool]:
    """In a process of its own: the cache folder, and whether machine code was found there."""
    (folder / "tmp").mkdir(exist_ok=True)
    (folder / "here").mkdir(exist_ok=True)
    kept = {name: value for name, value in os.environ.items() if name not in PLACES}
    env = {**kept, "TMPDIR": str(folder / "tmp"), "PYTHONPATH": str(Path(jit.__file__).parents[2]), **places}
    found = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=folder / "here", env=env, capture_output=True, text=True, check=True
    )
    assert list((folder / "here").iterdir()) == []  # no folder named `~` where the program was started
    where, hits = found.stdout.split()
    return Path(where), hits != "0"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="users have numbers")
@pytest.mark.parametrize(
    "places", [{}, dict.fromkeys(PLACES, "/dev/null"), {"HOME": "here/home", "XDG_CACHE_HOME": "cache"}]
)
def test_without_a_folder_to_write_to_all_processes_of_a_user_share_one(tmp_path: Path, places: dict[str, str]):
    first, second = said_by(tmp_path, **places), said_by(tmp_path, **places)
    assert first == (tmp_path / "tmp" / f"cad-env-{os.getuid()}" / jit.cache_folder().name, False)
    assert second == (first[0], True)
    assert [path.name for path in (tmp_path / "tmp").iterdir()] == [f"cad-env-{os.getuid()}"]
    assert stat.S_IMODE(first[0].parent.stat().st_mode) == 0o700


def test_a_folder_of_the_user_s_choice_comes_first(tmp_path: Path):
    for name in reversed(PLACES):
        place = tmp_path / name
        place.mkdir()
        where, _ = said_by(tmp_path, **{name: str(place)})
        assert where.parent == (place / ".cache" if name == "HOME" else place) / "cad-env"
        assert list((tmp_path / "tmp").iterdir()) == []


def by_link(place: Path) -> None:
    place.with_name("elsewhere").mkdir(mode=0o700)
    place.symlink_to(place.with_name("elsewhere"))


def open_to_all(place: Path) -> None:
    place.mkdir()
    place.chmod(0o777)


def as_a_file(place: Path) -> None:
    place.write_text("", encoding="utf-8")


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="users have numbers")
@pytest.mark.parametrize("prepare", [by_link, open_to_all, as_a_file])
def test_what_somebody_else_may_have_put_there_is_not_used(tmp_path: Path, monkeypatch, prepare):
    place = tmp_path / f"cad-env-{os.getuid()}"
    prepare(place)
    assert not is_used(place, tmp_path, monkeypatch)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="users have numbers")
def test_the_owner_is_checked(tmp_path: Path, monkeypatch):
    user = os.getuid()
    place = tmp_path / f"cad-env-{user + 1}"
    place.mkdir(mode=0o700)
    monkeypatch.setattr(os, "getuid", lambda: user + 1)
    assert not is_used(place, tmp_path, monkeypatch)
    monkeypatch.setattr(os, "getuid", lambda: user)
    assert is_used(tmp_path / f"cad-env-{user}", tmp_path, monkeypatch)


def is_used(place: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether the cache would be in `place`; if not, it is in a folder that goes with the process."""
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    removed = []
    monkeypatch.setattr(jit.atexit, "register", lambda _, folder, **__: removed.append(Path(folder)))
    found = jit._temporary_folder("code")
    assert found.is_dir()
    assert found.parent == temporary or found == place / "code"
    assert removed == ([] if found == place / "code" else [found])
    return found == place / "code"
