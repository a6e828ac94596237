"""FleetEpisodes -> FleetScores: pure functions. A rate never comes without its interval.

The agents of an episode share its fate, so n agents are not n independent trials. The interval of a share of agents
is Wilson's on the *effective* number of agents: theirs divided by the design effect, which is the variance of the
share between episodes over that of independent agents (E. L. Korn, B. I. Graubard, "Confidence intervals for
proportions with small expected number of positive counts estimated from survey data", Survey Methodology 24 (1998)).
Never more than there are agents; where nobody or everybody counts, so that the variance says nothing, as many as there
are episodes, which is what agents that always fare alike would be.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from cad_env.scoring.fleet import FleetEpisode
from cad_env.scoring.scorecard import KINDS, wilson

Z = 1.959963984540054  # of 95 %


@dataclass(frozen=True)
class Share:
    """A rate with its 95 % interval."""

    count: int
    of: int
    low: float
    high: float

    @property
    def rate(self) -> float:
        """count / of."""
        return self.count / self.of


@dataclass(frozen=True)
class FleetScore:
    """How a contender's fleets did in a scenario: one row of the table."""

    scenario: str
    contender: str
    hazard: str  # which episodes count: all, those with a hazard (yes), those without (no)
    episodes: int
    crashed_episodes: Share  # of the episodes, those in which any agent collided; Wilson's interval
    collisions: Share  # of all agents; effective sample size
    successes: Share  # of the agents that do not wait; effective sample size
    timeouts: Share  # of the agents that do not wait; effective sample size
    waits: int  # agents that could only wait
    mean_time_success: float | None  # s, over the agents that arrived
    needless_brakes: Share | None  # of agents that do not wait, those that braked at all; only where there is no hazard
    bytes_per_second: float  # that an agent sends, mean over their time


def fleet_scores(episodes: Iterable[FleetEpisode]) -> list[FleetScore]:
    """Rows for all episodes, those with a hazard and those without, as far as there are any.

    Scenarios and contenders come in the order of their first episode.
    """
    groups: dict[tuple[str, str], list[FleetEpisode]] = {}
    for episode in episodes:
        groups.setdefault((episode.scenario, episode.contender), []).append(episode)
    return [
        fleet_score(kind, chosen)
        for group in groups.values()
        for kind in KINDS
        if (chosen := [episode for episode in group if kind == "all" or episode.hazard == (kind == "yes")])
    ]


def fleet_score(kind: str, episodes: Sequence[FleetEpisode]) -> FleetScore:
    """The row of at least one episode, all of one scenario and contender."""
    everyone = [episode.agents for episode in episodes]
    drivers = [[agent for agent in agents if not agent.waits] for agents in everyone]
    sizes = [len(agents) for agents in drivers]
    flat = [agent for agents in everyone for agent in agents]
    crashed = sum(episode.collisions > 0 for episode in episodes)
    arrived = [agent.time for agent in flat if agent.outcome == "success"]
    braked = [sum(agent.brakes > 0 for agent in agents) for agents in drivers]

    def drivers_with(outcome: str) -> list[int]:
        return [sum(agent.outcome == outcome for agent in agents) for agents in drivers]

    return FleetScore(
        episodes[0].scenario, episodes[0].contender, kind, len(episodes),
        Share(crashed, len(episodes), *wilson(crashed, len(episodes))),
        clustered([episode.collisions for episode in episodes], [len(agents) for agents in everyone]),
        clustered(drivers_with("success"), sizes), clustered(drivers_with("timeout"), sizes),
        len(flat) - sum(sizes), math.fsum(arrived) / len(arrived) if arrived else None,
        clustered(braked, sizes) if kind == "no" else None,
        sum(agent.bytes_sent for agent in flat) / math.fsum(agent.time for agent in flat),
    )  # fmt: skip


def clustered(counts: Sequence[int], sizes: Sequence[int]) -> Share:
    """The share of `counts` in `sizes`, agents of each episode, with its interval by the effective sample size.

    >>> clustered([1] * 50 + [0] * 450, [1] * 500)  # an agent an episode: Wilson's own
    Share(count=50, of=500, low=0.0766..., high=0.1294...)
    >>> clustered([4] * 50 + [0] * 450, [4] * 500)  # four that always fare alike are no more than one
    Share(count=200, of=2000, low=0.0766..., high=0.1294...)
    """
    count, total, episodes = sum(counts), sum(sizes), len(sizes)
    rate = count / total
    alone = rate * (1.0 - rate) / total  # the variance if agents were independent
    between = math.fsum((k - rate * n) ** 2 for k, n in zip(counts, sizes, strict=True)) / total**2
    effective = total * alone / between if alone > 0.0 and between > 0.0 else math.inf if alone > 0.0 else episodes
    return Share(count, total, *_wilson_at(rate, min(effective, total)))


def _wilson_at(rate: float, of: float) -> tuple[float, float]:
    """Wilson's interval of a rate in a number of trials that need not be whole."""
    square = Z * Z / of
    middle = (rate + 0.5 * square) / (1.0 + square)
    half = Z / (1.0 + square) * math.sqrt(rate * (1.0 - rate) / of + 0.25 * square / of)
    return max(middle - half, 0.0), min(middle + half, 1.0)


_TITLES = ("scenario", "contender", "hazard", "episodes", "any collision % [95 %]", "agents", "collided % [95 %]",
           "drive", "arrived % [95 %]", "late %", "time s", "needless brakes %", "bytes/s")  # fmt: skip


def fleet_table(rows: Sequence[FleetScore]) -> str:
    """The rows as text: rates in per cent with their interval, a dash where there is nothing to say.

    "any collision" counts episodes, "collided" agents, "arrived" and "late" the agents that drive.
    """
    cells = [_TITLES, *(_cells(row) for row in rows)]
    widths = [max(len(line[k]) for line in cells) for k in range(len(_TITLES))]
    lines = ["  ".join(_aligned(k, cell, widths[k]) for k, cell in enumerate(line)) for line in cells]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def _aligned(column: int, cell: str, width: int) -> str:
    return cell.ljust(width) if column < 3 else cell.rjust(width)


def _cells(row: FleetScore) -> tuple[str, ...]:
    return (
        row.scenario, row.contender, row.hazard, str(row.episodes), _percent(row.crashed_episodes),
        str(row.collisions.of), _percent(row.collisions), str(row.successes.of), _percent(row.successes),
        f"{100 * row.timeouts.rate:.1f}", "-" if row.mean_time_success is None else f"{row.mean_time_success:.1f}",
        _percent(row.needless_brakes), f"{row.bytes_per_second:.0f}",
    )  # fmt: skip


def _percent(share: Share | None) -> str:
    return "-" if share is None else f"{100 * share.rate:.1f} [{100 * share.low:4.1f},{100 * share.high:5.1f}]"
