"""The pictures of the docs, drawn by the project itself.

python -m docs.draw_pictures --out docs/img
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import count, islice
from pathlib import Path

import numpy as np
import PIL.Image

from cad_env.animation import filmed, side_by_side, write_gif
from cad_env.envs.single import CADEnv
from cad_env.rendering.canvas import BLACK, WHITE, Canvas, Tag
from cad_env.rendering.danger import danger, only_told
from cad_env.rendering.framing import screen
from cad_env.rendering.layers import EGO_SEES, OTHERS_SEE, SEEN_COLOURS, Layer, who_sees
from cad_env.rendering.viewer import picture
from cad_env.rules.planner import Planner
from cad_env.scenarios import SHIPPED, scenario_named
from cad_env.scoring.rollout import rollout
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, COLLISION, SUCCESS, Image
from cad_env.world.state import OFF

FIRST_SEED = 1_000_000  # as in evaluation: training never sees these
SEEDS = 200  # that are searched for an episode worth showing
CLEAR = 8  # decisions to brake on a word, from which on anyone sees that it is one
FILM = 0.6  # of the size of a picture
SHADES = 128  # colours of a drawing


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="docs.draw_pictures", description="Draw the pictures of the docs.")
    parser.add_argument("--out", type=Path, default=Path("docs/img"), help="folder to write to (default: docs/img)")
    out: Path = parser.parse_args(argv).out
    try:
        for path in written(out):
            print(f"{path}  {path.stat().st_size / 1000:.0f} kB")
    except (OSError, ValueError) as error:
        print("error:", " ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


def written(folder: Path) -> Iterator[Path]:
    """Write every picture of the gallery, and yield where each is."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in SHIPPED:
        yield write_drawing(name, folder)
    yield write_comparison("left_turn", folder)


def write_drawing(scenario: str, folder: Path) -> Path:
    """`<scenario>.png`: a hazard that the ego cannot see and that another has told it of, at its closest."""
    for seed in _seeds():
        moment = telling_moment(scenario, seed)
        if moment is not None:
            break
    else:
        raise ValueError(f"{scenario}: the ego is never told of a hazard that it cannot see in {SEEDS} episodes")
    path = folder / f"{scenario}.png"
    PIL.Image.fromarray(moment).quantize(SHADES, dither=PIL.Image.Dither.NONE).save(path, optimize=True)
    return path


def telling_moment(scenario: str, seed: int) -> Image | None:
    """The moment of an episode that `tells` and has the ego brake; of several, that with the hazard closest to it."""
    env = CADEnv(scenario=scenario)
    found: list[tuple[float, Image]] = []

    def watch(env: CADEnv, *_: object) -> None:
        world, row = env.simulation.world, env.simulation.scene.hazard_row
        if tells(env.simulation) and world.command[0, -1] == BRAKE:
            away = float(np.hypot(*(world.position[row] - world.position[0])))
            if not found or away < found[0][0]:
                found[:] = [(away, picture(env, (cast, danger)))]

    rollout(env, Planner(), seed, hazard=True, watch=watch)
    env.close()
    return found[0][1] if found else None


def tells(simulation: Simulation) -> bool:
    """True if the ego is blind to the hazard, another sees it, and the ego knows it only from there."""
    row = simulation.scene.hazard_row
    seen = simulation.fleet.visible[:, row]
    return bool(row >= 0 and not seen[0] and seen[1:].any()) and only_told(simulation, row)


def cast(simulation: Simulation, canvas: Canvas) -> None:
    """Say who plays what: who hides the hazard, and which connected vehicle sees it."""
    scene, position = simulation.scene, simulation.world.position
    row = scene.hazard_row
    if row < 0 or simulation.world.driver[row] == OFF:
        return
    parts = [(scene.occluder_row, Tag("hides it"))]
    witnesses = [int(r) for r, sees in zip(simulation.agents, simulation.fleet.visible[:, row], strict=True) if sees]
    if witnesses and who_sees(simulation)[row] != EGO_SEES:
        nearest = min(witnesses, key=lambda r: float(np.hypot(*(position[r] - position[row]))))
        parts.append((nearest, Tag("sees it, and tells", SEEN_COLOURS[OTHERS_SEE], BLACK)))
    for who, tag in parts:
        canvas.label_beside(position[who], tag)


def write_comparison(scenario: str, folder: Path) -> Path:
    """`alone_or_sharing.gif`: one seed twice, by the same rules: what the ego sees itself, and what it is told too."""
    size = screen(scenario_named(scenario).map, FILM)
    alone, sharing = (CADEnv(config={**size, "scenario": scenario, "radio": radio}) for radio in ("none", "dsrc"))
    for seed in _seeds():
        if rollout(alone, Planner(), seed, hazard=True).outcome == COLLISION and saved_by_word(sharing, seed):
            break
    else:
        raise ValueError(f"{scenario}: sharing changes nothing in {SEEDS} episodes")
    films = [
        filmed(env, Planner(), seed, hazard=True, extra=(danger, titled(words)))[1]
        for env, words in ((alone, "ALONE"), (sharing, "SHARING"))
    ]
    return write_gif(side_by_side(*films), folder / "alone_or_sharing.gif")


def saved_by_word(env: CADEnv, seed: int) -> bool:
    """True if the ego arrives, having braked for a while for what it was only told of."""
    moments = 0

    def watch(env: CADEnv, _: object, action: int) -> None:
        nonlocal moments
        moments += action == BRAKE and tells(env.simulation)

    return rollout(env, Planner(), seed, hazard=True, watch=watch).outcome == SUCCESS and moments >= CLEAR


def titled(words: str) -> Layer:
    """A layer with some words in the upper right corner."""

    def title(simulation: Simulation, canvas: Canvas) -> None:
        canvas.note(canvas.size[0] - 10, 20, Tag(words, WHITE, BLACK, 18), share=1.0)

    return title


def _seeds() -> Iterator[int]:
    return islice(count(FIRST_SEED), SEEDS)


if __name__ == "__main__":
    sys.exit(main())
