"""Placing a sender by what both see: right where it can be, doubtful where it cannot, and not to be talked into it."""

import math

import numpy as np
import pytest

from cad_env.config import PLACINGS, PoseConfig
from cad_env.numerics.jit import compiled
from cad_env.pipeline.graph_arrays import empty_graph_arrays
from cad_env.pipeline.poses import Poses, new_poses
from cad_env.pipeline.register import ABSTAINS, PLACED, Relations, hear, new_relations, place_rows, place_sender
from cad_env.types import FRAMES, STEP, TRUCK, Floats, GraphArrays

EGO, SENDER = np.array([3.0, -7.0, 0.4]), np.array([42.0, 11.0, 2.6])  # poses in the world, in the newest frame
OWN_ODOMETRY, ITS_ODOMETRY = np.array([20.0, 1.0, -1.2]), np.array([-5.0, 8.0, 0.3])  # the same, by odometry


def seen_from(points: Floats, pose: Floats, odometry: Floats) -> Floats:
    """Points (..., 2) of the world in the frame in which a pose is `odometry`."""
    angle = odometry[2] - pose[2]
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    return (points - pose[:2]) @ turn + odometry[:2]


def ways(count: int, seed: int = 0, gap: float = 0.0) -> Floats:
    """(count, FRAMES, 2) m ways of vehicles between the two: anywhere, or in a queue with this gap."""
    rng = np.random.default_rng(seed)
    newest = rng.uniform(-15.0, 50.0, (count, 2))
    angle, speed = rng.uniform(-math.pi, math.pi, count), rng.uniform(2.0, 12.0, count)
    if gap:
        newest = np.stack([gap * np.arange(count), np.full(count, 4.0)], axis=-1)
        angle, speed = np.zeros(count), np.full(count, 8.0)
    step = STEP * speed[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return newest[:, None] + step[:, None] * (np.arange(FRAMES) - FRAMES + 1)[None, :, None]


def rows_of(
    body: Floats, tracks: Floats, pose: Floats, odometry: Floats, noise: float = 0.0, seed: int = 0
) -> GraphArrays:
    """What a vehicle keeps: its body first, then these tracks, in its own frame."""
    rows = empty_graph_arrays()
    every = np.concatenate([body[None], tracks])
    rows.used[0], rows.track[: len(every)] = len(every), np.arange(len(every))
    rows.mask[: len(every)] = True
    rows.position[: len(every), :, :2] = seen_from(every, pose, odometry)
    rows.position[1 : len(every), :, :2] += np.random.default_rng(seed).normal(0.0, noise, (len(tracks), FRAMES, 2))
    return rows


def standing(pose: Floats) -> Floats:
    return np.tile(pose[:2], (FRAMES, 1))


@compiled
def tell(relations: Relations, poses: Poses, v: int, own: GraphArrays, kept: GraphArrays, trail: Floats, stated: Floats,
         step: int) -> None:  # fmt: skip
    hear(relations, 0, v, kept, stated, step, 0)
    place_sender(relations, poses, 0, v, own, kept, trail)


EXACTLY = np.zeros(3)


class Meeting:
    """A receiver and two senders that are the same; what it makes of them."""

    def __init__(
        self, placing: str = "registered", accuracy: tuple[float, float] = (1.0, 0.01), fix: bool = True
    ) -> None:
        config = PoseConfig(bias=1.0, denied=not fix, placing=placing)
        self.poses, self.relations = new_poses(3, config), new_relations(1, 3, empty_graph_arrays(), False)
        self.poses.fix[0], self.poses.fixes[0], self.poses.accuracy[0] = EGO, fix, accuracy
        self.trail = np.zeros((FRAMES, 3))
        self.trail[-1] = OWN_ODOMETRY
        self.accuracy, self.step, self.fix = accuracy, 0, fix

    def hear(self, own: GraphArrays, kept: GraphArrays, error: Floats = EXACTLY, v: int = 1) -> int:
        """One message, whose fix is off by `error`; answers the state."""
        stated = np.array([ITS_ODOMETRY[2], *(SENDER + error), *self.accuracy, float(self.fix)])
        self.step += 1
        tell(self.relations, self.poses, v, own, kept, self.trail, stated, self.step)
        return int(self.relations.state[0, v])

    def off(self, v: int = 1) -> float:
        """m by which what is 30 m behind the sender is misplaced."""
        there = seen_from(SENDER[:2], EGO, OWN_ODOMETRY)
        heading = SENDER[2] - EGO[2] + OWN_ODOMETRY[2]
        found = self.relations.there[0, v]
        behind = [p[:2] - 30.0 * np.array([math.cos(a), math.sin(a)]) for p, a in ((there, heading), (found, found[2]))]
        return float(np.linalg.norm(behind[0] - behind[1]))


def both_see(
    common: int = 5, noise: float = 0.1, mine: int = 2, its: int = 2, **queue: float
) -> tuple[GraphArrays, GraphArrays]:
    """Rows of the receiver and of the sender, who share `common` tracks, and have some each for themselves."""
    every = ways(common + mine + its, **queue)
    own = rows_of(standing(EGO), every[: common + mine], EGO, OWN_ODOMETRY, noise, 1)
    kept = rows_of(
        standing(SENDER), np.concatenate([every[:common], every[common + mine :]]), SENDER, ITS_ODOMETRY, noise, 2
    )
    return own, kept


BIAS = np.array([1.5, -1.0, 0.012])


@pytest.mark.parametrize(("placing", "most"), [("fixes", 3.0), ("nearest", 0.3), ("single", 0.3), ("registered", 0.6)])
def test_common_tracks_place_a_sender_whose_fix_is_off(placing: str, most: float) -> None:
    meeting = Meeting(placing)
    assert meeting.hear(*both_see(), BIAS) == PLACED
    assert meeting.off() < most
    assert placing != "fixes" or meeting.off() > 1.0


def test_every_placing_has_been_tried() -> None:
    assert set(PLACINGS) == {"fixes", "nearest", "single", "registered"}


def test_without_anything_in_common_nothing_but_good_fixes_places_a_sender() -> None:
    rows = both_see(common=0)
    assert Meeting(accuracy=(2.0, 0.02)).hear(*rows) == ABSTAINS
    assert Meeting(accuracy=(0.05, 0.003)).hear(*rows) == PLACED
    denied = Meeting(fix=False)
    assert {denied.hear(*rows) for _ in range(30)} == {ABSTAINS}


def test_without_any_fix_a_relation_counts_once_it_has_been_borne_out() -> None:
    meeting = Meeting(fix=False)
    states = [meeting.hear(*both_see(noise=0.05)) for _ in range(30)]
    assert states[0] == ABSTAINS
    assert states[-1] == PLACED
    assert meeting.off() < 0.3


def test_a_relation_is_kept_when_there_is_nothing_in_common_any_more() -> None:
    meeting = Meeting()
    for _ in range(10):
        meeting.hear(*both_see(), BIAS)
    assert meeting.hear(*both_see(common=0), BIAS) == PLACED
    assert meeting.off() < 0.3


def test_what_is_said_to_be_unsure_holds_the_error() -> None:
    far = []
    for seed in range(40):
        meeting, noise = Meeting(), np.random.default_rng(seed).normal(0.0, (1.0, 1.0, 0.01))
        if meeting.hear(*both_see(common=3, seed=seed), noise) == PLACED:
            cov = meeting.relations.covariance[0, 1]
            far.append(meeting.off() / math.sqrt(0.5 * (cov[0, 0] + cov[1, 1]) + 30.0**2 * cov[2, 2]))
    assert len(far) > 20
    assert np.quantile(far, 0.9) < 2.5


def test_a_queue_that_fits_itself_one_gap_on_is_not_believed_without_a_prior() -> None:
    # All gaps alike and nothing else in sight: any shift fits, so any would be a guess.
    own, kept = both_see(common=6, mine=0, its=0, noise=0.02, gap=8.0)
    own.used[0], kept.used[0] = 6, 7
    meeting = Meeting(fix=False)
    states = {meeting.hear(own, kept) for _ in range(30)}
    assert states == {ABSTAINS} or meeting.off() < 1.0
    good = Meeting(accuracy=(0.3, 0.01))
    assert good.hear(own, kept) == PLACED
    assert good.off() < 1.0


@pytest.mark.parametrize("shift", [6.0, 12.0])
def test_a_sender_that_its_matches_contradict_is_not_believed(shift: float) -> None:
    # It says to be known to a hand's breadth, and all that both see says that it is elsewhere.
    meeting = Meeting(accuracy=(0.1, 0.005))
    rows, lie = both_see(noise=0.05), np.array([shift, 0.5 * shift, 0.0])
    for _ in range(12):
        last = meeting.hear(*rows, lie)
    assert last == ABSTAINS
    honest = Meeting(accuracy=(0.1, 0.005))
    assert {honest.hear(*rows) for _ in range(12)} == {PLACED}


def test_who_begins_to_lie_is_not_believed_any_more() -> None:
    meeting, rows = Meeting(accuracy=(0.5, 0.01)), both_see(noise=0.05)
    assert {meeting.hear(*rows) for _ in range(10)} == {PLACED}
    assert meeting.hear(*rows, np.array([20.0, 0.0, 0.0])) == ABSTAINS


def test_the_receiver_knows_itself_among_a_sender_s_tracks_and_leaves_itself_out() -> None:
    own, kept = both_see(common=4)
    i = kept.used[0]
    kept.used[0], kept.track[i], kept.mask[i] = i + 1, 77, True
    kept.position[i, :, :2] = seen_from(standing([*EGO, 0.4, -0.3, 0.0]), SENDER, ITS_ODOMETRY)
    meeting = Meeting()
    meeting.hear(own, kept, BIAS)
    assert meeting.relations.me[0, 1] == 77
    place_rows(meeting.relations, 0, 1, kept)
    rows = meeting.relations.rows
    assert 77 not in rows.track[: rows.used[0]]
    assert rows.used[0] == i


def test_placed_rows_are_where_they_are_and_farther_ones_less_surely() -> None:
    own, kept = both_see(noise=0.0)
    meeting = Meeting()
    for _ in range(10):
        meeting.hear(own, kept, BIAS)
    place_rows(meeting.relations, 0, 1, kept)
    rows, spread = meeting.relations.rows, meeting.relations.spread
    for mine in range(1, 6):
        assert rows.position[mine, :, :2] == pytest.approx(own.position[mine, :, :2], abs=0.2)
    away = np.linalg.norm(kept.position[:, -1, :2] - ITS_ODOMETRY[:2], axis=1)[: rows.used[0]]
    assert (np.argsort(spread[: rows.used[0]]) == np.argsort(away)).all()


def test_a_class_that_differs_is_another_vehicle() -> None:
    own, kept = both_see()
    own.kind[:] = TRUCK
    assert Meeting(accuracy=(2.0, 0.02)).hear(own, kept, BIAS) == ABSTAINS


def numbers(relations: Relations, v: int) -> list[float]:
    return [*relations.there[0, v], *relations.covariance[0, v].ravel(), float(relations.state[0, v])]


def test_law_4_a_sender_s_place_does_not_depend_on_who_was_heard_before() -> None:
    rows, others = both_see(), both_see(common=3, seed=5)
    found = []
    for order in ((1, 2), (2, 1)):
        meeting = Meeting()
        for v in order:
            meeting.hear(*(rows if v == 1 else others), BIAS, v)
            meeting.step = 0
        found.append(numbers(meeting.relations, 1) + numbers(meeting.relations, 2))
    assert found[0] == found[1]


def test_law_4_a_message_that_was_taken_in_changes_nothing_more() -> None:
    once, twice = Meeting(), Meeting()
    own, kept = both_see()
    once.hear(own, kept, BIAS)
    twice.hear(own, kept, BIAS)
    settle(twice.relations, twice.poses, own, kept, twice.trail)
    assert numbers(once.relations, 1) == numbers(twice.relations, 1)


@compiled
def settle(relations: Relations, poses: Poses, own: GraphArrays, kept: GraphArrays, trail: Floats) -> None:
    place_sender(relations, poses, 0, 1, own, kept, trail)
