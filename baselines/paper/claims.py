"""The orders that the paper claims, said of closed-loop success with intervals apart: they hold, the opposite does, or
it is open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from baselines.paper.closed_metrics import OURS, ClosedRow, paired_difference, success_pairs
from baselines.paper.folder import Drives
from baselines.paper.statistics import holm, mcnemar_of_seeds
from cad_env.scoring.interval import Estimate

ABLATIONS = ((OURS, "stgraph-own"), (OURS, "collab-gat"), ("stgraph-own", "gat"), ("collab-gat", "gat"))
BASELINES = ("gat", "raw-points", "compressed", "ppo", "command-only", "stgraph-no-edges")
CLAIMS = (*ABLATIONS, *((OURS, name) for name in BASELINES))


@dataclass(frozen=True)
class Order:
    """A claim that `better` succeeds more often than `worse`, and what came of it."""

    scenario: str
    radio: str  # of the worse one; where `stgraph` was not driven over it, its own is the main one
    better: str
    worse: str
    success: tuple[Estimate, Estimate]  # of both
    advantage: Estimate  # of the better one
    adjusted_p: float  # McNemar's after Holm, over the claims of a scenario over a radio
    bytes_per_second: tuple[float, float]  # of both

    @property
    def verdict(self) -> str:
        """holds or opposite, where the two intervals are apart and that of the difference leaves out zero; else open.

        The latter knows how much training seeds differ, which the intervals of the rates do not.
        """
        better, worse = self.success
        if better.low > worse.high and self.advantage.low > 0.0:
            return "holds"
        return "opposite" if worse.low > better.high and self.advantage.high < 0.0 else "open"


def orders(rows: Sequence[ClosedRow], drives: Mapping[str, Drives]) -> list[Order]:
    """What came of the claims, as far as both rows are there, in one scenario over one radio."""
    by_name = {row.method: row for row in rows}
    claims = [(better, worse) for better, worse in CLAIMS if better in by_name and worse in by_name]
    pairs = [success_pairs(drives[better], drives[worse]) for better, worse in claims]
    known = [(claim, pair) for claim, pair in zip(claims, pairs, strict=True) if pair[0].size]
    adjusted = holm([mcnemar_of_seeds(*pair).p for _, pair in known])
    return [
        Order(
            by_name[better].scenario, by_name[worse].radio, better, worse,
            (by_name[better].success, by_name[worse].success), paired_difference(*pair), p,
            (by_name[better].bytes_per_second, by_name[worse].bytes_per_second),
        )
        for ((better, worse), pair), p in zip(known, adjusted, strict=True)
    ]  # fmt: skip
