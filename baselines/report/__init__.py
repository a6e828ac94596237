"""report.html: what a scoring run found, for people, in one file that needs nothing else and no network."""

from pathlib import Path

from baselines.report.page import page
from baselines.report.plots import plots
from baselines.store import read_records, read_settings
from cad_env.files import replace_file
from cad_env.score import scorecards

REPORT, PICTURES = "report.html", "gifs"
ROOM = 6_000_000  # bytes of animations; a third more in the page


def write_report(folder: Path) -> Path:
    """Write the report of the finished run in a folder, with the animations in its `gifs`; gives its path.

    It depends on the files of the folder only. OSError or ValueError if they cannot be read.
    """
    records = read_records(folder)
    rows = scorecards(records)
    path = folder / REPORT
    replace_file(path, page(read_settings(folder), rows, plots(rows, records), *_animations(folder)).encode())
    return path


def _animations(folder: Path) -> tuple[dict[str, bytes], int]:
    """name -> GIF of the first that fit in, and how many do not."""
    paths = sorted((folder / PICTURES).rglob("*.gif"))
    shown: dict[str, bytes] = {}
    for path in paths:
        shown[path.stem] = path.read_bytes()
        if sum(map(len, shown.values())) > ROOM:
            del shown[path.stem]
            break
    return shown, len(paths) - len(shown)
