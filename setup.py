"""Where packages go. All else about the distribution is in pyproject.toml.

`policies` and `baselines` are top-level packages of the repository. Names as common as these would shadow other
people's modules in site-packages, so a wheel holds them as `cad_learning.policies` and `cad_learning.baselines`, with
their imports rewritten. An editable install leaves them as they are.
"""

import ast
import re
import sys
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

HOME = "cad_learning"
MOVED = ("policies", "baselines")
DATA = ["py.typed", "weights/**/*.safetensors", "weights/**/*.json", "controls/*.json"]
EDITABLE = {"editable_wheel", "develop"}  # the commands of setuptools that leave packages where they are
_MODULE = re.compile(rf"({'|'.join(MOVED)})(\.[A-Za-z_]\w*)+")
_PART = re.compile(rf"({'|'.join(MOVED)})\.\S*")


def rewritten(source: str, name: str = "") -> str:
    """A module's source with its imports of the moved packages, and whole strings that name their modules, adapted.

    ValueError for a form that cannot be adapted.
    """
    lines = [line.encode() for line in source.splitlines(keepends=True)]
    edits = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and _is_moved(node.module or ""):
            edits.append((node.lineno, node.col_offset, f"from {node.module}", f"from {HOME}.{node.module}"))
        elif isinstance(node, ast.Import) and any(_is_moved(alias.name) for alias in node.names):
            (alias, *others) = node.names
            if others or ("." in alias.name and alias.asname is None):
                raise ValueError(f"{name} line {node.lineno}: import one moved module at a time, and bind a name")
            old = f"import {alias.name}"
            new = f"from {HOME} import {alias.name}" if "." not in alias.name else f"import {HOME}.{alias.name}"
            edits.append((node.lineno, node.col_offset, old, new))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and _MODULE.fullmatch(node.value):
            edits.append((node.lineno, node.col_offset, f'"{node.value}"', f'"{HOME}.{node.value}"'))
        elif _is_part_of_a_name(node):
            raise ValueError(f"{name} line {node.lineno}: the name of a moved module must be a whole string")
    for number, column, old, new in sorted(edits, reverse=True):
        line = lines[number - 1]
        if line[column : column + len(old)] != old.encode():
            raise ValueError(f"{name} line {number}: expected {old!r}")
        lines[number - 1] = line[:column] + new.encode() + line[column + len(old) :]
    return b"".join(lines).decode()


def _is_moved(module: str) -> bool:
    return module.partition(".")[0] in MOVED


def _is_part_of_a_name(node: ast.AST) -> bool:
    """Whether a string starts like a module's name but is put together, or holds more than the name."""
    if isinstance(node, ast.JoinedStr):
        first = node.values[0] if node.values else None
        return isinstance(first, ast.Constant) and _PART.match(str(first.value)) is not None
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and _PART.fullmatch(node.value) is not None


def is_editable(arguments: list[str]) -> bool:
    """Whether the arguments of a build ask for an editable install; a folder of any name among them does not."""
    return not EDITABLE.isdisjoint(arguments)


class BuildPy(build_py):
    """Adapts the moved packages on their way into a wheel."""

    def build_module(self, module, module_file, package):
        """Copy a module, and adapt the copy if its package moves."""
        target, copied = super().build_module(module, module_file, package)
        if package.startswith(HOME) and not self.editable_mode:
            path = Path(target)
            path.write_text(rewritten(Path(module_file).read_text(encoding="utf-8"), module_file), encoding="utf-8")
        return target, copied


def main() -> None:
    """Called by every build."""
    ours = find_packages(include=["cad_env", "cad_env.*"])
    moved = find_packages(include=[pattern for name in MOVED for pattern in (name, f"{name}.*")])
    if is_editable(sys.argv):
        setup(packages=[*ours, *moved], package_data=dict.fromkeys(("cad_env", *MOVED), DATA))
        return
    setup(
        packages=[*ours, *(f"{HOME}.{name}" for name in moved)],
        package_dir={f"{HOME}.{name}": name for name in MOVED},
        package_data=dict.fromkeys(("cad_env", *(f"{HOME}.{name}" for name in MOVED)), DATA),
        cmdclass={"build_py": BuildPy},
    )


if __name__ == "__main__":
    main()
