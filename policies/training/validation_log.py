"""What the checkpoints of a training run were worth: a table with a row for each cell that one was driven in."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cad_env.checks import ConfigError
from cad_env.files import FileError, parse_json, read_rows, replace_text, shortened
from cad_env.scoring.rollout import Episode
from policies.training.cloning import Worth

_MOST = 10**9  # of anything counted, and seconds
_MEASURED = {"loss": _MOST, "threshold": 1, "mean_time": _MOST}  # and the most; the other columns count
_NO_NUMBER = ("nan", "inf", "-inf")


def summary(episodes: Sequence[Episode]) -> dict[str, Any]:
    """What a policy did in validation episodes of one scenario."""
    outcomes = [episode.outcome for episode in episodes]
    calm = [episode for episode in episodes if not episode.hazard]
    return {
        "episodes": len(episodes), "collisions": outcomes.count("collision"), "timeouts": outcomes.count("timeout"),
        "failures": len(outcomes) - outcomes.count("success"),
        "mean_time": round(sum(episode.time for episode in episodes) / len(episodes), 3),
        "calm": len(calm), "needless_brakes": sum(episode.brakes > 0 for episode in calm),
    }  # fmt: skip


def worth(rows: Iterable[Mapping[str, Any]]) -> Worth:
    """The worth of a policy by its summaries, one for every scenario and condition, all of about as many episodes."""
    found = list(rows)
    failures, needless = (sum(row[name] for row in found) for name in ("failures", "needless_brakes"))
    several = len({row["condition"] for row in found}) > 1
    worst = max(row["collisions"] for row in found) if several else 0
    return Worth(failures, needless, sum(row["mean_time"] for row in found) / len(found), worst)


class Log:
    """The file and its rows, each on the disk when it is known. A last row that was torn is made again."""

    COLUMNS = (
        "round", "segment", "scenario", "condition", "loss", "threshold", "episodes", "collisions", "timeouts",
        "failures", "mean_time", "calm", "needless_brakes",
    )  # fmt: skip
    OF_ALL = ("round", "segment", "loss", "threshold")  # the same in every cell

    def __init__(self, path: Path) -> None:
        """Open the file, or begin one. FileError, with line and column, if it is damaged."""
        self.path = path
        self.rows: list[dict[str, Any]] = list(self._kept())
        self._write()

    def of(self, turn: int, segment: int, threshold: float) -> list[dict[str, Any]]:
        """The rows of a checkpoint, driven with a threshold."""
        wanted = turn, segment, threshold
        return [row for row in self.rows if (row["round"], row["segment"], row["threshold"]) == wanted]

    def add(self, row: Mapping[str, Any]) -> None:
        """Keep a row."""
        self.rows.append(dict(row))
        self._write()

    def forget(self, turn: int, segment: int) -> None:
        """Drop whatever there is of a checkpoint."""
        self.rows = [row for row in self.rows if (row["round"], row["segment"]) != (turn, segment)]
        self._write()

    def ranked(self) -> list[tuple[int, int, float]]:
        """(round, segment, threshold) of all that has rows, those that are worth most first."""
        found = dict.fromkeys((row["round"], row["segment"], row["threshold"]) for row in self.rows)
        return sorted(found, key=lambda which: worth(self.of(*which)))

    def note(self, turn: int, segment: int, threshold: float) -> dict[str, Any]:
        """The rows of a checkpoint, driven with a threshold, as a model keeps them."""
        rows = self.of(turn, segment, threshold)
        found = [{name: row[name] for name in self.COLUMNS if name not in self.OF_ALL} for row in rows]
        return {"round": turn, "segment": segment, "threshold": threshold, "validation": found}

    def _kept(self) -> Iterator[dict[str, Any]]:
        if not self.path.exists():
            return
        for line, row in read_rows(self.path, self.COLUMNS):
            try:
                yield {name: _value(name, text) for name, text in row.items()}
            except ConfigError as error:
                raise FileError(self.path, f"line {line}: {error}; delete the line to have it made again") from None

    def _write(self) -> None:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, self.COLUMNS)
        writer.writeheader()
        writer.writerows(self.rows)
        replace_text(self.path, text.getvalue())


def _value(column: str, text: str) -> str | int | float:
    """What is in a column of a row; ConfigError for what it cannot hold."""
    if column in ("scenario", "condition"):
        return text
    if column == "loss" and text in _NO_NUMBER:  # of a training that came to nothing
        return float(text)
    try:
        value = parse_json(text)
    except ConfigError:
        value = None
    kinds, most = ((int, float), _MEASURED[column]) if column in _MEASURED else ((int,), _MOST)
    if type(value) in kinds and 0 <= value <= most:
        found: int | float = value
        return found
    what = "a number" if column in _MEASURED else "a whole number"
    raise ConfigError(f"{column} must be {what} from 0 to {most:g}, got {shortened(text)!r}")
