"""Conditions x methods as text: a Markdown table for each scenario, which pages can hold as it is."""

from collections.abc import Mapping, Sequence

from cad_env.scoring.scorecard import Scorecard
from cad_env.scoring.table import percent

MATRIX = "matrix.md"  # in a folder of results of several conditions

_Cells = Mapping[tuple[str | None, str, str], Scorecard]  # condition, method, hazard


def matrix_text(rows: Sequence[Scorecard]) -> str:
    """In each cell: collisions in % with their 95 % interval, success in %, calm time in s.

    Calm time is the mean time of the episodes without a hazard in which the ego arrives. Bold: the most collisions of a
    column, unless all are alike.
    """
    scenarios = list(dict.fromkeys(row.scenario for row in rows))
    return "\n".join(
        _of_scenario(scenario, [row for row in rows if row.scenario == scenario]) for scenario in scenarios
    )


def _of_scenario(scenario: str, rows: Sequence[Scorecard]) -> str:
    cells: _Cells = {(row.condition, row.method, row.hazard): row for row in rows}
    conditions, methods = (list(dict.fromkeys(key[k] for key in cells)) for k in (0, 1))
    lines = [
        f"| {scenario.replace('_', ' ')} | {' | '.join(map(str, methods))} |",
        f"|---|{'---|' * len(methods)}",
        *(f"| {each} | {' | '.join(_cell(cells, each, str(name)) for name in methods)} |" for each in conditions),
    ]
    return "\n".join(lines) + "\n"


def _cell(cells: _Cells, condition: str | None, method: str) -> str:
    row, calm = cells[condition, method, "all"], cells.get((condition, method, "no"))
    collisions = percent(row.collision_rate, row.collision_low, row.collision_high)
    time = "-" if calm is None or calm.mean_time_success is None else f"{calm.mean_time_success:.1f}"
    column = [cell.collision_rate for (_, name, hazard), cell in cells.items() if (name, hazard) == (method, "all")]
    worst = row.collision_rate == max(column) > min(column)
    return f"{f'**{collisions}**' if worst else collisions} · {100 * row.success_rate:.1f} · {time}"
