"""Episodes -> Records -> Scorecards: pure functions. A rate never comes without its interval."""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING

from cad_env.checks import ConfigError
from cad_env.files import parse_json, shortened
from cad_env.scoring.interval import Estimate, clustered_mean, wilson
from cad_env.scoring.time_lost import EXPERT, time_lost
from cad_env.types import OUTCOMES, STEP, SUCCESS

if TYPE_CHECKING:
    from cad_env.scoring.rollout import Episode

KINDS = ("all", "yes", "no")
MOST = 2**53  # of any number in a record but the seed: sums of them stay finite


@dataclass(frozen=True)
class Record:
    """One episode in one line of `episodes.jsonl`; the word None below is JSON's null.

    >>> rest = 9.5, 31, 283.5, 302, 380, 19, 107730, None, 0.1, 4, 5.9
    >>> parse_record(Record("left_turn", "expert", 7, True, "success", *rest).line()).bytes_per_message_max
    302
    >>> parse_record('{"scenario": "left_turn"}')
    Traceback (most recent call last):
    cad_env.checks.ConfigError: an episode's record must have the keys scenario, method, seed, hazard, outcome, time,
    brakes, bytes_per_message_mean, bytes_per_message_max, messages_sent, messages_lost, bytes_total, min_ttc,
    hazard_time, connected, hardest_brake, struck_from_behind
    """

    scenario: str
    method: str
    seed: int
    hazard: bool
    outcome: str
    time: float  # s until the outcome
    brakes: int  # decisions to brake
    bytes_per_message_mean: float | None  # over all connected vehicles, None if nothing was sent
    bytes_per_message_max: int | None  # of the largest
    messages_sent: int  # by all connected vehicles
    messages_lost: int  # on their way to the ego
    bytes_total: int  # sent by all connected vehicles
    min_ttc: float | None  # s, None if nothing was on a collision course
    hazard_time: float | None  # s after the start, when an ego that never brakes would be hit; None if it would not
    connected: int  # vehicles, the ego included
    hardest_brake: float  # m/s2, the largest mean deceleration of the ego over 0.5 s
    struck_from_behind: bool = False  # its collision was one with a vehicle that followed it
    condition: str | None = None  # named, under which it was driven; its line has it only then

    def __post_init__(self) -> None:
        for name, valid in self._fields_valid().items():
            if not valid:
                value = shortened(repr(getattr(self, name)))
                raise ConfigError(f"an episode's record cannot have {name} {value}")

    def _fields_valid(self) -> dict[str, bool]:
        counts = ("brakes", "messages_sent", "messages_lost", "bytes_total", "connected")
        return {
            "scenario": _is_text(self.scenario),
            "method": _is_text(self.method),
            "seed": type(self.seed) is int and self.seed >= 0,  # of any size
            **{name: is_count(getattr(self, name)) for name in counts},
            "hazard": isinstance(self.hazard, bool),
            "struck_from_behind": isinstance(self.struck_from_behind, bool),
            "condition": self.condition is None or _is_text(self.condition),
            "outcome": self.outcome in OUTCOMES,
            "time": _is_amount(self.time),
            "bytes_per_message_mean": self.bytes_per_message_mean is None or _is_amount(self.bytes_per_message_mean),
            "bytes_per_message_max": self.bytes_per_message_max is None or is_count(self.bytes_per_message_max),
            "min_ttc": self.min_ttc is None or _is_amount(self.min_ttc),
            "hazard_time": self.hazard_time is None or _is_amount(self.hazard_time),
            "hardest_brake": _is_amount(self.hardest_brake),
        }

    def line(self) -> str:
        """JSON in one line, without its end."""
        values = asdict(self)
        if self.condition is None:
            del values["condition"]
        return json.dumps(values, allow_nan=False)


def is_count(value: object) -> bool:
    """Whether a value is a whole number from 0 to `MOST`."""
    return type(value) is int and 0 <= value <= MOST


def _is_text(value: object) -> bool:
    """Whether it is text that can be written and drawn: no half of a pair of code units."""
    return isinstance(value, str) and not any("\ud800" <= letter <= "\udfff" for letter in value)


