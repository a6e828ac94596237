"""Scores and plots -> one page of HTML."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any

from baselines.evaluation.noted_conditions import met_in_words
from baselines.evaluation.report.figures import Plot, knowledge_of
from cad_env.scoring.scorecard import Scorecard
from cad_env.scoring.table import TITLES, cells_of, percent, seconds

SAID_ELSEWHERE = ("condition", "scenario", "method", "command", "episodes", "first_seed")
_UNITS = {"sensor_noise": "m", "gnss_noise": "m", "delay": "s", "range": "m", "depth": "frames"}
CSS = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 76rem; margin: 2rem auto;
  padding: 0 1rem }
h1 { font-size: 1.6rem; line-height: 1.25; margin-bottom: .5rem }
h2 { font-size: 1.2rem; margin: 2.5rem 0 .5rem; border-bottom: 1px solid #ddd; padding-bottom: .2rem }
h3 { font-size: 1rem; margin: 1.5rem 0 .3rem }
pre { background: #f5f5f5; padding: .6rem .8rem; overflow-x: auto; border-radius: 4px; font-size: .85rem }
img { max-width: 100%; height: auto }
figure { margin: 0 0 1rem }
figcaption, .note { color: #555; font-size: .88rem; max-width: 60rem }
.wide { overflow-x: auto }
table { border-collapse: collapse; font-size: .8rem; font-variant-numeric: tabular-nums; white-space: nowrap }
th { text-align: right; vertical-align: bottom; border-bottom: 2px solid #888; padding: .2rem .45rem; font-weight: 600;
  white-space: normal }
td { text-align: right; padding: .1rem .45rem }
.text { text-align: left }
.all td { font-weight: 600; border-top: 1px solid #ccc; padding-top: .35rem }
.part td { color: #555 }
dl { display: grid; grid-template-columns: max-content auto; gap: .1rem 1rem; font-size: .88rem; margin: .5rem 0 }
dt { color: #555 }
dd { margin: 0 }
.pictures { display: flex; flex-wrap: wrap; gap: 1rem }
"""
INTRODUCTION = """In each episode the ego has to cross the way of vehicles that it may not see, and decides ten times a
second: go or brake. In a hazard one of them would hit an ego that never brakes. Connected vehicles send what they
see over a radio; methods differ in what they know and in how they decide."""
LEGEND = """Rates are in per cent with their 95 % Wilson interval. Hazard: all episodes, those with a hazard (yes), or
without (no). Time lost: how much later than the expert it arrives on the same seed, its mean and its 90th
percentile with their 95 % intervals; who waits until time is up has lost the time up to then, and a
collision has no time. Time: mean until the outcome; of successes alone with its 95 % interval, which
without a hazard is the calm time. Bytes: of a message on average, of the largest, and in a second by all
connected vehicles together. Min TTC: the smallest time to contact with anybody in any episode. Needless
brakes: share of the episodes without a hazard in which it brakes at all."""


def html_page(
    settings: Mapping[str, Any], rows: Sequence[Scorecard], plots: Sequence[Plot], gifs: Mapping[str, bytes], left: int
) -> str:
    """The whole report; `left` animations more are in the folder gifs."""
    title, knows = _title(rows), knowledge_of(settings)
    body = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{INTRODUCTION}</p>",
        f"<p>{'<br>'.join(map(escape, met_in_words(settings)))}</p>",
        _made_with(settings),
        *(_plot(plot) for plot in plots),
        "<h2>All numbers</h2>",
        f'<p class="note">{LEGEND}</p>',
        *(_table(*place, list(part), knows) for place, part in groupby(rows, _place)),
        _pictures(gifs, left) if gifs else "",
    ]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    return "\n".join(
        ["<!doctype html>", '<html lang="en">', f"<head>{head}<style>{CSS}</style></head>", "<body>", *body]
    ) + ("\n</body>\n</html>\n")


