"""What results are marked with moves with the code of an episode, and with nothing else."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cad_env import version as version_module
from cad_env.version import EPISODE_CODE, PACKAGE, code_digest, version

SOURCE = '"""A module."""\n\nSPEED = 1.0  # m/s\n'
SOURCE += '\n\ndef twice(x: float) -> float:\n    """Twice as much."""\n    return 2 * x\n'


def digest_of(folder: Path, text: str) -> str:
    """The digest of a folder with one module."""
    (folder / "module.py").write_text(text)
    return code_digest([folder])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("A module.", "Another word."),
        ('    """Twice as much."""\n', ""),
        ("  # m/s", "  # metres per second"),
        ("2 * x", "2*x"),
        ("x: float) -> float", "x: int)"),
    ],
)
def test_words_and_layout_do_not_count(tmp_path: Path, old: str, new: str) -> None:
    assert SOURCE.replace(old, new) != SOURCE
    assert digest_of(tmp_path, SOURCE) == digest_of(tmp_path, SOURCE.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new"), [("SPEED = 1.0", "SPEED = 1.5"), ("2 * x", "3 * x"), ("x: float)", "x: float, y=0)")]
)
def test_code_counts(tmp_path: Path, old: str, new: str) -> None:
    assert digest_of(tmp_path, SOURCE) != digest_of(tmp_path, SOURCE.replace(old, new))


def test_another_name_of_a_module_counts(tmp_path: Path) -> None:
    before = digest_of(tmp_path, SOURCE)
    (tmp_path / "module.py").rename(tmp_path / "other.py")
    assert code_digest([tmp_path]) != before


def test_only_the_code_of_an_episode_counts_in_a_copy_of_the_package(tmp_path: Path) -> None:
    copy = tmp_path / "cad_env"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    assert digest_of_copy(copy) == version()
    for part, old, new in (
        ("rendering/layers.py", "import", "import sys\nimport"),
        ("scoring/scorecard.py", "import", "import sys\nimport"),
        ("animation.py", "import", "import sys\nimport"),
        ("pipeline/merge.py", "Own graph", "One graph"),
        ("pipeline/merge.py", "# m; closer", "# metres; closer"),
    ):
        edit(copy / part, old, new)
        assert digest_of_copy(copy) == version()
    edit(copy / "pipeline/merge.py", "GATE = 2.5", "GATE = 2.6")
    assert digest_of_copy(copy) != version()


def digest_of_copy(package: Path) -> str:
    """What `version` says of another place."""
    return code_digest(package / part for part in EPISODE_CODE)


def edit(path: Path, old: str, new: str) -> None:
    """Replace the first of some words in a file."""
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_no_folder_needs_to_be_writable(tmp_path: Path) -> None:
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"), "/dev/null")
    code = "from cad_env.version import version; print(version())"
    said = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **nowhere}, cwd=PACKAGE.parent, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert said.stdout.strip() == version()


def test_all_that_moves_an_episode_is_covered_and_no_picture() -> None:
    assert all((PACKAGE / part).exists() for part in EPISODE_CODE)
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert rooms - {part.partition("/")[0] for part in EPISODE_CODE} == {"rendering"}
    assert version() == version_module.version()
    assert len(version()) == 12
