"""The commands that an installation offers: cad-train, cad-evaluate, cad-reproduce and cad-demo.

They live in the packages `baselines` and `policies`, which a wheel holds inside `cad_learning`, and need the extra
`learning`. The scenes themselves do not.
"""

import sys
from importlib import import_module
from importlib.util import find_spec

_LEARNING = (
    "cad_learning", "baselines", "policies", "matplotlib", "safetensors", "stable_baselines3", "torch", "tqdm", "tyro",
)  # fmt: skip
EXTRAS = {**dict.fromkeys(_LEARNING, "learning"), "ray": "ray"}  # top-level module -> the extra that brings it


def train() -> int:
    """cad-train: train learned methods, and print their closed-loop table."""
    return _run("baselines.training.command")


def evaluate() -> int:
    """cad-evaluate: score methods in closed loop."""
    return _run("baselines.evaluation.command")


def reproduce() -> int:
    """cad-reproduce: every table and plot of the paper's comparison."""
    return _run("baselines.paper.command")


def demo() -> int:
    """cad-demo: what the models that ship do, in half a minute."""
    return _run("baselines.demo")


def _run(module: str) -> int:
    """Call the `main` of a module, wherever its package is installed; 2 if what an extra brings is missing."""
    installed = find_spec("cad_learning") is not None
    try:
        code: int = import_module(f"cad_learning.{module}" if installed else module).main()
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:  # not ours to explain: a module of the user's own, for example
            raise
        print(f"error: this command needs an extra: pip install 'cad-env[{extra}]' ({error})", file=sys.stderr)
        return 2
    return code
