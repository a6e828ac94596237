"""The radio: what a broadcast may cost, and what may happen to it on the way."""

import math
from collections.abc import Sequence
from itertools import groupby, permutations, product

import numpy as np
import pytest
from message_radio import Message, Radio

from cad_env.config import RADIO_PRESETS, RadioConfig
from cad_env.numerics.philox import stream_key, uniform
from cad_env.pipeline.radio import (
    ACCEPTED,
    LOST,
    NO_BUDGET,
    NOT_SENT,
    OUT_OF_RANGE,
    REACHES,
    REASONS,
    SECOND_MESSAGE,
    TOO_LONG,
    empty_air,
    fate,
    fate_at,
    fetch,
    link_of,
    send,
)

NEAR = {i: (10.0 * i, 0.0) for i in range(4)}
CLEAR = RadioConfig(loss=0.0)


def say(payload: bytes, sender: int = 0, step: int = 0) -> Message:
    return Message(sender, step * 0.1, payload)


@pytest.mark.parametrize(("preset", "budget"), [("dsrc", 25_000), ("cv2x", 90_000)])
def test_a_slot_holds_the_budget_and_not_a_byte_more(preset: str, budget: int):
    radio = Radio(RADIO_PRESETS[preset], seed=0)
    assert radio.send(say(bytes(budget)), NEAR).accepted
    assert not radio.send(say(bytes(budget + 1), step=1), NEAR).accepted
    assert radio.count["bytes"] == budget


def test_a_refused_message_reaches_nobody_and_says_why():
    radio = Radio(CLEAR, seed=0)
    result = radio.send(say(bytes(25_001)), NEAR)
    assert (result.accepted, result.reason, result.size) == (False, "over the byte budget of its slot", 25_001)
    assert radio.deliver(1, now=0.0) == []
    assert radio.count["refused"] == 1
    assert radio.count["sent"] == 0


def test_messages_of_one_slot_share_its_budget():
    radio = Radio(CLEAR, seed=0)
    assert radio.send(say(bytes(20_000)), NEAR).accepted
    assert not radio.send(say(bytes(5_001)), NEAR).accepted
    assert radio.send(say(bytes(5_000)), NEAR).accepted
    assert radio.send(say(bytes(25_000), sender=1), NEAR).accepted  # another sender has its own
    assert radio.send(say(bytes(25_000), step=1), NEAR).accepted  # and so has the next slot


@pytest.mark.parametrize("payload", [b"", b"x"])
def test_without_a_budget_nothing_is_sent_not_even_nothing(payload: bytes):
    result = Radio(RADIO_PRESETS["none"], seed=0).send(say(payload), NEAR)
    assert not result.accepted
    assert result.reason == REASONS[NO_BUDGET]


def test_an_unlimited_budget_takes_any_message():
    assert Radio(RADIO_PRESETS["ideal"], seed=0).send(say(bytes(10_000_000)), NEAR).accepted


def test_losses_come_at_their_rate():
    sent, loss = 20_000, 0.05
    radio = Radio(RadioConfig(loss=loss), seed=1)
    for step in range(sent):
        radio.send(say(b"x", step=step), {0: (0.0, 0.0), 1: (1.0, 0.0)})
    assert abs(radio.count["lost"] / sent - loss) < 4 * math.sqrt(loss * (1 - loss) / sent)


def runs_of(lost: Sequence[bool]) -> list[int]:
    """The lengths of the runs of losses."""
    return [len(list(run)) for missed, run in groupby(lost) if missed]


def losses(config: RadioConfig, seed: int, steps: int) -> list[bool]:
    """Of each step, whether the message from 0 to 1 is lost."""
    link, key = link_of(config), stream_key(seed, "radio")
    return [fate_at(link, key, 1.0, step, 0, 1, 0) == LOST for step in range(steps)]


@pytest.mark.parametrize(("loss", "burst"), [(0.05, 3.5), (0.2, 5.0), (0.5, 2.0), (0.3, 12.0)])
def test_bursty_losses_come_at_their_rate_and_in_runs_of_their_length(loss: float, burst: float):
    steps = 60_000
    lost = losses(RadioConfig(loss=loss, burst=burst), 3, steps)
    kept = 1 - 1 / (burst * (1 - loss))  # correlation from one slot to the next
    error = math.sqrt(loss * (1 - loss) / steps * (1 + kept) / (1 - kept))
    assert abs(np.mean(lost) - loss) < 4 * error
    runs = runs_of(lost)  # geometric
    assert abs(np.mean(runs) - burst) < 4 * math.sqrt(burst * (burst - 1) / len(runs))


