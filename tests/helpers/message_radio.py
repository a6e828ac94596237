"""The radio for any messages, by plain rules: what the compiled one is compared with."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from cad_env.config import RadioConfig
from cad_env.numerics.philox import stream_key
from cad_env.pipeline.radio import ACCEPTED, REACHES, REASONS, fate_at, link_of, refusal
from cad_env.types import STEP, Floats


@dataclass(frozen=True)
class Message:
    """What the radio carries; its budget counts `len(payload)`."""

    sender: int
    sent_at: float  # s
    payload: bytes


@dataclass(frozen=True)
class SendResult:
    """What a sender learns: whether its message went out, why not, and its size in bytes."""

    accepted: bool
    reason: str | None
    size: int


class Radio:
    """The radio for any number of vehicles and messages.

    `count` holds: sent and refused messages; bytes sent; and, of the accepted messages times their receivers, how many
    were lost or out_of_range, are in_flight, or were delivered.

    >>> radio = Radio(RadioConfig(loss=0.0), seed=0)
    >>> radio.send(Message(sender=1, sent_at=0.0, payload=b"hello"), {1: (0.0, 0.0), 2: (30.0, 40.0)})
    SendResult(accepted=True, reason=None, size=5)
    >>> radio.deliver(receiver=2, now=0.0)
    [Message(sender=1, sent_at=0.0, payload=b'hello')]
    """

    def __init__(self, config: RadioConfig, seed: int) -> None:
        self.link = link_of(config)
        self.count: Counter[str] = Counter()
        self._key = stream_key(seed, "radio")
        self._slots: dict[int, tuple[int, int, int]] = {}  # sender -> its last slot, bytes and messages in it
        self._under_way: dict[int, list[tuple[int, Message]]] = {}  # receiver -> arrival steps and messages

    def send(self, message: Message, positions: Mapping[int, Floats | tuple[float, float]]) -> SendResult:
        """Broadcast to all others at `positions`, m, which holds the sender's own too; times must not run back."""
        if not isinstance(message.payload, bytes):
            raise TypeError(f"payload must be bytes, so that its size is what it costs; got {type(message.payload)}")
        if message.sender not in positions:
            raise ValueError(f"positions must say where sender {message.sender} is, got those of {list(positions)}")
        step, size = _step_at(message.sent_at), len(message.payload)
        slot, spent, number = self._slots.get(message.sender, (step, 0, 0))
        if step < slot:
            raise ValueError(f"sent_at {message.sent_at} s is before an earlier message of sender {message.sender}")
        if step > slot:
            spent, number = 0, 0
        fates = self._fates(message.sender, step, number, positions)  # whatever raises does so before anything counts
        reason = refusal(self.link.budget, spent, size)
        if reason != ACCEPTED:
            self.count["refused"] += 1
            return SendResult(False, REASONS[reason], size)
        self._slots[message.sender] = (step, spent + size, number + 1)
        self.count.update(sent=1, bytes=size)
        for receiver, outcome in fates.items():
            self.count[("", "in_flight", "lost", "out_of_range")[outcome]] += 1
            if outcome == REACHES:
                self._under_way.setdefault(receiver, []).append((step + self.link.delay, message))
        return SendResult(True, None, size)

    def _fates(
        self, sender: int, step: int, number: int, positions: Mapping[int, Floats | tuple[float, float]]
    ) -> dict[int, int]:
        """What becomes at every other vehicle of a sender's `number`-th message in a slot."""
        x, y = positions[sender]
        away = {other: math.hypot(there[0] - x, there[1] - y) for other, there in positions.items() if other != sender}
        return {
            other: fate_at(self.link, self._key, metres, step, sender, other, number) for other, metres in away.items()
        }

    def deliver(self, receiver: int, now: float) -> list[Message]:
        """What has arrived at `receiver` by `now`, s, and was not delivered before; by time sent, then sender."""
        waiting, step = self._under_way.pop(receiver, []), _step_at(now)
        arrived = [message for arrival, message in waiting if arrival <= step]
        self._under_way[receiver] = [item for item in waiting if item[0] > step]
        self.count.update(in_flight=-len(arrived), delivered=len(arrived))
        return sorted(arrived, key=lambda message: (message.sent_at, message.sender))


def _step_at(time: float) -> int:
    if not 0.0 <= time < 2**32 * STEP:
        raise ValueError(f"time must be from 0 to {2**32 * STEP:g} s, got {time!r}")
    return math.floor(time / STEP + 1e-6)  # 0.3 / 0.1 is 2.9999999999999996
