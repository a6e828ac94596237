"""Conditions: named settings of an environment, under which methods are scored and networks can learn.

A condition says how much is on the road, who is connected, and what the radio does to messages. It always says all of
it: what is not written is the default, so that a name means the same wherever it is printed.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any

from cad_env.checks import ConfigError, check_numbers, check_text, did_you_mean, settle
from cad_env.config import PoseConfig, RadioConfig, SensorConfig, knows_its_names, pose_config
from cad_env.scenarios.ranges import Traffic

EVERY_CONDITION = "all"  # the word for all of CONDITIONS
WITNESS = "a witness is always connected"
NOBODY = "nobody but the ego is connected"
_WORDS = ("name", "reason")  # fields that change nothing about an episode
_RADIO = ("loss", "burst", "delay")
_SENSOR = ("false_alarm", "partial", "class_error")
_RARE = ("pose", *_SENSOR)  # fields that are named among the settings only where they are set


@knows_its_names("condition setting")
@dataclass(frozen=True)
class Condition:
    """A named set of environment settings.

    >>> Condition("fog", "what bad weather does", loss=0.3, collaborators=2).words
    'light traffic; a witness is always connected, 2 collaborators in all; 30 % of the messages lost'
    """

    name: str
    reason: str  # why it is of interest, in some words
    traffic: str = "light"  # none, light or dense
    penetration: float | None = None  # probability that a vehicle is connected; None: as many as `collaborators`
    collaborators: int | None = None  # connected vehicles besides the ego, a witness first; None: two to four
    loss: float | None = None  # probability that a message is missed; None: the radio's own
    burst: float | None = None  # mean slots in a row that are missed of a sender; None: the radio's own
    delay: float | None = None  # s until a message arrives; None: the radio's own
    pose: str | None = None  # what vehicles know of where they are, one of POSE_PRESETS; None: all of it
    false_alarm: float | None = None  # of a SensorConfig, as the next two; None: the sensor's own
    partial: float | None = None
    class_error: float | None = None

    def __post_init__(self) -> None:
        for each in _WORDS:
            check_text(f"condition {each}", getattr(self, each))
        check_numbers(self, "", {"collaborators": (0, 20), "penetration": (0.0, 1.0)})
        Traffic(self.traffic, self.penetration)
        if self.penetration is not None and self.collaborators is not None:
            raise ConfigError(
                f"penetration draws each connected vehicle by itself: leave out collaborators, got {self.collaborators}"
            )
        radio, sensor = self.radio(RadioConfig()), self.sensor(SensorConfig())
        for each in (*_RADIO, *_SENSOR):
            if getattr(self, each) is not None:
                settle(self, each, getattr(radio if each in _RADIO else sensor, each))
        if self.pose is not None:
            pose_config(check_text("condition pose", self.pose))

    def radio(self, usual: RadioConfig) -> RadioConfig:
        """A radio with this loss, burst and delay, as far as the condition names them."""
        return replace(usual, **self._named(_RADIO))

    def sensor(self, usual: SensorConfig) -> SensorConfig:
        """A sensor with these errors, as far as the condition names them."""
        return replace(usual, **self._named(_SENSOR))

    def _named(self, names: Iterable[str]) -> dict[str, Any]:
        """Those of these settings that the condition names."""
        return {each: getattr(self, each) for each in names if getattr(self, each) is not None}

    def options(self, radio: RadioConfig, sensor: SensorConfig | None = None) -> dict[str, Any]:
        """The options of an environment (`CADEnv`, `setup_from`) that this condition decides, over radio and sensor."""
        return {
            "sensor": self.sensor(sensor or SensorConfig()),
            "pose": PoseConfig() if self.pose is None else pose_config(self.pose),
            "traffic": self.traffic,
            "penetration": self.penetration,
            "ranges": {} if self.collaborators is None else {"collaborators": (self.collaborators,) * 2},
            "radio": self.radio(radio),
        }

    @property
    def has_witness(self) -> bool:
        """Whether a witness of the hidden lane is connected in every episode."""
        return self.penetration is None and self.collaborators != 0

    @property
    def settings(self) -> dict[str, Any]:
        """All that moves an episode, by name."""
        said = {name: value for name, value in asdict(self).items() if name not in _WORDS}
        return {name: value for name, value in said.items() if value is not None or name not in _RARE}

    @property
    def words(self) -> str:
        """All of it in words: traffic; who is connected; what is not the radio's own."""
        traffic = f"{'no' if self.traffic == 'none' else self.traffic} traffic"
        return "; ".join([traffic, self._connected(), *self._on_the_way(), *self._sensed()])

    def _connected(self) -> str:
        if 0 in (self.penetration, self.collaborators):
            return NOBODY
        if self.penetration is not None:
            return f"each vehicle connected by itself with probability {self.penetration:g}"
        if self.collaborators is None:
            return WITNESS
        return f"{WITNESS}, {self.collaborators} collaborator{'s' if self.collaborators > 1 else ''} in all"

    def _on_the_way(self) -> Iterable[str]:
        if self.loss is not None:
            yield f"{100 * self.loss:g} % of the messages lost"
        if self.burst is not None:
            yield f"losses in runs of {self.burst:g}"
        if self.delay is not None:
            yield f"messages {self.delay:g} s late"

    def _sensed(self) -> Iterable[str]:
        if self.pose is not None:
            yield f"positions: {self.pose}"
        if self.false_alarm is not None:
            yield f"false alarms at {100 * self.false_alarm:g} % of what is seen"
        if self.partial is not None:
            yield f"detections {100 * self.partial:g} % drawn to what is seen of a vehicle"
        if self.class_error is not None:
            yield f"{100 * self.class_error:g} % of the classes wrong"


