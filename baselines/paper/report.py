"""results.md, results.json and img/*.png from the folder of a run, whatever of it there is."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.methods import radio_of
from baselines.paper import published, tables
from baselines.paper.acceptance import Bar, bar_table, bars
from baselines.paper.claims import Order, orders
from baselines.paper.closed_metrics import CHANCE, OURS, ClosedRow, closed_row, compared
from baselines.paper.folder import NOTES, Run, read_run
from baselines.paper.open_loop import at_threshold
from baselines.paper.open_metrics import OpenScore, open_score
from baselines.paper.plots import robustness_plot, safety_plot
from baselines.paper.sweeps import SWEEPS
from baselines.paper.tables import Scores, spoken
from cad_env.files import replace_text

RESULTS, NUMBERS, IMAGES = "results.md", "results.json", "img"
MAIN = "dsrc"  # the radio that comes first
SIZES = ("budget", "depth")  # the sweeps of what the graph may cost

Closed = Mapping[str, Mapping[str, list[ClosedRow]]]  # radio -> scenario
Swept = Mapping[str, Mapping[str, Mapping[str, Mapping[str, ClosedRow]]]]  # name -> scenario -> value -> method


THRESHOLDS = (0.2, 0.35, 0.5, 0.65, 0.8)  # of OURS, in open loop


@dataclass(frozen=True)
class Findings:
    """All numbers of a run."""

    open: Scores
    thresholds: Scores  # of OURS in open loop, by the threshold
    closed: Closed
    orders: list[Order]
    sweeps: Swept
    bars: list[Bar]


def write_results(folder: Path, command: str = "") -> Path:
    """Write the report of a run into its folder; gives the path of results.md. `command`: what makes the whole run.

    Parts that are not there are left out, with a line that says so. ValueError, one line, for a damaged file.
    """
    run = read_run(folder)
    findings = found_in(run)
    (folder / IMAGES).mkdir(exist_ok=True)
    parts = [
        _head(command), _beside(findings), _closed_loop(run, findings), _safety(folder / IMAGES, run, findings),
        _robustness(folder / IMAGES, run, findings), _departures(run, findings), _costs(run), _open_loop(findings),
    ]  # fmt: skip
    numbers = json.dumps(
        {**asdict(findings), "costs": run.costs, "commands": dict(run.commands)}, indent=1, allow_nan=False
    )
    replace_text(folder / NUMBERS, numbers)
    replace_text(folder / RESULTS, "\n\n".join(parts) + "\n")
    return folder / RESULTS


def found_in(run: Run) -> Findings:
    """All numbers, without a picture."""
    scores = {
        scenario: {name: open_score(loops, np.random.default_rng(CHANCE)) for name, loops in methods.items()}
        for scenario, methods in run.open.items()
    }
    closed: dict[str, dict[str, list[ClosedRow]]] = {}
    said: list[Order] = []
    for radio in sorted(run.closed, key=lambda radio: (radio != MAIN, radio)):
        for scenario, methods in run.closed[radio].items():
            rows = [closed_row(radio, scenario, name, each, run.expert(scenario)) for name, each in methods.items()]
            closed.setdefault(radio, {})[scenario] = rows
            ours = methods.get(OURS) or run.closed.get(MAIN, {}).get(scenario, {}).get(OURS)
            if ours:
                closed[radio][scenario] = compared(rows, ours, methods)
                known = [closed_row(MAIN, scenario, OURS, ours, {})] if OURS not in methods else []
                said += orders([*rows, *known], {**methods, OURS: ours})
            else:
                said += orders(rows, methods)
    sweeps: dict[str, dict[str, dict[str, dict[str, ClosedRow]]]] = {}
    for name, values in run.sweeps.items():
        for value, swept in values.items():
            for scenario, driven in swept.items():
                expert = run.expert(scenario) if _same_world(name, value) else {}
                sweeps.setdefault(name, {}).setdefault(scenario, {})[value] = {
                    who: closed_row(radio_of(who, MAIN), scenario, who, {0: records}, expert)
                    for who, records in driven.items()
                }
    scenes = dict.fromkeys([*scores, *(scenario for scenarios in closed.values() for scenario in scenarios)])
    judged = [bar for scene in scenes for bar in bars(scene, _of_scene(closed, scene), scores.get(scene, {}))]
    return Findings(scores, _by_threshold(run), closed, said, sweeps, judged)


def _same_world(name: str, value: str) -> bool:
    return all(point.same_world for point in SWEEPS[name].points if point.value == value)


def _by_threshold(run: Run) -> dict[str, dict[str, OpenScore]]:
    """OURS in open loop, by scenario and threshold."""
    ours = {scenario: methods[OURS] for scenario, methods in run.open.items() if OURS in methods}
    return {
        scenario: {
            f"{limit:g}": open_score(
                {seed: at_threshold(loop, limit) for seed, loop in loops.items()}, np.random.default_rng(CHANCE)
            )
            for limit in THRESHOLDS
        }
        for scenario, loops in ours.items()
    }


def _of_scene(closed: Closed, scenario: str) -> dict[str, list[ClosedRow]]:
    return {radio: scenarios[scenario] for radio, scenarios in closed.items() if scenario in scenarios}


def _head(command: str) -> str:
    made = f"\n\n```\n{command}\n```" if command else ""
    return (
        f"# Results, row by row{made}\n\nRates carry 95 % intervals: Wilson's over the episodes of one training seed "
        "for closed-loop rates, and percentiles of a bootstrap over training seeds and whole episodes for everything "
        "else, because frames at 10 Hz are correlated. Spreads are the least and most among training seeds. "
        "A dash: there is no such number. Give each `evaluate.py` below a folder of its own (`--out`): a folder holds "
        "one run. A witness of the hidden lane is always connected, but for the sweep over collaborators at 0."
    )


def _missing(what: str) -> str:
    return f"*Left out: there is no {what} in this run.*"


def _beside(findings: Findings) -> str:
    lines = ["## The paper's tables beside ours", published.SIMULATORS, published.PAPER_UNITS]
    if not findings.open:
        return "\n\n".join([*lines, _missing("open-loop measurement")])
    lines += ["### Table II", tables.beside_table(published.TABLE_2, findings.open, packages=True)]
    lines += [
        'The paper prints the EAR of Collab-GAT in overtaking as "0. 7020". GAT sends nothing; the paper gives it '
        "the size of a frame. AD is the recall of brake frames: braking always scores 1, so read it beside the "
        "precision in the last section."
    ]
    ratios = tables.ratio_table(findings.open)
    if ratios:
        lines += ["The paper's F/D (against compressed features) is 104.08 for the size; as ratios here:", ratios]
    lines += ["### Table III", tables.beside_table(published.TABLE_3, findings.open, packages=False)]
    absent = sorted(
        {row.method for row in (*published.TABLE_2, *published.TABLE_3)}
        - {name for scores in findings.open.values() for name in scores}
    )
    return "\n\n".join([*lines, *([_missing(f"open-loop measurement of {', '.join(absent)}")] if absent else [])])


def _closed_loop(run: Run, findings: Findings) -> str:
    lines = ["## Closed loop, all rows"]
    if not findings.closed:
        return "\n\n".join([*lines, _missing("closed loop")])
    lines.append(
        "All rows of a scene drive the same seeds. Methods that share nothing are the same over any radio. McNemar's "
        "exact test is on the successes of the same episodes, the largest p of all training seeds, after Holm "
        "over the rows of a table. Over a radio that `stgraph` was not driven over, rows are compared with its "
        "episodes over `dsrc`. A difference has an interval without width where no episode tells the two rows apart: "
        "what is known then are the intervals of their rates. SCT is success times the share of the expert's time on "
        "the same seed. Time lost is how much later than the expert it arrives on the same seed, its mean and its 90th "
        "percentile: who waits until time is up has lost the time up to then, a collision has no time."
    )
    for radio, scenarios in findings.closed.items():
        for scenario, rows in scenarios.items():
            lines += [f"### {spoken(scenario)}, radio `{radio}`", tables.outcome_table(rows), tables.manner_table(rows)]
        lines += list(_commands(run, f"closed/{radio}/"))
    return "\n\n".join(lines)


def _commands(run: Run, below: str) -> Iterator[str]:
    commands = [command for place, command in run.commands.items() if place.startswith(below)]
    if commands:
        yield "```\n" + "\n".join(dict.fromkeys(commands)) + "\n```"


def _safety(images: Path, run: Run, findings: Findings) -> str:
    lines = ["## Safety against bytes on the air"]
    scenes = list(dict.fromkeys(scenario for scenarios in findings.closed.values() for scenario in scenarios))
    if not scenes:
        return "\n\n".join([*lines, _missing("closed loop")])
    lines.append(
        "Success (more is better) and collisions (fewer are) against the bytes per second of all connected vehicles. "
        "Filled: the first radio; hollow: others. A sender does not trim its graph to a budget: with a small one, "
        "messages above it are refused whole (dotted). Fewer frames a message is what shrinks it (line)."
    )
    for scenario in scenes:
        rows = _of_scene(findings.closed, scenario)
        sizes = {name: findings.sweeps[name][scenario] for name in SIZES if scenario in findings.sweeps.get(name, {})}
        safety_plot(images / f"safety_{scenario}.png", rows, sizes)
        lines.append(f"![{spoken(scenario)}: success and collisions against bytes]({IMAGES}/safety_{scenario}.png)")
        for name, values in sizes.items():
            lines += [f"{spoken(scenario)}, {SWEEPS[name].label}:", tables.sweep_table(values, name)]
    for name in SIZES:
        lines += list(_commands(run, f"sweeps/{name}/"))
    absent = [name for name in SIZES if name not in findings.sweeps]
    return "\n\n".join([*lines, *([_missing(f"sweep of {' or '.join(absent)}")] if absent else [])])


def _robustness(images: Path, run: Run, findings: Findings) -> str:
    lines = ["## Robustness"]
    swept = {name: scenes for name, scenes in findings.sweeps.items() if name not in SIZES}
    if swept:
        lines.append(
            "Success with its Wilson band, collisions dashed. A row is swept over the radio that it learned over: "
            "`dsrc`, and `cv2x` for compressed, whose messages do not fit into the former."
        )
    for name, scenes in swept.items():
        robustness_plot(images / f"sweep_{name}.png", name, scenes)
        lines += [f"### {spoken(name)}", f"![{SWEEPS[name].label}]({IMAGES}/sweep_{name}.png)"]
        for scenario, values in scenes.items():
            lines += [f"{spoken(scenario)}:", tables.sweep_table(values, SWEEPS[name].label)]
        lines += list(_commands(run, f"sweeps/{name}/"))
    absent = [name for name in SWEEPS if name not in findings.sweeps and name not in SIZES]
    return "\n\n".join([*lines, *([_missing(f"sweep of {', '.join(absent)}")] if absent else [])])


def _departures(run: Run, findings: Findings) -> str:
    lines = ["## What did not come out as in the paper, and why"]
    if findings.orders:
        lines += [
            "The orders in closed-loop success. One holds, or its opposite does, where the Wilson intervals are apart "
            "and the interval of the difference, over training seeds and episodes, leaves zero out; else it is open. "
            "Holm is over the claims of a scene over a radio.",
            tables.order_table(findings.orders),
        ]
    else:
        lines.append(_missing("pair of rows that the paper orders"))
    if findings.bars:
        lines += ["What this project asks of itself, judged by the estimates:", bar_table(findings.bars)]
    return "\n\n".join([*lines, run.notes or f"*Nobody has written {NOTES} for this run yet.*"])


def _costs(run: Run) -> str:
    table, made = tables.cost_table(run.costs), "`python benchmarks/points.py --json costs.json`"
    said = f"Full clouds, one thread: {made}, written into the folder of a run.\n\n{table}"
    return "## What the networks cost\n\n" + (said if table else _missing("measurement of costs"))


def _open_loop(findings: Findings) -> str:
    lines = ["## Open loop, all rows"]
    if not findings.open:
        return "\n\n".join([*lines, _missing("open-loop measurement")])
    for scenario, scores in findings.open.items():
        some: Any = next(iter(scores.values()))
        lines += [
            f"### {spoken(scenario)}",
            f"{some.episodes} held-out episodes that the expert drives, {some.frames:,} frames, in "
            f"{100 * some.brake_share:.1f} % of which it brakes; bootstrap over episodes. Radio: what the method's "
            "messages went over; the world is the expert's and the same for all.",
            tables.open_table(scores),
        ]
        if scenario in findings.thresholds:
            lines += [
                f"`{OURS}` with other thresholds in place of those of its models (`evaluate.py --threshold`):",
                tables.threshold_table(findings.thresholds[scenario]),
            ]
    return "\n\n".join(lines)
