"""Where ray is installed, it gives the files of one process; where it is not, it says so."""

import signal
import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import evaluate
from baselines.evaluation.ray_backend import on_ray
from baselines.signals import Terminated, sigterm_as_ctrl_c

SOME = ["--scenario", "left_turn", "--method", "always-go", "planner-own", "--episodes", "30", "--no-report"]


@pytest.mark.skipif(find_spec("ray") is None, reason="ray is an extra")
def test_ray_gives_the_files_of_one_process(tmp_path: Path) -> None:
    assert evaluate.main([*SOME, "--out", str(tmp_path / "one")]) == 0
    assert evaluate.main([*SOME, "--backend", "ray", "--jobs", "2", "--out", str(tmp_path / "ray")]) == 0
    for name in ("episodes.jsonl", "scores.json", "settings.json"):
        assert (tmp_path / "ray" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()


@pytest.mark.skipif(find_spec("ray") is not None, reason="ray is installed")
def test_without_ray_the_backend_is_refused_with_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert evaluate.main([*SOME, "--backend", "ray", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == (
        "error: backend ray needs ray, which is not installed: pip install 'cad-env[ray]'\n"
    )
    assert not (tmp_path / "out").exists()


def test_sigterm_is_not_left_to_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    def init(**_: object) -> None:
        signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(number))

    found = ModuleType("ray")
    found.__dict__.update(
        init=init, is_initialized=lambda: False, shutdown=lambda: None, get=lambda done: done,
        remote=lambda work: SimpleNamespace(remote=work), wait=lambda waiting: (waiting[:1], waiting[1:]),
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "ray", found)
    errors = ModuleType("ray.exceptions")
    errors.__dict__.update(RayError=OSError, RayTaskError=ValueError)
    monkeypatch.setitem(sys.modules, "ray.exceptions", errors)
    with sigterm_as_ctrl_c():
        assert list(on_ray(abs, [-1, -2], 1)) == [1, 2]
        with pytest.raises(Terminated):
            signal.raise_signal(signal.SIGTERM)


def test_an_unknown_backend_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main([*SOME, "--backend", "fax", "--out", str(tmp_path / "out")]) == 2
    assert "backend must be one of processes, ray, got 'fax'" in capsys.readouterr().err
