"""Episodes as moving pictures: drive and film one, put two side by side, write a GIF."""

import io
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path

import numpy as np
import PIL.Image

from cad_env.checks import check_path
from cad_env.envs.single import CADEnv
from cad_env.files import replace_file
from cad_env.rendering.layers import Layer
from cad_env.rendering.viewer import picture
from cad_env.scoring.rollout import Episode, rollout
from cad_env.types import STEP, Image, Policy

COLOURS = 256  # in the one palette of a GIF
HOLD = 2.0  # s for which the last frame stays
GAP = 8  # pixels between two pictures side by side


def filmed(
    env: CADEnv, policy: Policy, seed: int, method: str = "", hazard: bool | None = None, extra: Sequence[Layer] = ()
) -> tuple[Episode, list[Image]]:
    """Drive one episode as `rollout` does, and draw it: at the start and after every decision."""
    frames: list[Image] = []
    episode = rollout(env, policy, seed, method, hazard, watch=lambda env, *_: frames.append(picture(env, extra)))
    return episode, [*frames, picture(env, extra)]


def side_by_side(left: Sequence[Image], right: Sequence[Image]) -> list[Image]:
    """Two films at once; the shorter one stays at its last frame. ValueError if one is empty or heights differ."""
    if not left or not right:
        raise ValueError(f"both films need a frame, got {len(left)} and {len(right)}")
    if left[0].shape[0] != right[0].shape[0]:
        raise ValueError(f"both films must be equally high, got {left[0].shape[0]} and {right[0].shape[0]} pixels")
    gap = np.full((left[0].shape[0], GAP, 3), 255, np.uint8)
    pairs = ((left[min(k, len(left) - 1)], right[min(k, len(right) - 1)]) for k in range(max(len(left), len(right))))
    return [np.concatenate([a, gap, b], axis=1) for a, b in pairs]


def write_gif(frames: Iterable[Image], path: str | PathLike[str], hold: float = HOLD) -> Path:
    """Frames 0.1 s apart as a GIF that repeats; all share one palette, so that what stands still costs nothing.

    The file is written whole or not at all. ValueError for a film without frames.
    """
    path = check_path("path", path)
    images = [PIL.Image.fromarray(frame) for frame in frames]
    if not images:
        raise ValueError(f"a film without frames cannot be written to {path}")
    palette = _palette(images)
    reduced = [image.quantize(palette=palette, dither=PIL.Image.Dither.NONE) for image in images]
    step = round(1000 * STEP)
    times = [step] * (len(reduced) - 1) + [step + round(1000 * hold)]
    film = io.BytesIO()
    reduced[0].save(film, "GIF", save_all=True, append_images=reduced[1:], duration=times, loop=0, optimize=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, film.getvalue())
    return path


def _palette(images: list[PIL.Image.Image]) -> PIL.Image.Image:
    """The colours of a dozen frames spread over the film, its last among them."""
    chosen = [images[k] for k in sorted({round(k) for k in np.linspace(0, len(images) - 1, 12)})]
    width, height = chosen[0].size
    strip = PIL.Image.new("RGB", (width, height * len(chosen)))
    for k, image in enumerate(chosen):
        strip.paste(image, (0, k * height))
    return strip.quantize(COLOURS)
