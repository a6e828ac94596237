"""Methods trained from several seeds: a run for each, and one table of the means and ranges.

The expert is in every run, because time lost is against it; its row is that of the first.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from baselines.evaluation.settings import Settings
from baselines.methods import method_named
from cad_env.scoring.scorecard import Scorecard
from cad_env.scoring.table import text_table
from cad_env.scoring.time_lost import EXPERT

_RULES = "rules"  # the folder of the methods that are not trained, which are scored once


@dataclass(frozen=True)
class Spread:
    """A method in all episodes of a scenario, over its training seeds. Rates are shares of the episodes of each."""

    condition: str | None
    scenario: str
    method: str
    seeds: int
    episodes: int  # of each seed
    collision: tuple[float, float, float]  # mean, least, most
    success: tuple[float, float, float]
    time_lost: tuple[float, float, float] | None  # s after the expert; None where one of the seeds has none


def runs_of(settings: Settings) -> dict[str, Settings]:
    """The runs to make, by the name of their folder: one of the methods that are not trained, one for each seed.

    If the expert is asked for, it is in each of them.
    """
    learned = tuple(name for name in settings.method if method_named(name).model)
    others = tuple(name for name in settings.method if name not in learned)
    runs = {_RULES: replace(settings, method=others, models=(), out=settings.out / _RULES)} if others else {}
    beside = (EXPERT,) if EXPERT in others else ()
    for folder in settings.models if learned else ():
        runs[folder.name] = replace(
            settings, method=(*learned, *beside), models=(folder,), out=settings.out / folder.name
        )
    return runs


def spreads(runs: Iterable[Sequence[Scorecard]]) -> list[Spread]:
    """The rows of the table, by condition and scenario, in the order of the runs."""
    found: dict[tuple[str | None, str, str], list[Scorecard]] = {}
    for rows in runs:
        for row in rows:
            key = row.condition, row.scenario, row.method
            again = row.method == EXPERT and key in found
            if row.hazard == "all" and not again:
                found.setdefault(key, []).append(row)
    places = list(dict.fromkeys((condition, scenario) for condition, scenario, _ in found))
    return [
        Spread(
            condition=condition,
            scenario=scenario,
            method=method,
            seeds=len(rows),
            episodes=rows[0].episodes,
            collision=_spread([row.collision_rate for row in rows]),
            success=_spread([row.success_rate for row in rows]),
            time_lost=_spread_if_known([row.time_lost for row in rows]),
        )
        for place in places
        for (condition, scenario, method), rows in found.items()
        if (condition, scenario) == place
    ]


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    return sum(values) / len(values), min(values), max(values)


def _spread_if_known(values: Sequence[float | None]) -> tuple[float, float, float] | None:
    known = [value for value in values if value is not None]
    return _spread(known) if len(known) == len(values) else None


SPREAD_TITLES = ("scenario", "method", "seeds", "episodes", "collision %", "time lost s", "success %")


def spread_table(rows: Sequence[Spread]) -> str:
    """The rows as text, conditions first if any is named; in brackets the least and the most of the training seeds."""
    cells = [
        (row.scenario, row.method, str(row.seeds), str(row.episodes),
         _cell(row.collision, 100), "-" if row.time_lost is None else _cell(row.time_lost, 1), _cell(row.success, 100))
        for row in rows
    ]  # fmt: skip
    if all(row.condition is None for row in rows):
        return text_table(SPREAD_TITLES, cells, names=2)
    named = [(str(row.condition), *line) for row, line in zip(rows, cells, strict=True)]
    return text_table(("condition", *SPREAD_TITLES), named, names=3)


def _cell(spread: tuple[float, float, float], scale: float) -> str:
    mean, least, most = (scale * value for value in spread)
    return f"{mean:.1f} [{least:.1f}, {most:.1f}]" if most > least else f"{mean:.1f}"
