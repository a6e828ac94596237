"""The knobs of sensing and sharing: frozen, with units, and checked when they are made."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from types import MappingProxyType

from cad_env.types import FRAMES, STEP


class ConfigError(ValueError):
    """A setting, an argument or a file that cannot be used; its message is one line."""


def did_you_mean(given: object, choices: Iterable[str]) -> str:
    """The end of a message about a name that is none of the choices: the nearest of them; empty if none is near.

    >>> did_you_mean("cv2v", ["dsrc", "cv2x"])
    '; did you mean cv2x?'
    """
    known = {name.casefold(): name for name in choices}
    # Longer names than any real one are cut: the time that the comparison takes grows with the square of their length.
    near = get_close_matches(given[:100].casefold(), known, 1) if isinstance(given, str) else []
    return f"; did you mean {known[near[0]]}?" if near else ""


def check_range(name: str, value: object, low: float, high: float) -> None:
    """Refuse a value that is not a number in [low, high] with a one-line ValueError that names it."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{name} must be a number from {low:g} to {high:g}, got {value!r}")


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
        check_range("sensor range", self.range, 1.0, 500.0)
        check_range("sensor noise", self.noise, 0.0, 10.0)
        check_range("sensor miss", self.miss, 0.0, 1.0)
        check_range("sensor gnss_noise", self.gnss_noise, 0.0, 50.0)
        check_range("sensor gnss_yaw_noise", self.gnss_yaw_noise, 0.0, math.pi)


@dataclass(frozen=True)
class RadioConfig:
    """What a broadcast may cost and what may happen to it on the way."""

    rate: float = 2e6  # bit/s each sender may use; the budget of a 100 ms slot follows from it
    loss: float = 0.05  # probability that one receiver misses one message
    delay: float = 0.0  # s, rounded up to whole decision steps
    range: float = 150.0  # m between sender and receiver (the paper's threshold)
    burst: float = 1.0  # mean slots in a row that a receiver misses of a sender; 1: each is lost by itself

    def __post_init__(self) -> None:
        if self.rate != math.inf:
            check_range("radio rate", self.rate, 0.0, 1e12)
        check_range("radio loss", self.loss, 0.0, 1.0)
        check_range("radio delay", self.delay, 0.0, (FRAMES - 1) * STEP)
        if self.range != math.inf:
            check_range("radio range", self.range, 0.0, 1e6)
        check_range("radio burst", self.burst, 1.0, 1e4)
        if self.burst > 1.0 and self.burst * (1.0 - self.loss) < 1.0:
            # Losses that are independent already come in runs of 1 / (1 - loss).
            raise ValueError(
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


def check_names(what: str, given: dict[str, object], allowed: list[str]) -> None:
    """Refuse a misspelt key with a one-line ValueError that names it, its value and what is allowed."""
    for name, value in given.items():
        if name not in allowed:
            choices = f"choose among {', '.join(sorted(allowed))}{did_you_mean(name, allowed)}"
            raise ConfigError(f"unknown {what} {name}={value!r}: {choices}")
