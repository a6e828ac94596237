"""The network of examples/own_network is trained, kept and scored as those that ship."""

from pathlib import Path

import pytest

import evaluate
import train
from cad_env.files import FileError
from policies.model_folder import load_model

FOLDER = Path(__file__).parents[2] / "examples" / "own_network"
NAME = "my_network:SPEC"
TINY = ("--scenario", "left_turn", "--episodes", "8", "--dagger-rounds", "0", "--steps", "6", "--validation", "1")


@pytest.fixture(autouse=True)
def _there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER)


def test_it_learns_and_is_scored_beside_the_rules(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    assert train.main(["--method", NAME, "stgraph", *TINY, "--score", "2", "--out", str(run)]) == 0
    rows = [line.split()[1] for line in capsys.readouterr().out.splitlines() if line.startswith("left_turn")]
    assert {NAME, "stgraph", "expert"} <= set(rows)
    model = load_model(run / "my_network_SPEC")
    assert model.spec.name == "deep_sets"
    words = ["--method", NAME, "--models", str(run), "--scenario", "left_turn", "--episodes", "26", "--jobs", "2"]
    assert evaluate.main([*words, "--no-report", "--out", str(tmp_path / "scores")]) == 0
    assert (
        evaluate.main(["--method", NAME, "--models", str(tmp_path), "--episodes", "1", "--out", str(tmp_path / "x")])
        == 2
    )
    assert "`python train.py --method my_network:SPEC --out runs/my_network_SPEC` trains it" in capsys.readouterr().err


def test_a_file_cannot_ask_for_an_import(tmp_path: Path) -> None:
    source = FOLDER.parents[1] / "policies" / "weights" / "all" / "stgraph"
    for name in ("model.safetensors", "config.json"):
        (tmp_path / name).write_bytes((source / name).read_bytes().replace(b'"spec": "stgraph"', b'"spec": "os:path"'))
    with pytest.raises(FileError, match="unknown spec 'os:path'"):
        load_model(tmp_path)


def test_a_policy_is_nothing_to_train(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train.main(["--method", "baselines.methods:Always(action=0)", "--out", str(tmp_path)]) == 2
    assert "is a policy, not a network spec" in capsys.readouterr().err
