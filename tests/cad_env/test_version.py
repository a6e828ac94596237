"""What results are marked with moves with the code of an episode, and with nothing else."""

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


def test_all_that_moves_an_episode_is_covered_and_no_picture() -> None:
    assert all((PACKAGE / part).exists() for part in EPISODE_CODE)
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert rooms - {part.partition("/")[0] for part in EPISODE_CODE} == {"rendering"}
    assert version() == version_module.version()
    assert len(version()) == 12