def _is_number(value: object) -> bool:
    return type(value) in (int, float) and -MOST <= value <= MOST  # type: ignore[operator]


def _is_amount(value: object) -> bool:
    return _is_number(value) and value >= 0.0  # type: ignore[operator]


_RECORD_KEYS = [field.name for field in fields(Record) if field.name != "condition"]


def record_of(episode: "Episode", condition: str | None = None) -> Record:
    """What is kept of an episode. condition: the name of the one under which it was driven."""
    messages = int(episode.messages_sent.sum())
    return Record(
        scenario=episode.scenario,
        method=episode.method,
        seed=episode.seed,
        hazard=episode.hazard,
        outcome=episode.outcome,
        time=round(episode.time, 6),
        brakes=episode.brakes,
        bytes_per_message_mean=round(episode.bytes_per_message, 3) if messages else None,
        bytes_per_message_max=int(episode.largest_message.max()) if messages else None,
        messages_sent=messages,
        messages_lost=int(episode.messages_lost.sum()),
        bytes_total=int(episode.bytes_sent.sum()),
        min_ttc=round(episode.min_ttc, 6) if episode.min_ttc < math.inf else None,
        hazard_time=None if math.isinf(episode.hazard_time) else round(episode.hazard_time, 6),
        connected=episode.connected,
        hardest_brake=round(episode.hardest_brake, 6),
        struck_from_behind=episode.struck_from_behind,
        condition=condition,
    )


def parse_record(line: str | bytes) -> Record:
    """The record in a line; ConfigError, one line, if it is anything but what `Record.line` writes."""
    values = parse_json(line)
    if not isinstance(values, dict) or set(values) - {"condition"} != set(_RECORD_KEYS):
        raise ConfigError(f"an episode's record must have the keys {', '.join(_RECORD_KEYS)}")
    return Record(**values)


@dataclass(frozen=True)
class Scorecard:
    """How a method did in a scenario under a condition: one row of the table. Rates are shares of `episodes`."""

    condition: str | None  # None: none was named
    scenario: str
    method: str
    hazard: str  # which episodes count: all, those with a hazard (yes), those without (no)
    episodes: int
    collisions: int
    collision_rate: float
    collision_low: float
    collision_high: float
    struck_from_behind: int  # collisions among them with a vehicle that followed it
    times_lost: int  # episodes with a time lost against the expert; 0 without the expert's episodes
    time_lost: float | None  # s after the expert on the same seed, mean (scoring/time_lost.py)
    time_lost_low: float | None
    time_lost_high: float | None
    time_lost_p90: float | None  # s, 90th percentile
    time_lost_p90_low: float | None
    time_lost_p90_high: float | None
    successes: int
    success_rate: float
    success_low: float
    success_high: float
    timeouts: int
    mean_time: float  # s until the outcome, over all episodes
    mean_time_success: float | None  # s, over the successes; without a hazard this is the calm time
    mean_time_success_low: float | None
    mean_time_success_high: float | None
    needless_brakes: float | None  # share of episodes in which it braked at all; only where there is no hazard
    needless_low: float | None
    needless_high: float | None
    bytes_per_message_mean: float | None  # over all messages of all episodes; None if none was sent
    bytes_per_message_max: int | None
    bytes_per_second: float  # by all connected vehicles together
    messages_sent: int
    messages_lost: int  # on their way to the ego
    min_ttc: float | None  # s, the smallest of all episodes