def test_bursty_losses_are_at_their_rate_from_the_first_step_on():
    loss, seeds = 0.3, 4000
    first = [losses(RadioConfig(loss=loss, burst=10.0), seed, 2) for seed in range(seeds)]
    for step in range(2):
        share = np.mean([lost[step] for lost in first])
        assert abs(share - loss) < 4 * math.sqrt(loss * (1 - loss) / seeds)


def test_without_bursts_a_loss_is_one_draw_of_its_own_link_slot_and_message():
    config, key = RadioConfig(loss=0.4, burst=1.0), stream_key(3, "radio")
    for step, sender, receiver, number in product(range(20), range(3), range(3), range(3)):
        lost = fate_at(link_of(config), key, 1.0, step, sender, receiver, number) == LOST
        assert lost == (uniform(key, step, sender, receiver, number) < 0.4)


def test_in_a_bursty_slot_all_messages_of_a_link_share_their_fate_and_links_differ():
    link, key = link_of(RadioConfig(loss=0.5, burst=4.0)), stream_key(3, "radio")

    def fates(sender: int, receiver: int, number: int) -> list[int]:
        return [fate_at(link, key, 1.0, step, sender, receiver, number) for step in range(100)]

    assert fates(0, 1, 0) == fates(0, 1, 5)
    assert len({tuple(fates(*ends, 0)) for ends in permutations(range(3), 2)}) == 6


@pytest.mark.parametrize(("loss", "burst"), [(1.0, 2.0), (0.6, 2.4), (0.05, 1.05)])
def test_a_burst_shorter_than_chance_makes_it_is_refused(loss: float, burst: float):
    with pytest.raises(ValueError, match=r"radio burst must be 1 or at least 1 / \(1 - loss\), got "):
        RadioConfig(loss=loss, burst=burst)


def test_a_radio_that_loses_everything_or_nothing_may_have_any_possible_burst():
    assert all(losses(RadioConfig(loss=1.0), 0, 50))
    assert not any(losses(RadioConfig(loss=0.0, burst=8.0), 0, 50))


def heard(radio: Radio, vehicles: int, steps: int = 200) -> list[tuple[int, int, int]]:
    """(step, sender, receiver) among the vehicles 0 and 1, of as many as there are."""
    links = []
    for step in range(steps):
        for sender in range(vehicles):
            radio.send(say(b"x", sender, step), {i: NEAR[i] for i in range(vehicles)})
        for receiver in (0, 1):
            links += [(step, m.sender, receiver) for m in radio.deliver(receiver, step * 0.1) if m.sender < 2]
    return links


@pytest.mark.parametrize("burst", [1.0, 4.0])
def test_a_third_vehicle_changes_no_loss_between_the_other_two(burst: float):
    config = RadioConfig(loss=0.5, burst=burst)
    assert heard(Radio(config, seed=5), vehicles=2) == heard(Radio(config, seed=5), vehicles=3)


def test_the_two_directions_of_a_link_and_two_seeds_lose_different_messages():
    config = RadioConfig(loss=0.5)
    links = heard(Radio(config, seed=5), vehicles=2)
    assert {step for step, sender, _ in links if sender == 0} != {step for step, sender, _ in links if sender == 1}
    assert links != heard(Radio(config, seed=6), vehicles=2)


def test_a_delay_counts_in_whole_steps():
    radio = Radio(RadioConfig(loss=0.0, delay=0.25), seed=0)
    radio.send(say(b"x"), NEAR)
    assert radio.deliver(1, now=0.2) == []
    assert radio.count["in_flight"] == 3
    assert [message.payload for message in radio.deliver(1, now=0.3)] == [b"x"]
    assert radio.deliver(1, now=0.3) == []


@pytest.mark.parametrize(("away", "arrives"), [(150.0, True), (150.01, False), (math.nan, False)])
def test_a_message_reaches_as_far_as_the_range(away: float, arrives: bool):
    radio = Radio(CLEAR, seed=0)
    radio.send(say(b"x"), {0: (0.0, 0.0), 1: (0.6 * away, 0.8 * away)})
    assert bool(radio.deliver(1, now=0.0)) is arrives
    assert radio.count["out_of_range"] == (not arrives)


def test_deliveries_come_in_the_order_of_time_then_sender():
    radio = Radio(RadioConfig(loss=0.0, delay=0.2), seed=0)
    for step, sender in ((0, 3), (0, 1), (1, 2)):
        radio.send(say(b"x", sender, step), NEAR)
    assert [message.sender for message in radio.deliver(0, now=0.5)] == [1, 3, 2]


