"""The demonstration prints every scene and method, and keeps nothing."""

import tempfile
from pathlib import Path

import pytest

from baselines.demo import METHODS_SHOWN, main
from cad_env.scenarios import SHIPPED


def test_it_prints_a_table_and_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert main(["--episodes", "1", "--jobs", "1"]) == 0
    rows = [line.split()[:4] for line in capsys.readouterr().out.splitlines() if line.startswith(SHIPPED)]
    assert rows == [[scenario, method, "all", "1"] for scenario in SHIPPED for method in METHODS_SHOWN]
    assert not list(tmp_path.iterdir())


def test_an_impossible_number_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--episodes", "0"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "episodes" in error
