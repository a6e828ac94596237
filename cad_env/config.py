"""The knobs of sensing and sharing: frozen, with units, and checked when they are made."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from numbers import Real
from types import MappingProxyType
from typing import Any, TypeVar

from cad_env.checks import ConfigError as ConfigError  # packages from outside take these two from here
from cad_env.checks import check_numbers, did_you_mean, settle
from cad_env.checks import check_range as check_range
from cad_env.types import FRAMES, STEP

Config = TypeVar("Config", bound=type)


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

    def __post_init__(self) -> None:
        limits = {
            "range": (1.0, 500.0), "noise": (0.0, 10.0), "miss": (0.0, 1.0),
            "gnss_noise": (0.0, 50.0), "gnss_yaw_noise": (0.0, math.pi),
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
    if isinstance(radio, RadioConfig):
        return radio
    if not isinstance(radio, str) or radio not in RADIO_PRESETS:
        choices = f"choose one of {', '.join(RADIO_PRESETS)} or give a RadioConfig"
        raise ConfigError(f"unknown radio {radio!r}: {choices}{did_you_mean(radio, RADIO_PRESETS)}")
    return RADIO_PRESETS[radio]
