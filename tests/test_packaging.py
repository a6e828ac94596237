"""What the project says about itself is true: its pins, its two commands, its distribution."""

import re
from importlib.metadata import requires
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest
from packaging.requirements import Requirement

import cad_env

ROOT = Path(__file__).parent.parent
PINS = [
    Requirement(line) for line in (ROOT / "constraints.txt").read_text().splitlines() if line and line[0] not in "# "
]
REQUIRED = [required for text in requires("cad-env") or [] if (required := Requirement(text)).name != "cad-env"]


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


def test_the_first_screen_has_two_commands_that_set_themselves_up_and_the_demo() -> None:
    first_screen = (ROOT / "README.md").read_text().split("\n## ")[0]
    commands = [line for block in re.findall(r"```bash\n(.*?)```", first_screen, re.S) for line in block.splitlines()]
    start = "python3 -m venv .venv && .venv/bin/pip install -c constraints.txt -e "
    assert commands == [
        f'{start}".[learning]" && .venv/bin/python train.py',
        f'{start}".[dev]" && .venv/bin/python -m pytest',
        ".venv/bin/cad-demo",
    ]


def test_the_citation_names_this_version() -> None:
    (version,) = re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert version == cad_env.__version__


def setup_script() -> ModuleType:
    spec = spec_from_file_location("cad_env_setup", ROOT / "setup.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SETUP = setup_script()


def rewritten(source: str) -> str:
    answer: str = SETUP.rewritten(source)
    return answer


@pytest.mark.parametrize(
    ("source", "wanted"),
    [
        ("from policies.spec import A\n", "from cad_learning.policies.spec import A\n"),
        ("from baselines import cli\n", "from cad_learning.baselines import cli\n"),
        ("import policies\n", "from cad_learning import policies\n"),
        ("import policies.spec as p\n", "import cad_learning.policies.spec as p\n"),
        ("def f():\n    from policies.spec import A\n", "def f():\n    from cad_learning.policies.spec import A\n"),
        ('x = "policies.stgraph.spec"\n', 'x = "cad_learning.policies.stgraph.spec"\n'),
        ('"é", "policies.spec"\n', '"é", "cad_learning.policies.spec"\n'),
        ("# policies.spec\n", "# policies.spec\n"),
        ('"""See policies.spec for more."""\n', '"""See policies.spec for more."""\n'),
        ("from .policies import A\nfrom policiesx import B\n", "from .policies import A\nfrom policiesx import B\n"),
        ("import os, json\n", "import os, json\n"),
    ],
)
def test_imports_are_adapted_on_their_way_into_a_wheel(source: str, wanted: str) -> None:
    assert rewritten(source) == wanted


@pytest.mark.parametrize(
    "source",
    [
        "import policies.spec\n",
        "import os, policies\n",
        "from  policies import spec\n",
        'f"policies.{1}"\n',
        "x = 'policies.spec'\n",
        'x = "policies." + name\n',
        'x = "policies.spec:SPEC"\n',
        'x = "policies." "spec"\n',
    ],
)
def test_what_cannot_be_adapted_fails_the_build(source: str) -> None:
    with pytest.raises(ValueError, match="line 1"):
        rewritten(source)


@pytest.mark.parametrize("package", ["cad_env", "policies", "baselines"])
def test_every_data_file_comes_with_its_package(package: str) -> None:
    folder = ROOT / package
    there = {path for path in folder.rglob("*.*") if path.is_file() and path.suffix not in (".py", ".pyc")}
    assert there == {path for pattern in SETUP.DATA for path in folder.glob(pattern)}


def test_all_modules_can_be_adapted() -> None:
    for package in ("policies", "baselines"):
        for path in (ROOT / package).rglob("*.py"):
            assert not re.search(r"^\s*(from|import) (policies|baselines)\b", rewritten(path.read_text()), re.MULTILINE)


@pytest.mark.parametrize(
    ("arguments", "editable"),
    [
        (["editable_wheel", "--dist-info-dir", "meta"], True),
        (["develop"], True),
        (["bdist_wheel", "--dist-dir", "/tmp/an-editable-folder/.tmp-1"], False),
        (["bdist_wheel", "--dist-dir", "/tmp/develop"], False),
        (["sdist"], False),
    ],
)
def test_only_an_editable_install_leaves_packages_where_they_are(arguments: list[str], editable: bool) -> None:
    assert SETUP.is_editable(["setup.py", *arguments]) is editable
