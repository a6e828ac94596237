"""Which control is `best-blind` in each scenario: measured on training seeds, kept in a file of the repository.

python -m baselines.evaluation.best_blind                             all scenarios that ship
python -m baselines.evaluation.best_blind --scenario highway_merge    one more

Of the controls that lose at most 5 s against the expert it is the one with the fewest collisions; of equal ones the one
that loses the least time. Seeds of evaluation, from a million on, are never looked at.
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.cli import parsed, refused, say, stopped
from baselines.controls.names import CHOICE, EVERY_CONTROL, read_choice
from baselines.evaluation.run import score
from baselines.evaluation.settings import ALL_SCENARIOS, Settings
from cad_env.config import check_range
from cad_env.files import replace_file
from cad_env.scoring.scorecard import Scorecard
from cad_env.scoring.time_lost import EXPERT
from cad_env.version import version
from policies.training.config import LAST_SEED

MOST_LOST = 5.0  # s, on average


@dataclass(frozen=True)
class Choosing:
    """Choose the control that is best-blind in each scenario, on training seeds, and write it to a file."""

    scenario: tuple[str, ...] = ALL_SCENARIOS  # names of scenarios, or all that ship; others in the file stay
    episodes: int = 300  # of each scenario and control, from seed 0 on
    jobs: int = 2  # processes
    out: Path = CHOICE  # the file

    def __post_init__(self) -> None:
        check_range("episodes", self.episodes, 1, LAST_SEED)

    def settings(self, folder: Path) -> Settings:
        """The run of evaluate.py that measures the controls."""
        return Settings(
            scenario=self.scenario, method=(EVERY_CONTROL, EXPERT), episodes=self.episodes, first_seed=0,
            jobs=self.jobs, out=folder, report=False,
        )  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    try:
        choosing = parsed(Choosing, argv)
        known = read_choice(choosing.out) if choosing.out.exists() else {}
        with tempfile.TemporaryDirectory() as folder:
            rows = [row for row in score(choosing.settings(Path(folder))) if row.hazard == "all"]
        found = {**known, **choice_of(rows)}
        replace_file(choosing.out, (json.dumps(found, indent=1) + "\n").encode())
    except (ValueError, OSError) as error:
        return refused(error)
    except KeyboardInterrupt as error:
        return stopped(error)
    say(", ".join(f"{scenario}: {found[scenario]['chosen']}" for scenario in dict.fromkeys(r.scenario for r in rows)))
    return 0


def choice_of(rows: Sequence[Scorecard]) -> dict[str, Any]:
    """scenario -> what was chosen, and what of; rows of all episodes, the expert's among them or not."""
    found: dict[str, Any] = {}
    for scenario in dict.fromkeys(row.scenario for row in rows):
        controls = [row for row in rows if row.scenario == scenario and row.method != EXPERT]
        found[scenario] = {
            "chosen": chosen_control(controls).method,
            "episodes": controls[0].episodes,
            "version of cad_env": version(),
            "measured": {row.method: _measured(row) for row in controls},
        }
    return found


def _measured(row: Scorecard) -> dict[str, float | None]:
    lost = None if row.time_lost is None else round(row.time_lost, 4)
    return {"collision_rate": round(row.collision_rate, 4), "time_lost": lost}


def chosen_control(rows: Sequence[Scorecard]) -> Scorecard:
    """The best of the controls of a scenario; ValueError if all lose more than 5 s or never arrive."""
    cheap = [(row.collisions, row.time_lost, row) for row in rows if row.time_lost is not None]
    allowed = [each for each in cheap if each[1] <= MOST_LOST]
    if not allowed:
        raise ValueError(f"no control of {rows[0].scenario} loses at most {MOST_LOST:g} s: there is none to choose")
    return min(allowed, key=lambda each: each[:2])[2]


if __name__ == "__main__":
    sys.exit(main())
