"""The radio: broadcasts under a byte budget, with loss, delay and range.

A sender has a budget of bytes in each slot of 100 ms. A message that does not fit into what is left of it is refused
whole and says why; nothing is ever cut. What becomes of an accepted message is settled when it is sent, for each
receiver by itself: out of range then, lost, or on its way for `delay` steps. The chance of a loss is a function of
(step, sender, receiver, number of the message in its slot): another vehicle, receiver or message moves no other loss.

With a `burst` above 1, losses come in runs: each directed link is a Gilbert-Elliott channel, good or bad for a whole
slot, from good to bad with probability loss / (burst (1 - loss)) and back with 1 / burst, stationary from step 0 on.
Such a chain is the same as one that is drawn anew, bad with probability `loss`, in a slot with probability
1 / (burst (1 - loss)), and left alone otherwise: so its state is found by looking back for the last draw, and needs no
memory. (Gilbert, "Capacity of a burst-noise channel", Bell System Technical Journal 39, 1960.)

`Air` with `send`, `fate` and `fetch` is this for the compiled step, where a vehicle sends at most one message a step;
points and graphs by rules from outside go through Python. All keep to `refusal` and `fate_at`.
"""

import math
from typing import NamedTuple

import numpy as np

from cad_env.config import RadioConfig
from cad_env.numerics.jit import compiled
from cad_env.numerics.philox import uniform
from cad_env.types import STEP, Bools, Bytes, Floats, Ints

STEP_MS = round(1000 * STEP)
CLOCK_MS = STEP_MS // 2  # by which the time in a message may differ from that of its sending

# What `send` answers.
ACCEPTED, NO_BUDGET, OVER_BUDGET, TOO_LONG, SECOND_MESSAGE = 0, 1, 2, 3, 4
SILENT = -1  # its sender chose to send nothing
REASONS = (
    "accepted",
    "this radio has no budget",
    "over the byte budget of its slot",
    "longer than a message can be",
    "a second message in one step",
)

# What becomes of a message at one receiver.
NOT_SENT, REACHES, LOST, OUT_OF_RANGE = 0, 1, 2, 3


class Link(NamedTuple):
    """What a compiled function needs of a RadioConfig."""

    budget: float  # bytes of one sender in one slot
    loss: float  # probability
    range: float  # m
    delay: int  # steps
    renewal: float  # probability that the channel of a directed link is drawn anew in a slot; 1: losses are independent


class Air(NamedTuple):
    """What V vehicles sent in the last D = delay + 1 steps: a ring with slot `step % D`."""

    step: Ints  # (D, V) int64 in which the vehicle called `send`; -1 before the first
    place: Floats  # (D, V, 2) m, where it was then
    on_air: Bools  # (D, V) whether its message was accepted
    length: Ints  # (D, V) int64 bytes of the message
    payload: Bytes  # (D, V, B)


def link_of(config: RadioConfig) -> Link:
    """The numbers of a RadioConfig."""
    renewal = 1.0 if config.burst == 1.0 else 1.0 / (config.burst * (1.0 - config.loss))
    return Link(float(config.budget), float(config.loss), float(config.range), config.delay_steps, renewal)


def empty_air(vehicles: int, link: Link, capacity: int) -> Air:
    """Air in which nothing is under way, for messages of up to `capacity` bytes."""
    ring = (link.delay + 1, vehicles)
    return Air(
        step=np.full(ring, -1, np.int64),
        place=np.zeros((*ring, 2)),
        on_air=np.zeros(ring, np.bool_),
        length=np.zeros(ring, np.int64),
        payload=np.zeros((*ring, capacity), np.uint8),
    )


@compiled
def refusal(budget: float, spent: int, size: int) -> int:
    """ACCEPTED, or why a message of `size` bytes is refused after its sender spent so many in this slot."""
    if budget <= 0.0:
        return NO_BUDGET  # not even an empty message: it would tell that its sender exists
    return OVER_BUDGET if spent + size > budget else ACCEPTED


@compiled
def channel_is_bad(link: Link, key: Ints, step: int, sender: int, receiver: int) -> bool:
    """True in a slot in which the bursty channel from sender to receiver loses everything."""
    for back in range(step + 1):
        chance = uniform(key, step - back, sender, receiver, 0)
        if step == back:
            return bool(chance < link.loss)  # stationary at the start
        if chance < link.renewal:
            return bool(chance < link.renewal * link.loss)
    return False


@compiled
def fate_at(link: Link, key: Ints, distance: float, step: int, sender: int, receiver: int, number: int) -> int:
    """REACHES, LOST or OUT_OF_RANGE, for the `number`-th message, from 0, of a sender in a slot."""
    # Written as a negation, an unknown distance (NaN) is out of range too.
    if not distance <= link.range:
        return OUT_OF_RANGE
    if link.renewal < 1.0:
        lost = channel_is_bad(link, key, step, sender, receiver)
    else:
        lost = uniform(key, step, sender, receiver, number) < link.loss
    return LOST if lost else REACHES


@compiled
def is_as_sent(sender: int, time_ms: int, transmitter: int, step: int) -> bool:
    """Whether what a message says of itself is true: the radio knows who sent it, and in which step."""
    return sender == transmitter and abs(time_ms - STEP_MS * step) <= CLOCK_MS


@compiled
def send(air: Air, link: Link, step: int, sender: int, buffer: Bytes, length: int, x: float, y: float) -> int:
    """Broadcast buffer[:length] from (x, y) m in decision step `step` >= 0; answers ACCEPTED or why it is refused.

    All vehicles call this in every step, for it also tells the radio where they are as receivers.
    """
    slot = step % air.step.shape[0]
    if air.step[slot, sender] == step and air.on_air[slot, sender]:
        return SECOND_MESSAGE
    reason = TOO_LONG if length > air.payload.shape[2] else refusal(link.budget, 0, length)
    air.step[slot, sender], air.on_air[slot, sender] = step, reason == ACCEPTED
    air.place[slot, sender, 0], air.place[slot, sender, 1] = x, y
    if reason == ACCEPTED:
        air.length[slot, sender] = length
        for index in range(length):
            air.payload[slot, sender, index] = buffer[index]
    return reason


@compiled
def fate(air: Air, link: Link, key: Ints, step: int, sender: int, receiver: int) -> int:
    """What becomes, in this step, at `receiver`, of the message that `sender` sent `delay` steps ago.

    `key` is that of the stream "radio". Asking again gives the same answer.
    """
    sent = step - link.delay
    slot = sent % air.step.shape[0]
    if sent < 0 or air.step[slot, sender] != sent or not air.on_air[slot, sender] or sender == receiver:
        return NOT_SENT
    if air.step[slot, receiver] != sent:
        return OUT_OF_RANGE  # it was not there
    here, there = air.place[slot, sender], air.place[slot, receiver]
    return fate_at(link, key, math.hypot(there[0] - here[0], there[1] - here[1]), sent, sender, receiver, 0)


@compiled
def fetch(air: Air, link: Link, step: int, sender: int, buffer: Bytes) -> int:
    """Copy the message that arrives from `sender` in this step, wherever it does; answers its length, or -1 for none.

    It is the same for all receivers: read it once and then ask each one's `fate`.
    """
    sent = step - link.delay
    slot = sent % air.step.shape[0]
    if sent < 0 or air.step[slot, sender] != sent or not air.on_air[slot, sender]:
        return -1
    length = air.length[slot, sender]
    for index in range(length):
        buffer[index] = air.payload[slot, sender, index]
    return int(length)
