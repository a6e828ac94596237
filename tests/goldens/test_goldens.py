"""The same episodes, weights and results as ever, to the last bit."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.goldens.compute import HERE, goldens, processor, stored

KNOWN = json.loads(stored().read_text()) if stored().exists() else {}
of_this_processor = pytest.mark.skipif(
    not KNOWN, reason=f"goldens are of {', '.join(path.stem for path in HERE.glob('*.json'))}, not of {processor()}"
)


@of_this_processor
@pytest.mark.parametrize(("name", "compute"), list(goldens()), ids=[name for name, _ in goldens()])
def test_nothing_has_moved(name: str, compute: Callable[[Path], str], tmp_path: Path) -> None:
    assert compute(tmp_path / "new") == KNOWN[name]


@of_this_processor
def test_every_golden_is_computed() -> None:
    assert set(KNOWN) == {name for name, _ in goldens()}
