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
DATA = ["py.typed", "weights/**/*.safetensors", "weights/**/*.json"]
_MODULE = re.compile(rf"({'|'.join(MOVED)})(\.[A-Za-z_]\w*)+")


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
        elif isinstance(node, ast.JoinedStr) and _starts_a_module(node):
            raise ValueError(f"{name} line {node.lineno}: the name of a moved module must be a whole string")
    for number, column, old, new in sorted(edits, reverse=True):
        line = lines[number - 1]
        if line[column : column + len(old)] != old.encode():
            raise ValueError(f"{name} line {number}: expected {old!r}")
        lines[number - 1] = line[:column] + new.encode() + line[column + len(old) :]
    return b"".join(lines).decode()


def _is_moved(module: str) -> bool:
    return module.partition(".")[0] in MOVED


def _starts_a_module(text: ast.JoinedStr) -> bool:
    first = text.values[0] if text.values else None
    return isinstance(first, ast.Constant) and re.match(rf"({'|'.join(MOVED)})\.", str(first.value)) is not None


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
    if any("editable" in word or word == "develop" for word in sys.argv):
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
