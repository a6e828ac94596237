"""What the project says about itself is true: its pins, its two commands, its distribution."""

import re
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent
PINS = [
    Requirement(line) for line in (ROOT / "constraints.txt").read_text().splitlines() if line and line[0] not in "# "
]
REQUIRED = [Requirement(text) for text in requires("cad-env") or []]


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.parametrize("required", REQUIRED, ids=lambda required: required.name)
def test_every_requirement_is_pinned_inside_its_range(required: Requirement) -> None:
    pins = [pin for pin in PINS if plain(pin.name) == plain(required.name)]
    assert len(pins) == 1
    (version,) = pins[0].specifier
    assert required.specifier.contains(version.version)


def test_pins_are_names_and_versions_only() -> None:
    for pin in PINS:
        assert pin.url is None
        assert re.fullmatch(r"==\d+(\.\d+)*(\.?(post|rc|a|b)\d+)?", str(pin.specifier)), pin


def test_the_first_screen_has_two_commands_that_set_themselves_up() -> None:
    first_screen = (ROOT / "README.md").read_text().split("\n## ")[0]
    commands = [line for block in re.findall(r"```bash\n(.*?)```", first_screen, re.S) for line in block.splitlines()]
    start = "python3 -m venv .venv && .venv/bin/pip install -c constraints.txt -e "
    assert commands == [
        f"{start}. && .venv/bin/python train.py",
        f'{start}".[dev]" && .venv/bin/python -m pytest',
    ]