CONDITIONS: Mapping[str, Condition] = MappingProxyType(
    {
        each.name: each
        for each in (
            Condition("nominal", "the default of every scenario, and the favourable case"),
            Condition("alone", "silence must not be taken for an empty road", penetration=0.0),
            Condition("penetration-05", "the first connected vehicles on the market", penetration=0.05),
            Condition("penetration-10", "most hidden lanes have no witness", penetration=0.1),
            Condition("penetration-25", "a witness now and then", penetration=0.25),
            Condition("penetration-50", "every other vehicle sends", penetration=0.5),
            Condition("penetration-100", "all that can be known is sent", penetration=1.0),
            Condition("loss-40", "a crowded channel", loss=0.4),
            Condition("loss-70", "a channel that hardly works", loss=0.7),
            Condition("bursts-40", "a sender is gone for half a second at a time", loss=0.4, burst=5.0),
            Condition("delay-300", "relayed messages", delay=0.3),
            Condition("delay-500", "messages over a slow network", delay=0.5),
            Condition("one-collaborator", "everything hangs on one sender, the witness", collaborators=1),
            Condition("dense", "more vehicles that hide each other, and more that send", traffic="dense"),
            Condition("dense-penetration-10", "a busy road with few that send", traffic="dense", penetration=0.1),
            Condition("gnss-white-1m", "fixes 1 m and 1 degree off, anew in every frame", pose="white"),
            Condition("gnss-standard", "a receiver without corrections, in the open", pose="standard"),
            Condition("gnss-urban", "a receiver between houses, with outages", pose="urban"),
            Condition("gnss-denied", "no fix at all", pose="denied"),
            Condition("false-alarms", "vehicles that are not there", false_alarm=0.1),
            Condition("partial-views", "a vehicle of which a part is seen is not where it seems", partial=1.0),
            Condition(
                "urban-everything",
                "all of it at once",
                penetration=0.5,
                loss=0.2,
                delay=0.2,
                pose="urban",
                false_alarm=0.1,
            ),
        )
    }
)


def condition_named(name: str) -> Condition:
    """The condition of this name; ConfigError, one line, with the choices and the nearest one.

    >>> condition_named("penetration-5")
    Traceback (most recent call last):
    ...
    cad_env.checks.ConfigError: unknown condition 'penetration-5': choose among nominal, alone, ...;
    did you mean penetration-50?
    """
    if name not in CONDITIONS:
        near = did_you_mean(name, [*CONDITIONS, EVERY_CONDITION])
        raise ConfigError(
            f"unknown condition {name!r}: choose among {', '.join(CONDITIONS)} or {EVERY_CONDITION}{near}"
        )
    return CONDITIONS[name]
