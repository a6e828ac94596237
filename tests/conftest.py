"""What every test needs: no window, hypothesis set so that a commit always gives the same verdict; and `refused`."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import evaluate

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

# A shell's background job ignores Ctrl-C, and so would the commands under test, which inherit it.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The first example of a test may compile for seconds, so time says nothing about a single example.
settings.register_profile(
    "repeatable", max_examples=50, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
# pytest --hypothesis-profile=search looks for what 50 fixed examples miss.
settings.register_profile("search", settings.get_profile("repeatable"), max_examples=2000, derandomize=False)
settings.load_profile("repeatable")


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a scoring command that must be refused; gives what was said."""

    def refusal(folder: Path, *arguments: str) -> str:
        capsys.readouterr()
        assert evaluate.main([*arguments, "--no-report", "--out", str(folder)]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        return said.err

    return refusal
