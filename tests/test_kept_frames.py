"""Frames on the disk are those that a replay gives, and whatever else is there is made anew."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.families import family_named
from baselines.families.clouds import CloudFrames
from policies import kept_frames
from policies.cloning import Recipe
from policies.kept_frames import kept
from policies.recording import Recording
from policies.training import Course, train

RECORDED = Recording(*(np.array(values) for values in ([7], [2], [1], [0, 1], [0, 1])))
FRAMES = CloudFrames(
    2, 3, np.array([7, 7]), np.array([0, 1], np.int8), np.zeros((2, 6), np.int8), np.ones((2, 4), np.float32),
    np.array([0, 1, 3]), np.ones((3, 3), np.float32), np.array([0, 2, 2, 3]),
    np.arange(9, dtype=np.int16).reshape(3, 3),
)  # fmt: skip
POINTS = family_named("compressed")


def made(folder: Path, recorded: Recording = RECORDED, **made_with: object) -> bool:
    """Whether frames had to be made; they are as they should be."""
    calls: list[CloudFrames] = []

    def make() -> CloudFrames:
        calls.append(FRAMES)
        return FRAMES

    found = kept(folder, made_with, POINTS, recorded, make)
    for name, value in vars(FRAMES).items():
        other = getattr(found, name)
        assert type(other) is type(value)
        np.testing.assert_array_equal(other, value)
        assert not isinstance(value, np.ndarray) or other.dtype == value.dtype
    return bool(calls)


def test_what_was_kept_comes_back_and_anything_else_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert made(tmp_path, radio="ideal")
    assert not made(tmp_path, radio="ideal")
    assert made(tmp_path, radio="dsrc")
    assert made(tmp_path, replace(RECORDED, action=np.array([1, 1])), radio="ideal")
    assert not made(tmp_path, radio="ideal")
    monkeypatch.setattr(kept_frames, "_code_of", lambda module: "edited")
    assert made(tmp_path, radio="ideal")


@pytest.mark.parametrize("damage", [b"", b"PK", None])
def test_a_damaged_file_is_made_anew(damage: bytes | None, tmp_path: Path) -> None:
    assert made(tmp_path)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
    assert made(tmp_path)
    assert path.read_bytes() == whole
    assert not made(tmp_path)


def test_a_folder_that_cannot_be_written_costs_only_time(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert made(tmp_path / "file")
    assert made(tmp_path / "file")


@pytest.mark.parametrize("name", ["compressed", "point_transformer"])
def test_a_second_run_replays_nothing_of_the_expert_and_ends_in_the_same_model(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = Course(
        scenarios=("left_turn",), radio="ideal", episodes=6, corrections=0, steps=3, validation=1, final_validation=1,
        segments=1, thresholds=(0.5,), recipe=Recipe(batch=6), family=name,
        network=family_named(name).config_type(mlp_width=8),
    )  # fmt: skip
    for folder in ("first", "second"):
        train(course, tmp_path / folder, lambda work: None, family_named, tmp_path / "recording")
        monkeypatch.setattr("policies.training.replay", None)
    for file in ("model.safetensors", "metrics.csv"):
        assert (tmp_path / "second" / file).read_bytes() == (tmp_path / "first" / file).read_bytes()
