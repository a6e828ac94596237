"""What a scenario is drawn from: ranges by name, and how much traffic is around its actors."""

from dataclasses import dataclass, field, fields
from numbers import Integral, Real
from typing import Any

from cad_env.checks import ConfigError, check_range, did_you_mean, plain, settle

Range = tuple[float, float]

# Further vehicles around the actors, from and to.
DENSITIES = {"none": (0, 0), "light": (4, 8), "dense": (12, 16)}


@dataclass(frozen=True)
class Traffic:
    """How much is on the road around the actors, and how many of all of them are connected."""

    density: str = "light"
    penetration: float | None = None  # probability that a vehicle is connected; None: as many as `collaborators` says

    def __post_init__(self) -> None:
        if not isinstance(self.density, str) or self.density not in DENSITIES:
            near = did_you_mean(self.density, DENSITIES)
            raise ConfigError(f"traffic must be one of {', '.join(DENSITIES)}, got {self.density!r}{near}")
        if self.penetration is not None:
            check_range("penetration", self.penetration, 0.0, 1.0)


def span(low: float, high: float, within: Range) -> Any:
    """A field of a Ranges record: what is drawn uniformly from (low, high) by default, and the limits of a change."""
    return field(default=(low, high), metadata={"within": within})


def count(low: int, high: int, within: tuple[int, int]) -> Any:
    """The same in whole numbers, both ends included."""
    return field(default=(low, high), metadata={"within": within, "whole": True})


def share(value: float) -> Any:
    """A field that holds a probability."""
    return field(default=value, metadata={"share": True})


@dataclass(frozen=True)
class Ranges:
    """What the actors of every scenario are drawn from; each adds its own. Nonsense is refused by name and value."""

    collaborators: tuple[int, int] = count(2, 4, within=(0, 20))  # connected vehicles besides the ego

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if "share" in each.metadata:
                settle(self, each.name, check_range(each.name, value, 0.0, 1.0))
            if "within" in each.metadata:
                ends = _checked_span(each.name, value, *each.metadata["within"])
                if "whole" in each.metadata and not all(isinstance(end, Integral) for end in ends):
                    raise ValueError(f"{each.name} must be a pair of whole numbers, got {value!r}")
                settle(self, each.name, ends)


@dataclass(frozen=True)
class StreamRanges(Ranges):
    """The same with a hidden stream: platoons one after another, whose times know nothing of the ego.

    Each scenario says how fast they drive, how many vehicles a platoon has, and how far apart they come.
    """

    empty_share: float = share(0.05)  # share of episodes without any hidden vehicle
    attentive_share: float = share(0.5)  # share of drivers of the stream that react to who is across their way ...
    reaction: Range = span(0.6, 1.4, within=(0.0, 5.0))  # s ... so long after they could


def _checked_span(name: str, value: Any, low: float, high: float) -> tuple[Any, Any]:
    """An ordered pair of numbers within [low, high]; a one-line ValueError for anything else."""
    pair = plain(value)
    ordered = (
        isinstance(pair, tuple)
        and len(pair) == 2
        and all(isinstance(end, Real) and not isinstance(end, bool) for end in pair)
        and low <= pair[0] <= pair[1] <= high
    )
    if not ordered:
        raise ValueError(f"{name} must be a pair (from, to) within [{low:g}, {high:g}], got {value!r}")
    return pair[0], pair[1]
