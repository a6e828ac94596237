"""Films of episodes: as long as the episode, readable, and small; two side by side."""

import io
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from scenes import Steady

from cad_env.animation import GAP, HOLD, filmed, side_by_side, write_gif
from cad_env.envs.single import CADEnv
from cad_env.rendering.danger import danger
from cad_env.scoring.rollout import rollout
from cad_env.types import GO

SMALL = {"screen_width": 240, "screen_height": 240, "scaling": 2.0}


def cards(*greys: int, width: int = 40) -> list[np.ndarray]:
    """Frames of one grey each."""
    return [np.full((30, width, 3), grey, np.uint8) for grey in greys]


def durations(path: Path) -> list[int]:
    """The ms for which each frame of a GIF stays."""
    with PIL.Image.open(path) as film:
        times = []
        for k in range(film.n_frames):
            film.seek(k)
            times.append(film.info["duration"])
        return times


def test_a_film_has_a_frame_for_the_start_and_one_for_every_decision(tmp_path: Path):
    env = CADEnv(config=SMALL)
    episode, frames = filmed(env, Steady(GO), 1_000_023, "always-go", hazard=True, extra=(danger,))
    assert len(frames) == len(episode.action) + 1
    assert frames[0].shape == (240, 240, 3)
    assert (frames[0] != frames[-1]).any()
    unseen = rollout(CADEnv(), Steady(GO), 1_000_023, "always-go", hazard=True)
    assert (episode.outcome, episode.time) == (unseen.outcome, unseen.time)
    path = write_gif(frames, tmp_path / "new" / "film.gif")
    assert len(durations(path)) == len(frames)
    assert path.stat().st_size < 500_000
    env.close()


def test_a_gif_plays_ten_frames_a_second_and_holds_the_last(tmp_path: Path):
    path = write_gif(cards(0, 80, 160, 240), tmp_path / "film.gif")
    assert durations(path) == [100, 100, 100, 100 + 1000 * HOLD]
    with PIL.Image.open(path) as film:
        assert film.size == (40, 30)
        assert film.info["loop"] == 0
        film.seek(2)
        assert np.abs(np.asarray(film.convert("L")).astype(int) - 160).max() < 8


def test_a_film_of_nothing_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="without frames"):
        write_gif([], tmp_path / "film.gif")
    assert not (tmp_path / "film.gif").exists()


def test_the_shorter_of_two_films_waits_at_its_end():
    both = side_by_side(cards(10, 20), cards(30, 40, 50, width=20))
    assert [frame.shape for frame in both] == [(30, 40 + GAP + 20, 3)] * 3
    assert [int(frame[0, 0, 0]) for frame in both] == [10, 20, 20]
    assert [int(frame[0, -1, 0]) for frame in both] == [30, 40, 50]


def test_films_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="got 0 and 1"):
        side_by_side([], cards(1))
    with pytest.raises(ValueError, match="got 30 and 31 pixels"):
        side_by_side(cards(1), [np.zeros((31, 5, 3), np.uint8)])


def test_a_film_that_cannot_be_finished_leaves_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    before = write_gif(cards(0, 80), tmp_path / "film.gif").read_bytes()

    def torn(image: PIL.Image.Image, target: Path | io.BytesIO, *_: object, **__: object) -> None:
        with open(target, "wb") if isinstance(target, Path) else target as file:
            file.write(b"GIF89a")
            raise KeyboardInterrupt

    monkeypatch.setattr(PIL.Image.Image, "save", torn)
    with pytest.raises(KeyboardInterrupt):
        write_gif(cards(160, 240), tmp_path / "film.gif")
    assert (tmp_path / "film.gif").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]
