"""The policies of examples/own_policy are scored beside the others, from any folder."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import evaluate
from baselines.methods import method_named
from cad_env.envs.vector import CADVectorEnv
from cad_env.scoring.rollout import rollouts

FOLDER = Path(__file__).parents[2] / "examples" / "own_policy"
BLIND = "my_policy:BlindBrake(seconds=1.0)"


@pytest.fixture(autouse=True)
def _there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER)


def words(out: Path, *more: str) -> list[str]:
    return [
        "--method",
        BLIND,
        "my_policy:BrakeNearJunction",
        "always-go",
        "--scenario",
        "left_turn",
        "--out",
        str(out),
        *more,
    ]


def test_they_are_in_the_table_beside_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main(words(tmp_path, "--episodes", "27", "--jobs", "2", "--gif", "1")) == 0
    shown = capsys.readouterr().out
    assert BLIND in shown
    assert "my_policy:BrakeNearJunction" in shown
    records = [json.loads(line) for line in (tmp_path / "episodes.jsonl").read_text().splitlines()]
    assert {record["method"] for record in records} == {BLIND, "my_policy:BrakeNearJunction", "always-go", "expert"}
    assert all(record["brakes"] == 10 for record in records if record["method"] == BLIND)
    assert {record["bytes_total"] for record in records} == {0}
    assert BLIND in (tmp_path / "report.html").read_text()
    assert len(list((tmp_path / "gifs").glob("*BlindBrake*.gif"))) >= 1


def test_a_shard_of_them_merges(tmp_path: Path) -> None:
    for part in ("1/2", "2/2"):
        assert evaluate.main(words(tmp_path, "--episodes", "4", "--shard", part, "--no-report")) == 0
    shards = [str(tmp_path / f"shard_{k}_of_2") for k in (1, 2)]
    assert evaluate.main(["--merge", *shards, "--out", str(tmp_path / "whole"), "--no-report"]) == 0
    assert len((tmp_path / "whole" / "episodes.jsonl").read_text().splitlines()) == 16


def test_an_edited_policy_does_not_go_on_with_old_episodes(tmp_path: Path) -> None:
    program = (
        f"import evaluate, sys; sys.exit(evaluate.main({words(tmp_path / 'out', '--episodes', '1', '--no-report')!r}))"
    )
    work = tmp_path / "work"
    work.mkdir()
    source = (FOLDER / "my_policy.py").read_text()
    codes = []
    for text in (source, source, source.replace("seconds: float = 5.0", "seconds: float = 4.0")):
        (work / "my_policy.py").write_text(text)
        ended = subprocess.run(
            [sys.executable, "-c", program], cwd=work, capture_output=True, text=True, check=False,
            env={"PYTHONPATH": str(FOLDER.parents[1]), "PATH": "", "HOME": str(Path.home())},
        )  # fmt: skip
        codes.append(ended.returncode)
    assert codes == [0, 0, 2]
    assert "another model of my_policy" in ended.stderr


def test_it_decides_alone_as_in_the_table() -> None:
    method = method_named(BLIND)
    assert method.make_policy is not None
    episode = next(rollouts(CADVectorEnv(1, radio="none"), method.make_policy("left_turn"), [1_000_000]))
    assert episode.action[:12].tolist() == [1] * 10 + [0] * 2


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("my_policies:BlindBrake", "No module named 'my_policies'"),
        ("my_policy:Blind", "my_policy has no 'Blind'"),
        ("my_policy:BlindBrake(seconds=1", "must be module:name or module:name(argument=value)"),
        ("my_policy:BlindBrake(seconds=open('x'))", "arguments must be literals"),
        ("my_policy:BlindBrake(minutes=1)", "unexpected keyword argument 'minutes'"),
        ("my_policy:field", "is no policy: it has no reset()"),
        ("stgrap", "did you mean stgraph?"),
    ],
)
def test_what_is_no_policy_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, said: str
) -> None:
    assert evaluate.main(["--method", name, "--episodes", "1", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error


def test_a_module_that_is_no_python_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "broken_policy.py").write_text("class Policy(\n")
    monkeypatch.chdir(tmp_path)
    assert evaluate.main(["--method", "broken_policy:Policy", "--episodes", "1", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "was never closed" in error
