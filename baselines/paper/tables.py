"""Results -> tables in Markdown: rates in per cent, each with its 95 % interval, a dash where there is no value."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from baselines.paper.claims import Order
from baselines.paper.closed_metrics import HARD_BRAKE, OURS, ClosedRow
from baselines.paper.open_metrics import OpenScore
from baselines.paper.published import SCENES, Published
from cad_env.scoring.interval import Estimate

Scores = Mapping[str, Mapping[str, OpenScore]]  # scenario -> method
NONE = "-"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table.

    >>> print(markdown(("a", "b"), [("1", "2")]))
    | a | b |
    |---|---|
    | 1 | 2 |
    """
    lines = [head, ["---"] * len(head), *rows]
    return (
        "\n".join("| " + " | ".join(cells) + " |" for cells in lines).replace("| --- ", "|---").replace("--- |", "---|")
    )


def spoken(scene: str) -> str:
    """As people write it."""
    return scene.replace("_", " ").capitalize()


def percent_cell(estimate: Estimate | None) -> str:
    """
    >>> percent_cell(Estimate(0.1, 0.0767, 0.1293))
    '10.0 [7.7, 12.9]'
    """
    if estimate is None:
        return NONE
    return f"{100 * estimate.value:.1f} [{100 * estimate.low:.1f}, {100 * estimate.high:.1f}]"


def share_cell(estimate: Estimate | None) -> str:
    """As the paper prints its scores, from 0 to 1."""
    return NONE if estimate is None else f"{estimate.value:.3f} [{estimate.low:.3f}, {estimate.high:.3f}]"


def small(p: float | None) -> str:
    """
    >>> small(0.0312), small(1e-9), small(1.0)
    ('0.031', '< 0.001', '1')
    """
    if p is None:
        return NONE
    return "< 0.001" if p < 0.001 else f"{p:.2g}"


def number(value: float | None, digits: int = 0) -> str:
    """With so many digits behind the point."""
    return NONE if value is None else f"{value:,.{digits}f}"


def beside_table(published: Sequence[Published], scores: Scores, packages: bool) -> str:
    """A table of the paper: in every cell its number, then ours with the interval over episodes."""
    head = ["paper's row", "ours", *(["PS paper", "PS ours, bytes: mean (largest)"] if packages else [])]
    head += [f"{what}, {spoken(scene).lower()}: paper / ours" for scene in SCENES for what in ("AD", "EAR")]
    rows = []
    for row in published:
        ours = [scores.get(scene, {}).get(row.method) for scene in SCENES]
        cells = [row.title, row.method, *([row.package, _packages(ours)] if packages else [])]
        for scene, score in zip(SCENES, ours, strict=True):
            for paper, found in zip(row.of(scene), (score.ad, score.ear) if score else (None, None), strict=True):
                cells.append(f"{paper:.4f} / {share_cell(found)}")
        rows.append(cells)
    return markdown(head, rows)


def _packages(scores: Sequence[OpenScore | None]) -> str:
    """Over the scenes."""
    there = [score for score in scores if score is not None]
    if not there:
        return NONE
    means = [score.bytes_per_message for score in there if score.bytes_per_message is not None]
    if not means:
        return "0 (nothing on the air)"
    largest = max(score.largest_message or 0 for score in there)
    low, high = f"{min(means):,.0f}", f"{max(means):,.0f}"
    return f"{low if low == high else f'{low} to {high}'} ({largest:,})"


def ratio_table(scores: Scores) -> str:
    """How the graph stands to compressed features (the paper's F/D), raw points and no edges; "" without any."""
    rows = []
    for other in ("compressed", "raw-points", "stgraph-no-edges"):
        for scene in SCENES:
            ours, theirs = (scores.get(scene, {}).get(name) for name in (OURS, other))
            if ours and theirs:
                values = [
                    _ratio(theirs.bytes_per_message, ours.bytes_per_message),
                    *(_ratio(_value(getattr(ours, name)), _value(getattr(theirs, name))) for name in ("ad", "ear")),
                ]
                rows.append([other, spoken(scene), *values])
    head = ("stgraph against", "scene", "bytes of a message: times smaller", "AD ratio", "EAR ratio")
    return markdown(head, rows) if rows else ""


def _value(estimate: Estimate | None) -> float | None:
    return None if estimate is None else estimate.value


def _ratio(over: float | None, under: float | None) -> str:
    return f"{over / under:,.3g}" if over is not None and under else NONE


def open_table(scores: Mapping[str, OpenScore]) -> str:
    """All rows of a scene in open loop."""
    head = (
        "row", "radio", "training seeds", "AD (recall)", "EAR (accuracy)", "precision", "F1", "false brakes",
        "average precision", "AD, training seeds", "EAR, training seeds", "bytes/message", "largest",
    )  # fmt: skip
    rows = [
        [
            name, score.radio, str(score.training_seeds), *(share_cell(getattr(score, what)) for what in
                    ("ad", "ear", "precision", "f1", "false_brake_rate", "average_precision")),
            _spread(score.ad_spread, 1, 3), _spread(score.ear_spread, 1, 3), number(score.bytes_per_message),
            number(score.largest_message),
        ]
        for name, score in scores.items()
    ]  # fmt: skip
    return markdown(head, rows)


