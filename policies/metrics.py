"""metrics.csv: what every checkpoint of a course was worth, a row for each scenario it was validated on."""

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cad_env.files import replace_file
from cad_env.rollout import Episode
from policies.cloning import Worth

Row = Mapping[str, Any]


def summary(episodes: Sequence[Episode]) -> dict[str, Any]:
    """What a driver did in validation episodes of one scenario."""
    outcomes = [episode.outcome for episode in episodes]
    calm = [episode for episode in episodes if not episode.hazard]
    return {
        "episodes": len(episodes), "collisions": outcomes.count("collision"), "timeouts": outcomes.count("timeout"),
        "failures": len(outcomes) - outcomes.count("success"),
        "mean_time": round(sum(episode.time for episode in episodes) / len(episodes), 3),
        "calm": len(calm), "needless_brakes": sum(episode.brakes > 0 for episode in calm),
    }  # fmt: skip


def worth(rows: Iterable[Row]) -> Worth:
    """The worth of a driver by its summaries, one a scenario, all of equally many episodes."""
    found = list(rows)
    failures, needless = (sum(row[name] for row in found) for name in ("failures", "needless_brakes"))
    return Worth(failures, needless, sum(row["mean_time"] for row in found) / len(found))


class Log:
    """The file and its rows. A row torn by a kill is dropped, and its segment validated again."""

    COLUMNS = (
        "round", "segment", "scenario", "loss", "threshold", "episodes", "collisions", "timeouts", "failures",
        "mean_time", "calm", "needless_brakes",
    )  # fmt: skip

    def __init__(self, path: Path) -> None:
        """Open the file, or begin one."""
        self.path = path
        self.rows: list[dict[str, Any]] = list(self._kept())
        self._write()

    def of(self, turn: int, segment: int) -> list[dict[str, Any]]:
        """The rows of a checkpoint."""
        return [row for row in self.rows if (row["round"], row["segment"]) == (turn, segment)]

    def replace(self, turn: int, segment: int, rows: Iterable[Row]) -> None:
        """Put these in the place of whatever there was of a checkpoint."""
        before = self.of(turn, segment)
        self.rows = [row for row in self.rows if row not in before]
        self.rows += [{"round": turn, "segment": segment, **row} for row in rows]
        self._write()

    def best(self, count: int) -> list[tuple[int, int]]:
        """(round, segment) of the checkpoints that are worth most, the best first."""
        checkpoints = dict.fromkeys((row["round"], row["segment"]) for row in self.rows)
        return sorted(checkpoints, key=lambda which: worth(self.of(*which)))[:count]

    def _kept(self) -> Iterator[dict[str, Any]]:
        if not self.path.exists():
            return
        with self.path.open(newline="") as file:
            for row in csv.DictReader(file):
                try:
                    yield {name: row[name] if name == "scenario" else json.loads(row[name]) for name in self.COLUMNS}
                except (KeyError, TypeError, ValueError):
                    continue

    def _write(self) -> None:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, self.COLUMNS)
        writer.writeheader()
        writer.writerows(self.rows)
        replace_file(self.path, text.getvalue().encode())
