"""One name, one meaning: a public name is defined in one module, but for those that are argued for here."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("cad_env", "policies", "baselines")
SAME_ROLE = {
    "main": "the entry point of each command",
    "SPEC": "the network spec that each module of one defines",
    "FORMAT": "the number of each file format",
    "VERSION": "the version of each message format",
    "actors": "what each scenario draws",
    "background": "what each scenario draws",
    "parallel_env": "`cad_env.parallel_env` calls the one of its module, so that `import cad_env` stays fast",
}


def definitions(path: Path) -> set[str]:
    """The public names that a module defines at its top level."""
    found: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        for target in targets:
            found |= {name.id for name in ast.walk(target) if isinstance(name, ast.Name)}
    return {name for name in found if not name.startswith("_")}


def defined_twice() -> dict[str, list[str]]:
    """Public names with the modules that define them, where there are several."""
    where: dict[str, list[str]] = defaultdict(list)
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for name in definitions(path):
                where[name].append(str(path.relative_to(ROOT)))
    return {name: modules for name, modules in where.items() if len(modules) > 1}


def test_a_public_name_means_one_thing() -> None:
    assert {name: at for name, at in defined_twice().items() if name not in SAME_ROLE} == {}


def test_every_exception_is_needed() -> None:
    assert set(SAME_ROLE) <= set(defined_twice())
