"""What marks the answers of a network moves with its code and with that of no other kind."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from policies.stgraph import spec as stgraph_spec
from policies.version import network_version


def loaded(path: Path, text: str) -> str:
    """A module of this text, as one that has been imported; its name."""
    path.write_text(text)
    module = ModuleType(path.stem)
    module.__file__ = str(path)
    sys.modules[path.stem] = module
    network_version.cache_clear()
    return path.stem


def test_a_module_from_outside_is_covered_by_its_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "own_network_for_a_test", ModuleType("empty"))
    path = tmp_path / "own_network_for_a_test.py"
    before = network_version(loaded(path, "WIDTH = 8\n"))
    (tmp_path / "beside.py").write_text("not python")
    assert network_version(loaded(path, '"""Words."""\nWIDTH = 8  # units\n')) == before
    assert network_version(loaded(path, "WIDTH = 9\n")) != before


def test_of_a_package_all_is_covered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "spec_for_a_test", ModuleType("empty"))
    (tmp_path / "__init__.py").write_text("")
    (tmp_path / "network.py").write_text("WIDTH = 8\n")
    before = network_version(loaded(tmp_path / "spec_for_a_test.py", ""))
    (tmp_path / "network.py").write_text("WIDTH = 9\n")
    assert network_version(loaded(tmp_path / "spec_for_a_test.py", "")) != before


def test_kinds_of_networks_differ() -> None:
    assert len(network_version(stgraph_spec.__name__)) == 12
    assert network_version(stgraph_spec.__name__) != network_version("policies.version")