def threshold_table(scores: Mapping[str, OpenScore]) -> str:
    """One method in a scene in open loop, by the threshold from which it brakes."""
    what = ("ad", "ear", "precision", "f1", "false_brake_rate")
    rows = [[limit, *(share_cell(getattr(score, name)) for name in what)] for limit, score in scores.items()]
    return markdown(("threshold", "AD (recall)", "EAR (accuracy)", "precision", "F1", "false brakes"), rows)


def outcome_table(rows: Sequence[ClosedRow]) -> str:
    """How episodes end, and how that compares with `stgraph`."""
    head = (
        "row", "training seeds", "episodes", "collision %", "time lost, s", "time lost, s (90th percentile)",
        "success %", "timeout %", "collision %, training seeds",
        "success %, training seeds", f"{OURS} better by (points)", f"only {OURS} / only it succeeds",
        "McNemar p (Holm)",
    )  # fmt: skip
    cells = [
        [
            _bold(row.method), str(row.training_seeds), str(row.episodes), percent_cell(row.collision),
            time_cell(row.time_lost), time_cell(row.time_lost_p90),
            percent_cell(row.success), percent_cell(row.timeout), _spread(row.collision_spread, 100, 1),
            _spread(row.success_spread, 100, 1), percent_cell(row.advantage),
            NONE if row.test is None else f"{row.test.first_only} / {row.test.second_only}", small(row.adjusted_p),
        ]
        for row in rows
    ]  # fmt: skip
    return markdown(head, cells)


def manner_table(rows: Sequence[ClosedRow]) -> str:
    """How it drives meanwhile, and what it puts on the air."""
    head = (
        "row", "SCT", "time, s", "needless brakes, % of episodes without a hazard",
        "decisions to brake in such an episode", f"hard brakes (>= {HARD_BRAKE:g} m/s2), % of episodes",
        "min TTC, s (5th percentile)", "bytes/message", "largest", "kB/s on the air", "lost %",
    )  # fmt: skip
    cells = [
        [
            _bold(row.method), share_cell(row.sct), time_cell(row.mean_time),
            percent_cell(row.needless), number(row.needless_decisions, 1), percent_cell(row.hard_brakes),
            number(row.min_ttc, 2), number(row.bytes_per_message), number(row.largest_message),
            number(row.bytes_per_second / 1000, 1),
            NONE if row.lost is None else f"{100 * row.lost:.1f}",
        ]
        for row in rows
    ]  # fmt: skip
    return markdown(head, cells)


def order_table(orders: Sequence[Order]) -> str:
    """What came of the claims."""
    head = (
        "scene", "radio", "claim", "success % of both", "difference (points)", "McNemar p (Holm)", "kB/s of both",
        "verdict",
    )  # fmt: skip
    cells = [
        [
            spoken(order.scenario), order.radio, f"{order.better} over {order.worse}",
            " / ".join(map(percent_cell, order.success)), percent_cell(order.advantage), small(order.adjusted_p),
            " / ".join(f"{rate / 1000:.1f}" for rate in order.bytes_per_second), order.verdict,
        ]
        for order in orders
    ]  # fmt: skip
    return markdown(head, cells)


def sweep_table(values: Mapping[str, Mapping[str, ClosedRow]], name: str) -> str:
    """One scene of a sweep, value -> method -> row: success, collision and time lost at every point."""
    methods = list(dict.fromkeys(method for rows in values.values() for method in rows))
    told = ("success %", "collision %", "time lost, s")
    head = [name, "episodes", *(f"{who}: {what}" for who in methods for what in told)]
    head += [f"{who}: bytes/message, kB/s" for who in methods]
    cells = []
    for value, rows in values.items():
        there = [rows.get(who) for who in methods]
        line = [value, str(max(row.episodes for row in rows.values()))]
        for row in there:
            line += [percent_cell(getattr(row, what, None)) for what in ("success", "collision")]
            line.append(time_cell(getattr(row, "time_lost", None)))
        line += [
            NONE if row is None else f"{number(row.bytes_per_message)}, {number(row.bytes_per_second / 1000, 1)}"
            for row in there
        ]
        cells.append(line)
    return markdown(head, cells)


def cost_table(costs: Any) -> str:
    """costs.json as it is: a mapping of rows, or a list of them, with their numbers by name; "" for anything else."""
    if isinstance(costs, Mapping):
        costs = [{"row": name, **values} for name, values in costs.items() if isinstance(values, Mapping)]
    if not isinstance(costs, list) or not costs or not all(isinstance(row, Mapping) for row in costs):
        return ""
    head = list(dict.fromkeys(str(name) for row in costs for name in row))
    return markdown(head, [[_plain(row.get(name)) for name in head] for row in costs])


def _plain(value: Any) -> str:
    if value is None:
        return NONE
    return f"{value:,.4g}" if isinstance(value, float) else str(value)


def _bold(name: str) -> str:
    return f"**{name}**" if name == OURS else name


def time_cell(estimate: Estimate | None) -> str:
    """
    >>> time_cell(Estimate(1.25, 0.9, 1.62))
    '1.2 [0.9, 1.6]'
    """
    return NONE if estimate is None else f"{estimate.value:.1f} [{estimate.low:.1f}, {estimate.high:.1f}]"


def _spread(spread: tuple[float, float] | None, scale: float, digits: int) -> str:
    return NONE if spread is None else f"{scale * spread[0]:.{digits}f} to {scale * spread[1]:.{digits}f}"
