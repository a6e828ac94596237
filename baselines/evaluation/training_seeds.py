"""The same rows trained from several seeds: a run for each, and one table with how far they spread."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from baselines.evaluation.settings import Settings
from baselines.methods import method_named
from cad_env.scoring.scorecard import Scorecard

RULES = "rules"  # the folder of those that are not trained, which are scored once


@dataclass(frozen=True)
class Spread:
    """A method in all episodes of a scenario, over its training seeds. Rates are shares of the episodes of each."""

    scenario: str
    method: str
    seeds: int
    episodes: int  # of each seed
    collision: tuple[float, float, float]  # mean, least, most
    success: tuple[float, float, float]
    time: tuple[float, float, float]  # s until the outcome


def runs_of(settings: Settings) -> dict[str, Settings]:
    """The runs to make, by the name of their folder: of those that are not trained, then of each training seed."""
    learned = tuple(name for name in settings.method if method_named(name).model)
    others = tuple(name for name in settings.method if name not in learned)
    runs = {RULES: replace(settings, method=others, models=(), out=settings.out / RULES)} if others else {}
    for folder in settings.models if learned else ():
        runs[folder.name] = replace(settings, method=learned, models=(folder,), out=settings.out / folder.name)
    return runs


def spreads(runs: Iterable[Sequence[Scorecard]]) -> list[Spread]:
    """The rows of the table, scenario by scenario, in the order of the runs."""
    found: dict[tuple[str, str], list[Scorecard]] = {}
    for rows in runs:
        for row in rows:
            if row.hazard == "all":
                found.setdefault((row.scenario, row.method), []).append(row)
    scenes = list(dict.fromkeys(scenario for scenario, _ in found))
    return [
        Spread(
            scenario, method, len(rows), rows[0].episodes, *(
                _spread([float(getattr(row, name)) for row in rows])
                for name in ("collision_rate", "success_rate", "mean_time")
            )
        )
        for scene in scenes
        for (scenario, method), rows in found.items()
        if scenario == scene
    ]  # fmt: skip


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    return sum(values) / len(values), min(values), max(values)


def spread_table(rows: Sequence[Spread]) -> str:
    """The rows as text; in brackets the least and the most of the training seeds."""
    cells: list[tuple[str, ...]] = [("scenario", "method", "seeds", "episodes", "collision %", "success %", "time s")]
    for row in rows:
        values = [_cell(row.collision, 100), _cell(row.success, 100), _cell(row.time, 1)]
        cells.append((row.scenario, row.method, str(row.seeds), str(row.episodes), *values))
    widths = [max(len(line[k]) for line in cells) for k in range(len(cells[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in cells
    )


def _cell(spread: tuple[float, float, float], scale: float) -> str:
    mean, least, most = (scale * value for value in spread)
    return f"{mean:.1f} [{least:.1f}, {most:.1f}]" if most > least else f"{mean:.1f}"
