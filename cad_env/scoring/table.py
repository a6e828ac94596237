"""Scores as text: aligned columns, rates in per cent with their interval."""

from collections.abc import Sequence

from cad_env.scoring.scorecard import Scorecard

TITLES = ("scenario", "method", "hazard", "episodes", "collision % [95 %]", "time lost s [95 %]", "90th pct s [95 %]",
           "success % [95 %]", "timeouts", "time s", "bytes/message", "max")  # fmt: skip


def text_table(titles: Sequence[str], rows: Sequence[Sequence[str]], names: int = 3) -> str:
    """Rows under their titles and a rule; the first `names` columns are aligned to the left, the others to the right.

    >>> print(text_table(("method", "n"), [("expert", "5")], names=1))
    method  n
    ---------
    expert  5
    """
    widths = [max(len(line[k]) for line in (titles, *rows)) for k in range(len(titles))]

    def aligned(line: Sequence[str]) -> str:
        cells = (
            cell.ljust(w) if k < names else cell.rjust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        )
        return "  ".join(cells).rstrip()

    lines = [aligned(line) for line in (titles, *rows)]
    return "\n".join([lines[0], "-" * max(map(len, lines)), *lines[1:]])


def table(rows: Sequence[Scorecard]) -> str:
    """The scorecards as text, a part for each condition and scenario; a named condition has a line above its parts.

    Time lost is how much later it arrives than the expert on the same seed: its mean and its 90th percentile.
    """
    cells = [cells_of(row) for row in rows]
    head, rule, *lines = text_table(TITLES, cells).splitlines()
    parts: dict[tuple[str | None, str], list[str]] = {}
    for row, line in zip(rows, lines, strict=True):
        parts.setdefault((row.condition, row.scenario), [head, rule]).append(line)
    headed: set[str | None] = {None}
    texts: list[str] = []
    for (condition, _), part in parts.items():
        if condition not in headed:
            headed.add(condition)
            texts.append(f"condition: {condition}")
        texts.append("\n".join(part))
    return "\n\n".join(texts)


def cells_of(row: Scorecard) -> tuple[str, ...]:
    """A row of the table as text, under TITLES."""
    return (
        row.scenario, row.method, row.hazard, str(row.episodes),
        percent(row.collision_rate, row.collision_low, row.collision_high),
        seconds(row.time_lost, row.time_lost_low, row.time_lost_high),
        seconds(row.time_lost_p90, row.time_lost_p90_low, row.time_lost_p90_high),
        percent(row.success_rate, row.success_low, row.success_high),
        str(row.timeouts), f"{row.mean_time:.1f}",
        "-" if row.bytes_per_message_mean is None else f"{row.bytes_per_message_mean:.0f}",
        "-" if row.bytes_per_message_max is None else str(row.bytes_per_message_max),
    )  # fmt: skip


def percent(rate: float | None, low: float | None, high: float | None) -> str:
    """A rate with its interval in per cent, a dash where there is none.

    >>> percent(0.1, 0.0767, 0.1293)
    '10.0 [ 7.7, 12.9]'
    """
    if rate is None or low is None or high is None:
        return "-"
    return f"{100 * rate:.1f} [{100 * low:4.1f},{100 * high:5.1f}]"


def seconds(value: float | None, low: float | None, high: float | None) -> str:
    """A time with its interval in s, a dash where there is none.

    >>> seconds(1.25, 0.94, 1.56)
    '1.2 [0.9, 1.6]'
    """
    if value is None or low is None or high is None:
        return "-"
    return f"{value:.1f} [{low:.1f}, {high:.1f}]"