def test_every_message_is_accounted_for():
    radio = Radio(RadioConfig(loss=0.3, delay=0.3, range=25.0), seed=2)
    for step in range(50):
        for sender in range(4):
            radio.send(say(b"xyz", sender, step), NEAR)
        radio.deliver(0, step * 0.1)
        if step % 2:
            radio.deliver(1, step * 0.1)
    count = radio.count
    assert min(count[fate] for fate in ("delivered", "lost", "out_of_range", "in_flight")) > 0
    assert count["sent"] * 3 == sum(count[fate] for fate in ("delivered", "lost", "out_of_range", "in_flight"))
    assert count["bytes"] == 3 * count["sent"]


def test_a_payload_must_be_bytes_and_time_must_not_run_back():
    radio = Radio(CLEAR, seed=0)
    with pytest.raises(TypeError, match="bytes"):
        radio.send(Message(0, 0.0, "text"), NEAR)  # type: ignore[arg-type]
    radio.send(say(b"x", step=3), NEAR)
    with pytest.raises(ValueError, match="before an earlier message"):
        radio.send(say(b"x", step=2), NEAR)
    with pytest.raises(ValueError, match="time must be"):
        radio.deliver(0, math.nan)


@pytest.mark.parametrize(
    ("sender", "positions", "error"),
    [
        (7, NEAR, ValueError),
        (0, {}, ValueError),
        (0, {**NEAR, 2: ()}, IndexError),
        (0, {**NEAR, 0: (1.0,)}, ValueError),
    ],
)
def test_a_message_that_raises_costs_and_counts_nothing(sender: int, positions: dict, error: type[Exception]):
    radio = Radio(CLEAR, seed=0)
    with pytest.raises(error):
        radio.send(say(bytes(25_000), sender), positions)
    assert sum(radio.count.values()) == 0
    assert all(radio.deliver(receiver, now=0.0) == [] for receiver in NEAR)
    assert radio.send(say(bytes(25_000), sender), {**NEAR, sender: (0.0, 0.0)}).accepted  # the budget is as it was


def test_an_unknown_sender_is_named():
    with pytest.raises(ValueError, match=r"positions must say where sender 7 is, got those of \[0, 1, 2, 3\]"):
        Radio(CLEAR, seed=0).send(say(b"x", 7), NEAR)


@pytest.mark.parametrize("burst", [1.0, 3.0])
def test_the_compiled_air_carries_exactly_what_the_radio_does(burst: float):
    config = RadioConfig(loss=0.4, delay=0.2, range=60.0, rate=8 * 10 * 30, burst=burst)
    radio, link, key = Radio(config, seed=9), link_of(config), stream_key(9, "radio")
    air, buffer = empty_air(4, link, capacity=64), np.zeros(64, np.uint8)
    rng = np.random.default_rng(0)
    for step in range(100):
        places = rng.uniform(0.0, 80.0, (4, 2))
        for i in range(4):
            size = int(rng.integers(0, 40))
            buffer[:size] = rng.integers(0, 256, size)
            result = radio.send(say(buffer[:size].tobytes(), i, step), dict(enumerate(places)))
            assert REASONS[send(air, link, step, i, buffer, size, *places[i])] == (result.reason or "accepted")
        for receiver in range(4):
            arrived = []
            for i in range(4):
                length = fetch(air, link, step, i, buffer)
                if fate(air, link, key, step, i, receiver) == REACHES:
                    arrived.append((i, buffer[:length].tobytes()))
            assert arrived == [(m.sender, m.payload) for m in radio.deliver(receiver, step * 0.1)]


def test_the_air_says_what_became_of_a_message():
    link, buffer = link_of(RadioConfig(loss=1.0, range=50.0)), np.zeros(9, np.uint8)
    air, key = empty_air(4, link, capacity=8), stream_key(0, "radio")
    assert send(air, link, 0, 0, buffer, 8, 0.0, 0.0) == ACCEPTED
    assert send(air, link, 0, 0, buffer, 8, 0.0, 0.0) == SECOND_MESSAGE
    assert send(air, link, 0, 1, buffer, 9, 40.0, 0.0) == TOO_LONG
    assert send(air, link, 0, 2, buffer, 8, 80.0, 0.0) == ACCEPTED
    assert [fate(air, link, key, 0, 0, i) for i in range(4)] == [NOT_SENT, LOST, OUT_OF_RANGE, OUT_OF_RANGE]
    assert fate(air, link, key, 0, 1, 0) == NOT_SENT
    assert [fetch(air, link, 0, i, buffer) for i in range(4)] == [8, -1, 8, -1]
    assert fetch(air, link, 1, 0, buffer) == -1  # it arrived one step ago
