"""The one rule for what users give: what counts as a number, a seed, a switch, a path; and the nearest name."""

from typing import Any

import numpy as np
import pytest

import cad_env.config
from cad_env.checks import (
    ConfigError,
    check_mapping,
    check_numbers,
    check_path,
    check_range,
    check_seed,
    check_switch,
    check_text,
    check_whole,
    did_you_mean,
)
from cad_env.simulation.setup import Setup
from cad_env.types import FRAMES


def test_what_is_refused_is_one_kind_of_error_wherever_it_is_imported_from():
    assert cad_env.config.ConfigError is ConfigError
    assert cad_env.config.check_range is check_range
    assert issubclass(ConfigError, ValueError)


@pytest.mark.parametrize(
    ("check", "value", "said"),
    [
        (lambda value: check_range("x", value, 0.0, 1.0), 2, "x must be a number from 0 to 1, got 2"),
        (lambda value: check_whole("x", value, 0, 9), 3.0, "x must be a whole number from 0 to 9, got 3.0"),
        (lambda value: check_seed("x", value), -1, "x must be a whole number from 0 on, got -1"),
        (lambda value: check_switch("x", value), 1, "x must be True or False, got 1"),
        (lambda value: check_text("x", value), "", "x must be a text, got ''"),
        (lambda value: check_mapping("x", value, "things"), 3, "x must be a dict of things, got 3"),
    ],
)
def test_what_does_not_pass_is_refused_with_name_value_and_what_is_allowed(check: Any, value: Any, said: str):
    with pytest.raises(ConfigError) as refusal:
        check(value)
    assert str(refusal.value) == said


def test_whole_numbers_are_numbers():
    assert check_range("x", 1, 0.0, 2.0) == check_range("x", np.float64(1.0), 0.0, 2.0) == 1.0


@pytest.mark.parametrize(
    ("given", "nearest"),
    [("cv2v", "cv2x"), ("CV2X", "cv2x"), ("dsrk", "dsrc"), ("5g", None), ("", None), (7, None), (None, None),
     ("cv2x" * 10**6, None)],
)  # fmt: skip
def test_the_nearest_name_is_offered(given: object, nearest: str | None):
    assert did_you_mean(given, ["dsrc", "cv2x"]) == ("" if nearest is None else f"; did you mean {nearest}?")


def test_the_rules_return_python_s_own():
    for value in (check_range("x", np.float32(0.5), 0, 1), check_range("x", True + 0, 0, 1)):
        assert type(value) is float
    assert [type(check_whole("x", kind(3), 0, 9)) for kind in (int, np.int8, np.uint64)] == [int] * 3
    assert check_switch("x", np.bool_(True)) is True
    assert check_seed("x", np.uint64(2**63)) == 2**63
    assert check_mapping("x", {"a": 1}, "things") == {"a": 1}


@pytest.mark.parametrize("value", ["", b"x", b"", None, 3, True, ["x"]])
def test_what_is_no_path_is_refused(value: Any):
    with pytest.raises(ValueError) as refusal:  # noqa: PT011  the text is compared below
        check_path("out", value)
    assert str(refusal.value) == f"out must be a path, got {value!r}"


def test_a_frozen_record_keeps_what_was_checked():
    setup = Setup(depth=np.int64(FRAMES), penetration=None)
    check_numbers(setup, "", {"depth": (1, FRAMES), "penetration": (0.0, 1.0)})
    assert (type(setup.depth), setup.penetration) == (int, None)
    with pytest.raises(ValueError, match="x depth must be a whole number from 1 to 3, got 15"):
        check_numbers(setup, "x", {"depth": (1, 3)})