def _title(rows: Sequence[Scorecard]) -> str:
    whole = [row for row in rows if row.hazard == "all"]
    scenes = list(dict.fromkeys(row.scenario.replace("_", " ") for row in whole))
    counts = sorted({row.episodes for row in whole})
    methods = len({row.method for row in whole})
    who = "1 method" if methods == 1 else f"{methods} methods"
    conditions = len({row.condition for row in rows})
    under = f" under {conditions} conditions" if conditions > 1 else ""
    return f"{', '.join(scenes).capitalize()}: {who}{under}, {counts[0]} episodes each"


def _made_with(settings: Mapping[str, Any]) -> str:
    """The command, and everything that the episodes depend on."""
    first, count = settings["first_seed"], settings["episodes"]
    said = {"seeds": f"{first} to {first + count - 1}, the same for every scenario and method"}
    said |= {name: _plain(name, value) for name, value in settings.items() if name not in SAID_ELSEWHERE}
    terms = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in said.items())
    return f"<pre>{escape(str(settings.get('command', '')))}</pre>\n<dl>{terms}</dl>"


def _plain(name: str, value: object) -> str:
    """
    >>> _plain("radio", {"rate": "7200000.0", "delay": "0.1"})
    'rate 7.2 Mbit/s, delay 0.1 s'
    """
    if isinstance(value, Mapping):
        return ", ".join(f"{part} {_plain(part, inner)}" for part, inner in value.items())
    if name == "rate":
        return f"{float(str(value)) / 1e6:g} Mbit/s"
    return "default" if value is None else f"{value} {_UNITS[name]}" if name in _UNITS else str(value)


def _plot(plot: Plot) -> str:
    image = f'<img alt="{escape(plot.title)}" src="{_inline("image/svg+xml", plot.svg)}">'
    return f"<h2>{escape(plot.title)}</h2>\n<figure>{image}<figcaption>{escape(plot.caption)}</figcaption></figure>"


def _place(row: Scorecard) -> tuple[str | None, str]:
    return row.condition, row.scenario


def _table(condition: str | None, scenario: str, rows: Sequence[Scorecard], knows: Mapping[str, str]) -> str:
    titles = (*TITLES[1:], "time of successes s [95 %]", "bytes/s", "min TTC s", "hit from behind", "needless brakes %")
    head = "".join(f"<th{_kind(k)}>{escape(title)}</th>" for k, title in enumerate(titles))
    lines = "\n".join(_lines(list(group), knows) for _, group in groupby(rows, lambda row: row.method))
    where = scenario.replace("_", " ").capitalize()
    return (
        f"<h3>{escape(where if condition is None else f'{condition}: {where}')}</h3>\n"
        '<div class="wide"><table>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{lines}\n</tbody></table></div>"
    )


def _lines(rows: Sequence[Scorecard], knows: Mapping[str, str]) -> str:
    """The rows of one method: all episodes under its name, then parts of them beside what it knows."""
    known = knows.get(rows[0].method)
    names = (rows[0].method, f"knows {known}" if known else "", *[""] * len(rows))
    return "\n".join(_line(name, row) for name, row in zip(names, rows, strict=False))


def _line(name: str, row: Scorecard) -> str:
    more = (
        seconds(row.mean_time_success, row.mean_time_success_low, row.mean_time_success_high),
        f"{row.bytes_per_second:.0f}", "-" if row.min_ttc is None else f"{row.min_ttc:.2f}",
        str(row.struck_from_behind),
        percent(row.needless_brakes, row.needless_low, row.needless_high),
    )  # fmt: skip
    inner = "".join(f"<td{_kind(k)}>{escape(cell)}</td>" for k, cell in enumerate((name, *cells_of(row)[2:], *more)))
    return f'<tr class="{"all" if row.hazard == "all" else "part"}">{inner}</tr>'


def _kind(column: int) -> str:
    return ' class="text"' if column < 2 else ""


def _pictures(gifs: Mapping[str, bytes], left: int) -> str:
    figures = "".join(
        f'<figure><img alt="{escape(name)}" src="{_inline("image/gif", data)}">'
        f"<figcaption>{escape(name)}</figcaption></figure>"
        for name, data in gifs.items()
    )
    more = f'<p class="note">{left} more are in the folder gifs.</p>' if left else ""
    return f'<h2>Episodes</h2>\n<div class="pictures">{figures}</div>{more}'


def _inline(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
