"""What this project asks of itself, scene by scene, beside what was measured: met or not, by the numbers as they are.

A bar is judged by the estimate; its interval stands beside it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from baselines.controls.names import BEST_BLIND
from baselines.paper.closed_metrics import OURS, ClosedRow
from baselines.paper.open_metrics import OpenScore
from baselines.paper.tables import markdown, number, percent_cell, share_cell, spoken, time_cell
from cad_env.scoring.interval import Estimate

SMALLER = {"compressed": 100.0, "raw-points": 1000.0}  # times, as encoded
RowsByMethod = Mapping[str, ClosedRow]  # by method


@dataclass(frozen=True)
class Bar:
    """One demand in one scene."""

    scenario: str
    demand: str
    measured: str
    met: bool


def bars(scenario: str, radios: Mapping[str, Sequence[ClosedRow]], scores: Mapping[str, OpenScore]) -> list[Bar]:
    """All demands that can be judged in a scene by the rows over each radio, the main one first, and open loop."""
    first: RowsByMethod = {row.method: row for row in next(iter(radios.values()), [])}
    everywhere = [row for rows in radios.values() for row in rows]
    found = [*_driving(first), *_sizes(everywhere, scores), *_imitation(scores), *_leak(first), *_blind(first)]
    return [Bar(scenario, *each) for each in found]


def _driving(rows: RowsByMethod) -> Iterator[tuple[str, str, bool]]:
    ours, expert = rows.get(OURS), rows.get("expert")
    if ours is None:
        return
    yield "collisions at most 1 %", percent_cell(ours.collision), ours.collision.value <= 0.01
    yield "success at least 98 %", percent_cell(ours.success), ours.success.value >= 0.98
    if ours.needless is not None:
        yield (
            "needless brakes in at most 10 % of episodes without a hazard",
            percent_cell(ours.needless),
            (ours.needless.value <= 0.1),
        )
    if expert is not None:
        behind = 100 * (expert.success.value - ours.success.value)
        yield "success within 2 points of the expert's", f"{behind:.1f} points behind", behind <= 2.0
    if ours.time_lost is not None:
        yield "at most 2 s lost to the expert", time_cell(ours.time_lost), ours.time_lost.value <= 2.0


def _sizes(rows: Sequence[ClosedRow], scores: Mapping[str, OpenScore]) -> Iterator[tuple[str, str, bool]]:
    """As encoded on held-out episodes over a radio that carries them; of rows without these, as sent in driving."""
    size = {row.method: row.bytes_per_message for row in reversed(rows) if row.bytes_per_message}
    size |= {name: score.bytes_per_message for name, score in scores.items() if score.bytes_per_message}
    if OURS not in size:
        return
    yield "mean message at most 600 B", f"{number(size[OURS])} B", size[OURS] <= 600
    for other, times in SMALLER.items():
        if other in size:
            ratio = size[other] / size[OURS]
            yield f"messages {times:,.0f} times smaller than those of {other}", f"{ratio:,.0f} times", ratio >= times


def _imitation(scores: Mapping[str, OpenScore]) -> Iterator[tuple[str, str, bool]]:
    if OURS in scores:
        for name, estimate in (("AD", scores[OURS].ad), ("EAR", scores[OURS].ear)):
            if estimate is not None:
                yield f"{name} at least 0.93", share_cell(estimate), estimate.value >= 0.93


def _leak(rows: RowsByMethod) -> Iterator[tuple[str, str, bool]]:
    """The command must tell nothing: the control is judged against the better of two constants."""
    names = ("command-only", "always-go", "always-brake")
    if all(name in rows for name in names):
        control, *constants = (rows[name].success for name in names)
        best: Estimate = max(constants, key=lambda estimate: estimate.value)
        said = f"{percent_cell(control)} against {percent_cell(best)}"
        yield "command-only succeeds no more often than the better constant", said, control.low <= best.value


def _blind(rows: RowsByMethod) -> Iterator[tuple[str, str, bool]]:
    """A scene that can be passed with closed eyes says nothing of those who see."""
    best = rows.get(BEST_BLIND)
    if best is not None and best.time_lost is not None:
        said = f"{percent_cell(best.collision)} % and {time_cell(best.time_lost)} s"
        passes = best.collision.value <= 0.05 and best.time_lost.value <= 5.0
        yield "best-blind collides in more than 5 % or loses more than 5 s", said, not passes


def bar_table(found: Sequence[Bar]) -> str:
    """As people read it."""
    head = ("scene", "demand", "measured", "met")
    return markdown(
        head, [(spoken(bar.scenario), bar.demand, bar.measured, "yes" if bar.met else "**no**") for bar in found]
    )
