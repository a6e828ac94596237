"""The code of docs/write-your-own.md runs as it stands, and the scenario in it does what its text says."""

import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from scenes import Steady, forget

from baselines.evaluation.command import main as evaluate
from cad_env.envs.vector import CADVectorEnv
from cad_env.rules.expert import expert_of
from cad_env.scoring.rollout import rollouts
from cad_env.types import GO

PAGE = Path(__file__).parents[2] / "docs" / "write-your-own.md"


def blocks(section: str) -> list[str]:
    """The Python code of a section, one block after another."""
    (text,) = (part for part in re.split(r"^## ", PAGE.read_text(), flags=re.M) if part.startswith(section + "\n"))
    return re.findall(r"```python\n(.*?)```", text, re.S)


@pytest.fixture
def quiet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The scenario of the page, from a file of the name that it says."""
    source = blocks("A scenario")[0]
    name = re.match(r"# (\w+\.py)\n", source)
    assert name is not None
    (tmp_path / name[1]).write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    module = __import__(Path(name[1]).stem)
    yield module.QUIET_CROSSING
    forget(module.QUIET_CROSSING)
    del sys.modules[module.__name__]


def test_the_code_runs(quiet):
    known: dict[str, Any] = {}
    for code in blocks("A scenario")[1:]:
        exec(code, known)
    assert known["env"].unwrapped.simulation.scenario is quiet


def test_the_commands_take_it(quiet, tmp_path: Path):
    asked = re.search(r"evaluate\.py (--scenario .*)", PAGE.read_text())
    assert asked is not None
    out = tmp_path / "out"
    assert evaluate([*asked[1].split(), "--episodes", "2", "--no-report", "--jobs", "2", "--out", str(out)]) == 0
    assert '"quiet_crossing"' in (out / "episodes.jsonl").read_text()


def test_its_hazard_is_one_and_its_expert_avoids_it(quiet):
    envs = CADVectorEnv(8, scenario=quiet, traffic="dense")
    ends = {}
    for name, policy in (("go", Steady(GO)), ("expert", expert_of(quiet))):
        for hazard in (True, False):
            ends[name, hazard] = Counter(each.outcome for each in rollouts(envs, policy, range(40), hazard=hazard))
    assert ends["go", True]["collision"] == 40
    assert ends["go", False] == ends["expert", True] == ends["expert", False] == {"success": 40}
