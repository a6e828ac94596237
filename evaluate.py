"""Score contenders in closed loop, on the same seeds, and print the table with its intervals.

python evaluate.py --scenario left_turn --contender always-go expert stgraph --episodes 500 --jobs 2
python evaluate.py --policy runs/all/seed_0 runs/all/seed_1 --contender expert stgraph     a run for each training seed
python evaluate.py --merge results/shard_1_of_2 results/shard_2_of_2
"""

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import tyro

from baselines.evaluation.settings import Settings

if TYPE_CHECKING:
    from baselines.evaluation.store import Store
    from cad_env.scoring.scorecard import Scorecard

INTERRUPTED = 130  # the exit code that shells give to a command ended by Ctrl-C
Parsed = TypeVar("Parsed")


def parsed(kind: type[Parsed], argv: Sequence[str] | None) -> Parsed:
    """A record from the command line; ValueError, one line, for what it does not take. `--help` exits."""
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            return tyro.cli(kind, args=argv)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise ValueError(_first_part(box.getvalue(), kind.__name__)) from None


def _first_part(box: str, kind: str) -> str:
    """tyro's message without the frame around it, the title above and the advice below, each behind a rule."""
    lines = [line.strip("│ ") for line in box.splitlines()[1:]]
    parts = [list(part) for said, part in groupby(lines, lambda line: bool(re.search(r"\w", line))) if said]
    return " ".join(parts[0]).removeprefix(f"Error parsing {kind}: ") if parts else box


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    words = sys.argv[1:] if argv is None else argv
    try:
        if any(word.split("=")[0] == "--merge" for word in words):
            return put_together(words)
        settings = parsed(Settings, words)
    except (ValueError, OSError) as error:
        return refused(error)
    except KeyboardInterrupt as error:
        return stopped(error)
    return scored(settings)


def put_together(words: Sequence[str]) -> int:
    """Merge shards and print the table; ValueError or OSError, one line, for what cannot be merged."""
    from baselines.evaluation.merging import Merging, merged  # here, so that --help is quick

    merging = parsed(Merging, words)
    show(merged(merging), merging.out)
    if merging.report:
        report(merging.out)
    return 0


def scored(settings: Settings) -> int:
    """Score, print the table, and return the exit code; whatever stops it becomes one line on standard error."""
    if len(settings.policy) > 1:
        return scored_by_seed(settings)
    try:
        from baselines.evaluation.run import completed, opened  # here, so that --help is quick

        store = opened(settings)
    except (ValueError, OSError) as error:
        return refused(error)
    except KeyboardInterrupt as error:
        return stopped(error)
    try:
        rows = completed(settings, store)
        if settings.shard is None:
            show(rows, settings.folder())
            explain(store, settings)
        else:
            print(f"Shard {settings.shard} is in {settings.folder()}. Put all together with python evaluate.py --merge")
    except (ValueError, OSError) as error:
        return refused(error)
    except (KeyboardInterrupt, BrokenExecutor) as error:
        total = sum(len(task.seeds) for task in settings.tasks())
        return stopped(error, f" after {len(store.records)} of {total} episodes")
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
        print(spread_table(spreads([score(run) for run in runs.values()])))
        print(f"Each training seed has a folder of its own in {settings.out}.")
    return 0


def show(rows: "Sequence[Scorecard]", folder: Path) -> None:
    """Print the table."""
    from cad_env.scoring.scorecard import table

    print(table(rows))
    print(f"The episodes and the scores are in {folder}.")


def explain(store: "Store", settings: Settings) -> None:
    """Write what helps to understand the scores: animations of episodes, and the report."""
    if settings.gif:
        from baselines.evaluation.gifs import write_gifs  # here, because only this draws
        from baselines.evaluation.store import GIFS

        write_gifs(settings, store.records.values(), settings.folder() / GIFS, settings.gif)
    if settings.report:
        report(settings.folder())


def report(folder: Path) -> None:
    """Write the report."""
    from baselines.evaluation.report import write_report  # here, because only this needs matplotlib

    print(f"The tables and plots to read: {write_report(folder)}")


def stopped(error: BaseException, where: str = "") -> int:
    """Say in one line how to go on with a command that was interrupted or lost a process; its exit code."""
    interrupted = isinstance(error, KeyboardInterrupt)
    how = "stopped" if interrupted else "error: a worker process died"
    print(f"{how}{where}; the same command goes on from there", file=sys.stderr)
    return INTERRUPTED if interrupted else 1


def refused(error: Exception) -> int:
    """Say in one line why a command is not carried out; its exit code."""
    reason = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        reason = f"{error.filename}: {error.strerror}"
    print("error:", " ".join(reason.split()), file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
