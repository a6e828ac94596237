"""What every test needs: no window, and hypothesis set so that the same commit gives the same verdict."""

import os
import signal

from hypothesis import HealthCheck, settings

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