def scorecards(
    episodes: "Iterable[Record | Episode]", expert: "Iterable[Record | Episode] | None" = None
) -> list[Scorecard]:
    """Rows for all episodes, those with a hazard and those without, as far as there are any.

    Conditions, scenarios and methods come in the order of their first episode. Time lost is against the episodes of
    `expert` under the same condition; default: those among `episodes` whose method is "expert".

    >>> from cad_env import CADVectorEnv, rollouts, table
    >>> class Go:
    ...     privileged = False
    ...     def reset(self, seed): ...
    ...     def act(self, observation): return 0
    >>> envs = CADVectorEnv(1, scenario="left_turn", radio="none")
    >>> print(table(scorecards(rollouts(envs, Go(), range(1_000_000, 1_000_004), method="go"))))
    scenario   method  hazard  episodes   collision % [95 %] ...
    -------...
    left_turn  go      all            4  ...
    """
    groups: dict[_Group, list[Record]] = {}
    for record in map(_as_record, episodes):
        groups.setdefault((record.condition, record.scenario, record.method), []).append(record)
    experts: dict[_Group, list[Record]] = {} if expert is not None else groups
    for record in map(_as_record, expert or ()):
        experts.setdefault((record.condition, record.scenario, EXPERT), []).append(record)
    return [
        scorecard(kind, chosen, experts.get((condition, scenario, EXPERT), ()))
        for (condition, scenario, _), group in groups.items()
        for kind in KINDS
        if (chosen := [record for record in group if kind == "all" or record.hazard == (kind == "yes")])
    ]


def _as_record(episode: "Record | Episode") -> Record:
    return episode if isinstance(episode, Record) else record_of(episode)


def scorecard(kind: str, records: Sequence[Record], expert: Sequence[Record] = ()) -> Scorecard:
    """The row of records, at least one, of one condition, scenario and method; `expert`: whom time is lost against."""
    episodes = len(records)
    count = {outcome: sum(record.outcome == outcome for record in records) for outcome in OUTCOMES}
    collision, collision_low, collision_high = _rate(count["collision"], episodes)
    success, success_low, success_high = _rate(count["success"], episodes)
    braked = sum(record.brakes > 0 for record in records)
    needless: _Interval = _rate(braked, episodes) if kind == "no" else _NOTHING
    lost = time_lost(records, expert)
    mean_lost, high_lost = (_NOTHING, _NOTHING) if lost is None else (_parts(lost.mean), _parts(lost.high))
    messages = sum(record.messages_sent for record in records)
    total = sum(record.bytes_total for record in records)
    time = math.fsum(record.time for record in records)
    arrived = _mean([record.time for record in records if record.outcome == SUCCESS])
    return Scorecard(
        condition=records[0].condition,
        scenario=records[0].scenario,
        method=records[0].method,
        hazard=kind,
        episodes=episodes,
        collisions=count["collision"],
        collision_rate=collision,
        collision_low=collision_low,
        collision_high=collision_high,
        struck_from_behind=sum(record.struck_from_behind for record in records),
        times_lost=0 if lost is None else lost.times,
        time_lost=mean_lost[0],
        time_lost_low=mean_lost[1],
        time_lost_high=mean_lost[2],
        time_lost_p90=high_lost[0],
        time_lost_p90_low=high_lost[1],
        time_lost_p90_high=high_lost[2],
        successes=count["success"],
        success_rate=success,
        success_low=success_low,
        success_high=success_high,
        timeouts=count["timeout"],
        mean_time=time / episodes,
        mean_time_success=arrived[0],
        mean_time_success_low=arrived[1],
        mean_time_success_high=arrived[2],
        needless_brakes=needless[0],
        needless_low=needless[1],
        needless_high=needless[2],
        bytes_per_message_mean=total / messages if messages else None,
        bytes_per_message_max=max(
            (record.bytes_per_message_max for record in records if record.bytes_per_message_max), default=None
        ),
        bytes_per_second=total / time if time >= STEP else 0.0,
        messages_sent=messages,
        messages_lost=sum(record.messages_lost for record in records),
        min_ttc=min((record.min_ttc for record in records if record.min_ttc is not None), default=None),
    )


def _rate(count: int, of: int) -> tuple[float, float, float]:
    return (count / of, *wilson(count, of))


def _mean(values: Sequence[float]) -> "_Interval":
    """The mean of independent values with its interval."""
    return _parts(clustered_mean([[value] for value in values])) if values else _NOTHING


def _parts(estimate: Estimate) -> "_Interval":
    return estimate.value, estimate.low, estimate.high


_Group = tuple[str | None, str, str]  # condition, scenario, method
_Interval = tuple[float | None, float | None, float | None]
_NOTHING: _Interval = (None, None, None)
