"""report.html: the results of a scoring run in one self-contained file."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from baselines.evaluation.noted_conditions import noted_conditions
from baselines.evaluation.report.figures import knowledge_of
from baselines.evaluation.report.page import html_page
from baselines.evaluation.report.plots import all_plots
from baselines.evaluation.store import EPISODES, gif_of, read_records, read_settings
from baselines.methods import KNOWS_NOTHING
from cad_env.files import MOST_DATA_BYTES, FileError, read_file, replace_text
from cad_env.scoring.scorecard import Record, scorecards

REPORT = "report.html"
ROOM = 6_000_000  # bytes of animations; a third more in the page
TELLING = ("collision", "success", "timeout")


def write_report(folder: Path) -> Path:
    """Write the report of the finished run in a folder, with the animations in its `gifs`; gives its path.

    It depends on the files of the folder only. FileError if they cannot be read.
    """
    records = read_records(folder)
    if not records:
        raise FileError(folder / EPISODES, "holds no episode")
    rows, settings = scorecards(records), read_settings(folder, ("first_seed", "episodes"))
    knows = knowledge_of(settings)
    shown, left = _animations(folder, records, knows)
    html = html_page(settings, rows, all_plots(rows, records, knows, noted_conditions(settings)), shown, left)
    replace_text(folder / REPORT, html)
    return folder / REPORT


def _animations(folder: Path, records: Sequence[Record], knows: Mapping[str, str]) -> tuple[dict[str, bytes], int]:
    """caption -> GIF of the most telling that fit in, and how many more there are."""
    there = _most_telling_first([record for record in records if gif_of(folder, record).exists()], knows)
    shown: dict[str, bytes] = {}
    room = ROOM
    for record in there:
        data = read_file(gif_of(folder, record), MOST_DATA_BYTES)
        room -= len(data)
        if room < 0:
            break
        scene, kind = record.scenario.replace("_", " "), "a hazard" if record.hazard else "no hazard"
        under = "" if record.condition is None else f" under {record.condition}"
        shown[f"{scene}{under}, {record.method}: {record.outcome}, {kind}, seed {record.seed}"] = data
    return shown, len(there) - len(shown)


def _most_telling_first(records: Sequence[Record], knows: Mapping[str, str]) -> list[Record]:
    """One of each kind before a second; methods that know something first, then hazards, then collisions."""
    seen: Counter[tuple[str | None, str, str, str, bool]] = Counter()
    ranks = []
    for place, record in enumerate(records):
        kind = record.condition, record.scenario, record.method, record.outcome, record.hazard
        blind = knows.get(record.method, KNOWS_NOTHING) == KNOWS_NOTHING
        ranks.append((seen[kind], blind, not record.hazard, TELLING.index(record.outcome), record.method, place))
        seen[kind] += 1
    return [records[place] for *_, place in sorted(ranks)]
