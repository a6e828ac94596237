"""evaluate.py: methods in closed loop on the same seeds, their table and report; shards put together."""

import sys
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from baselines.cli import parsed, refused, say, stopped
from baselines.evaluation.settings import Settings, comparable
from baselines.methods import choices
from baselines.signals import sigterm_as_ctrl_c

if TYPE_CHECKING:
    from baselines.evaluation.store import Store
    from cad_env.scoring.scorecard import Scorecard


@sigterm_as_ctrl_c()
def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    words = sys.argv[1:] if argv is None else argv
    try:
        if any(word.split("=")[0] == "--merge" for word in words):
            return _put_together(words)
        settings = comparable(parsed(Settings, words, _choices, more=["--merge"]))
    except (ValueError, OSError) as error:
        return refused(error)
    except KeyboardInterrupt as error:
        return stopped(error)
    return scored(settings)


def _choices() -> str:
    """For `--help`: the names of methods, scenarios and conditions."""
    from cad_env.conditions import CONDITIONS  # here, so that only this help waits for it

    return f"{choices()}\nConditions: {', '.join(CONDITIONS)}."


def _put_together(words: Sequence[str]) -> int:
    """Merge shards and print the table. ValueError or OSError, one line, if they cannot be merged."""
    from baselines.evaluation.store import Merging, merged  # here, so that --help is quick

    merging = parsed(Merging, words)
    _show(merged(merging), merging.out)
    if merging.report:
        _report(merging.out)
    return 0


def scored(settings: Settings) -> int:
    """Score, print the table, and return the exit code; errors and interruptions are printed in one line."""
    store = None
    try:
        if len(settings.models) > 1:
            return scored_by_seed(settings)
        from baselines.evaluation.run import completed, opened_store  # here, so that --help is quick

        store = opened_store(settings)
        rows = completed(settings, store)
        if settings.shard is None:
            _show(rows, settings.folder())
            _explain(store, settings)
        else:
            say(f"Shard {settings.shard} is in {settings.folder()}. Merge all shards with python evaluate.py --merge")
    except (ValueError, OSError) as error:
        return refused(error)
    except (KeyboardInterrupt, BrokenExecutor) as error:
        total = sum(len(task.seeds) for task in settings.tasks())
        return stopped(error, f" after {len(store.records)} of {total} episodes" if store else "")
    return 0


def scored_by_seed(settings: Settings) -> int:
    """The same for models of several training seeds: a run for each, then one table of all."""
    from baselines.evaluation.run import score
    from baselines.evaluation.training_seeds import runs_of, spread_table, spreads

    runs = runs_of(settings)
    for run in runs.values():
        if code := scored(run):
            return code
    if settings.shard is None:
        say(spread_table(spreads([score(run) for run in runs.values()])))
        _say_what_was_met(next(iter(runs.values())).folder())
        say(f"Each training seed has its own folder in {settings.out}.")
    return 0


def _show(rows: "Sequence[Scorecard]", folder: Path) -> None:
    """Print the table, and what its numbers rely on; write the matrix of several conditions."""
    from baselines.evaluation.matrix_text import MATRIX, matrix_text
    from cad_env.files import replace_text
    from cad_env.scoring.table import table

    say(table(rows))
    _say_what_was_met(folder)
    say(f"The episodes and the scores are in {folder}.")
    if len({row.condition for row in rows}) > 1:
        replace_text(folder / MATRIX, matrix_text(rows))
        say(f"Conditions side by side: {folder / MATRIX}.")


def _say_what_was_met(folder: Path) -> None:
    """Who is connected: no number stands without."""
    from baselines.evaluation.noted_conditions import met_in_words
    from baselines.evaluation.store import read_settings

    say("\n".join(met_in_words(read_settings(folder))))


def _explain(store: "Store", settings: Settings) -> None:
    """Write animations of episodes and the report, as far as they are asked for."""
    if settings.gif:
        from baselines.evaluation.gifs import write_gifs  # here, because only this draws
        from baselines.evaluation.store import GIFS

        write_gifs(settings, store.records.values(), settings.folder() / GIFS, settings.gif)
    if settings.report:
        _report(settings.folder())


def _report(folder: Path) -> None:
    """Write the report."""
    from baselines.evaluation.report import write_report  # here, because only this needs matplotlib

    say(f"The tables and plots are in {write_report(folder)}.")
