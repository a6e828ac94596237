"""What results are marked with: a digest of the code that moves an episode, and of nothing else."""

import ast
import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent
# All that decides how an episode goes and what is labelled in it. Pictures, tables and the API around it are not.
EPISODE_CODE = (
    "checks.py", "config.py", "types.py", "numerics", "world", "scenarios", "pipeline", "lidar", "simulation", "rules",
    "scoring/rollout.py", "scoring/fleet.py", "envs/goals.py",
)  # fmt: skip


@cache
def version() -> str:
    """Twelve letters that change when the code that moves an episode does: results are marked with it."""
    return code_digest(PACKAGE / part for part in EPISODE_CODE)


def code_digest(places: Iterable[Path]) -> str:
    """Twelve letters that change with the code of files and folders, but not with its words.

    Comments, layout, docstrings and the annotations of functions are words; which fields a record has is not.
    """
    digest = hashlib.sha256()
    for place in places:
        for source in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            tree = _without_words(ast.parse(source.read_text(encoding="utf-8")))
            digest.update(f"{source.relative_to(place.parent).as_posix()}\n{ast.dump(tree)}\n".encode())
    return digest.hexdigest()[:12]


def _without_words(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            node.annotation = None
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.returns = None
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                node.body = node.body[1:]
    return tree
