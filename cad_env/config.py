"""The knobs of sensing and sharing: frozen, with units, and checked when they are made."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import wraps
from numbers import Real
from types import MappingProxyType
from typing import Any, TypeVar

from cad_env.checks import ConfigError as ConfigError  # packages from outside take these two from here
from cad_env.checks import check_numbers, check_switch, did_you_mean, settle
from cad_env.checks import check_range as check_range
from cad_env.types import FRAMES, STEP

Config = TypeVar("Config", bound=type)
_Record = TypeVar("_Record")


class UnknownNameError(ConfigError, TypeError):
    """A name that does not exist: a wrong value, as what users get wrong is here, and also an unexpected keyword.

    Libraries that hand over more than an environment may take (TorchRL's GymEnv, Gymnasium) try without a keyword
    when a TypeError names it as unexpected.
    """


def check_names(what: str, given: dict[str, object], allowed: list[str]) -> None:
    """Refuse a misspelt key with a one-line UnknownNameError that has it, its value and what is allowed."""
    for name, value in given.items():
        if name not in allowed:
            raise UnknownNameError(_unknown(what, name, value, allowed) + did_you_mean(name, allowed))


def check_keywords(given: dict[str, object], allowed: list[str]) -> None:
    """Refuse a keyword argument as `check_names` does, and in the words of Python that libraries look for.

    >>> check_keywords({"frameskip": 1}, ["radio", "depth"])
    Traceback (most recent call last):
    cad_env.config.UnknownNameError: unknown option frameskip=1: choose among depth, radio
    (__init__() got an unexpected keyword argument 'frameskip')
    """
    for name, value in given.items():
        if name not in allowed:
            said = (
                f"{_unknown('option', name, value, allowed)} (__init__() got an unexpected keyword argument {name!r})"
            )
            raise UnknownNameError(said + did_you_mean(name, allowed))


def _unknown(what: str, name: str, value: object, allowed: list[str]) -> str:
    return f"unknown {what} {name}={value!r}: choose among {', '.join(sorted(allowed))}"


def knows_its_names(what: str) -> Callable[[Config], Config]:
    """A decorator of dataclasses that refuse a misspelt keyword as `check_names` does."""

    def knowing(kind: Config) -> Config:
        made: Any = kind.__dict__["__init__"]
        names = [field.name for field in fields(kind)]

        @wraps(made)
        def make(self: Any, *values: Any, **given: Any) -> None:
            check_names(what, given, names)
            made(self, *values, **given)

        setattr(kind, "__init__", make)  # noqa: B010  mypy refuses it as an assignment
        return kind

    return knowing


@knows_its_names("sensor setting")
@dataclass(frozen=True)
class SensorConfig:
    """What a connected vehicle's sensors and its GNSS can do."""

    # 80 m is what automotive lidar resolves a car at with a few points; the 150 m of the radio reach further.
    range: float = 80.0  # m, centre of the sensor to a point of the target
    noise: float = 0.2  # m, standard deviation of each coordinate of a detection
    miss: float = 0.05  # probability that a visible object is not reported in a frame
    gnss_noise: float = 0.0  # m, standard deviation of a vehicle's own position fix
    gnss_yaw_noise: float = 0.0  # rad, standard deviation of its heading fix
    false_alarm: float = 0.0  # probability that a visible object gives a second detection, at a corner of its box
    partial: float = 0.0  # by how much a detection is drawn to the middle of what is seen of an object, a share
    class_error: float = 0.0  # probability that a detection is of the wrong class

    def __post_init__(self) -> None:
        limits = {
            "range": (1.0, 500.0), "noise": (0.0, 10.0), "miss": (0.0, 1.0),
            "gnss_noise": (0.0, 50.0), "gnss_yaw_noise": (0.0, math.pi), "false_alarm": (0.0, 1.0),
            "partial": (0.0, 1.0), "class_error": (0.0, 1.0),
        }  # fmt: skip
        check_numbers(self, "sensor", limits)


@knows_its_names("radio setting")
@dataclass(frozen=True)
class RadioConfig:
    """What a broadcast may cost and what may happen to it on the way."""

    rate: float = 2e6  # bit/s each sender may use; the budget of a 100 ms slot follows from it
    loss: float = 0.05  # probability that one receiver misses one message
    delay: float = 0.0  # s, rounded up to whole decision steps
    range: float = 150.0  # m between sender and receiver (the paper's threshold)
    burst: float = 1.0  # mean slots in a row that a receiver misses of a sender; 1: each is lost by itself

    def __post_init__(self) -> None:
        limits = {"loss": (0.0, 1.0), "delay": (0.0, (FRAMES - 1) * STEP), "burst": (1.0, 1e4)}
        check_numbers(self, "radio", limits)
        for name, most in (("rate", 1e12), ("range", 1e6)):
            if _is_unlimited(getattr(self, name)):
                settle(self, name, math.inf)
            else:
                check_numbers(self, "radio", {name: (0.0, most)})
        if self.burst > 1.0 and self.burst * (1.0 - self.loss) < 1.0:
            # Losses that are independent already come in runs of 1 / (1 - loss).
            raise ConfigError(
                f"radio burst must be 1 or at least 1 / (1 - loss), got {self.burst!r} at loss {self.loss!r}"
            )

    @property
    def budget(self) -> float:
        """Bytes that one sender may put on the air in one 100 ms slot.

        >>> RadioConfig(rate=2e6).budget
        25000.0
        """
        return self.rate * STEP / 8.0

    @property
    def delay_steps(self) -> int:
        """Whole decision steps between sending and arrival."""
        return math.ceil(round(self.delay / STEP, 6))


def _is_unlimited(value: Any) -> bool:
    return isinstance(value, Real) and value == math.inf


# The paper's Table I. It prints 200 KB and 720 KB a slot, which are kilobits: 2 Mbit/s x 0.1 s = 25,000 bytes.
RADIO_PRESETS = MappingProxyType(
    {
        "none": RadioConfig(rate=0.0, loss=0.0),
        "ideal": RadioConfig(rate=math.inf, loss=0.0, range=math.inf),
        "dsrc": RadioConfig(rate=2e6),
        "cv2x": RadioConfig(rate=7.2e6),
    }
)


def radio_config(radio: str | RadioConfig) -> RadioConfig:
    """A preset by name, or the given configuration as it is."""
    return _preset("radio", radio, RadioConfig, RADIO_PRESETS)


def _preset(what: str, given: Any, kind: type[_Record], presets: Mapping[str, _Record]) -> _Record:
    if isinstance(given, kind):
        return given
    if not isinstance(given, str) or given not in presets:
        choices = f"choose one of {', '.join(presets)} or give a {kind.__name__}"
        raise ConfigError(f"unknown {what} {given!r}: {choices}{did_you_mean(given, presets)}")
    return presets[given]


PLACINGS = ("fixes", "nearest", "single", "registered")  # how a receiver places what a sender says


@knows_its_names("pose setting")
@dataclass(frozen=True)
class PoseConfig:
    """How well a vehicle knows how it has moved (odometry) and where it is (GNSS), and how it places what others say.

    GNSS errors of a position are of each axis. A bias drifts: a first-order Gauss-Markov process with a time constant,
    stationary from the start (Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems",
    2013, sections 9 and 14). Outages are a two-state chain. Odometry errors are drawn once a vehicle and episode.
    Without any error positions are exact, and everything is in the frame of the world.
    """

    bias: float = 0.0  # m, standard deviation of the slow error of a position fix
    yaw_bias: float = 0.0  # rad, standard deviation of the slow error of a heading fix
    bias_time: float = 30.0  # s, time constant of both
    noise: float = 0.0  # m, standard deviation of the error of a position fix that is new in every frame
    yaw_noise: float = 0.0  # rad, the same of a heading fix
    outage: float = 0.0  # share of the time in which there is no fix
    outage_time: float = 5.0  # s, mean length of an outage
    denied: bool = False  # there never is a fix
    start: float = 0.0  # m, standard deviation of where a vehicle without a fix takes itself to be along its way
    scale: float = 0.0  # of the way, standard deviation of the error of the wheels' scale
    yaw_rate: float = 0.0  # rad/s, standard deviation of the bias of the gyro
    placing: str = "registered"  # one of PLACINGS

    def __post_init__(self) -> None:
        limits = {
            "bias": (0.0, 50.0), "yaw_bias": (0.0, math.pi), "bias_time": (STEP, 1e4), "noise": (0.0, 50.0),
            "yaw_noise": (0.0, math.pi), "outage": (0.0, 0.99), "outage_time": (STEP, 1e3), "start": (0.0, 50.0),
            "scale": (0.0, 0.2), "yaw_rate": (0.0, 0.1),
        }  # fmt: skip
        check_numbers(self, "pose", limits)
        settle(self, "denied", check_switch("pose denied", self.denied))
        if not isinstance(self.placing, str) or self.placing not in PLACINGS:
            near = did_you_mean(self.placing, PLACINGS)
            raise ConfigError(f"pose placing must be one of {', '.join(PLACINGS)}, got {self.placing!r}{near}")

    @property
    def exact(self) -> bool:
        """Whether nothing about a pose is ever wrong."""
        errors = (self.bias, self.yaw_bias, self.noise, self.yaw_noise, self.outage, self.scale, self.yaw_rate)
        return not self.denied and not any(errors)


# Wheels are scaled to about 1 %, and a calibrated MEMS gyro drifts by less than 0.1 degree/s (Groves 2013, sections 4
# and 6).
_MOVES = PoseConfig(scale=0.01, yaw_rate=math.radians(0.05))
# Orders of magnitude, in the open and between houses: data sheets of receivers say 0.01 m with corrections and 1.5 m
# (half of the fixes, u-blox F9 and M10) without, and 0.3 degrees of a moving heading; multipath between houses is worse
# and comes and goes with them (Groves 2013, section 10). "white": as much of either, but new in every frame.
POSE_PRESETS = MappingProxyType(
    {
        "exact": PoseConfig(),
        "rtk": replace(_MOVES, bias=0.02, yaw_bias=math.radians(0.2), noise=0.01, yaw_noise=math.radians(0.1)),
        "white": replace(_MOVES, noise=1.0, yaw_noise=math.radians(1.0)),
        "standard": replace(
            _MOVES, bias=1.0, yaw_bias=math.radians(0.5), noise=0.2, yaw_noise=math.radians(0.2), start=1.0
        ),
        "urban": replace(
            _MOVES, bias=2.0, yaw_bias=math.radians(2.0), bias_time=15.0, noise=0.5, yaw_noise=math.radians(0.5),
            outage=0.2, outage_time=5.0, start=1.0,
        ),
        "denied": replace(_MOVES, denied=True, start=1.0),
    }
)  # fmt: skip


def pose_config(pose: str | PoseConfig) -> PoseConfig:
    """A preset by name, or the given configuration as it is."""
    return _preset("pose", pose, PoseConfig, POSE_PRESETS)
