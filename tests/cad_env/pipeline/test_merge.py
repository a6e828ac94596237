"""One graph from many: no order, no echoes, nobody twice, and not oneself."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cad_env.pipeline.graph_arrays import empty_graph_arrays, slide
from cad_env.pipeline.merge import EGO_RADIUS, MERGE_GATE, finish_merge, receive, start_merge, take_in
from cad_env.types import CAR, FRAMES, MAX_MERGED_TRACKS, MAX_TRACKS, TRUCK, GraphArrays

FAR = np.tile([1000.0, 1000.0, 0.0], (FRAMES, 1))  # the ego's trail, where it disturbs nobody
Path = tuple[float, float, float, float]  # x, y (m) in the newest frame, and m a frame


def graph(*paths: Path, frames: int = FRAMES, first_id: int = 1, kind: int = CAR) -> GraphArrays:
    """Tracks that move evenly, seen in the newest `frames` frames."""
    rows = empty_graph_arrays()
    rows.used[0] = len(paths)
    for i, (x, y, vx, vy) in enumerate(paths):
        back = np.arange(FRAMES - 1, -1, -1.0)
        rows.track[i], rows.kind[i] = first_id + i, kind
        rows.position[i] = np.stack([x - back * vx, y - back * vy, np.full(FRAMES, 0.75)], axis=-1)
        rows.mask[i] = back < frames
    return rows


def merge(own: GraphArrays, *kept: GraphArrays, first: int = 0, trail: np.ndarray = FAR) -> GraphArrays:
    merged, weight = empty_graph_arrays(rows=MAX_MERGED_TRACKS), np.zeros((MAX_MERGED_TRACKS, FRAMES))
    start_merge(merged)
    take_in(merged, weight, own, first, trail)
    for rows in kept:
        take_in(merged, weight, rows, 0, trail)
    finish_merge(merged, trail)
    return merged


def shown(rows: GraphArrays) -> list[tuple]:
    """What the rows in use hold, without what their masks hide; unordered, but for the newest frame last."""
    n = int(rows.used[0])
    position = np.where(rows.mask[:n, :, None], rows.position[:n], 0.0).round(9)
    return sorted(
        (p.tolist(), m.tolist(), int(k)) for p, m, k in zip(position, rows.mask[:n], rows.kind[:n], strict=True)
    )


def newest(rows: GraphArrays) -> np.ndarray:
    n = int(rows.used[0])
    return rows.position[:n, -1, :2][rows.mask[:n, -1]]


def test_two_views_of_one_vehicle_become_their_mean():
    merged = merge(graph((10.0, 0.0, 1.0, 0.0)), graph((10.4, 0.6, 1.0, 0.0), first_id=9))
    assert newest(merged) == pytest.approx(np.array([[10.2, 0.3]]))


def test_three_views_weigh_the_same():
    merged = merge(graph((0.0, 0.0, 0, 0)), graph((0.3, 0.0, 0, 0)), graph((0.6, 0.9, 0, 0)))
    assert newest(merged) == pytest.approx(np.array([[0.3, 0.3]]))


@pytest.mark.parametrize(("apart", "vehicles"), [(MERGE_GATE - 0.01, 1), (MERGE_GATE + 0.01, 2)])
def test_tracks_further_apart_than_the_gate_are_two_vehicles(apart: float, vehicles: int):
    assert merge(graph((0.0, 0.0, 1, 0)), graph((0.0, apart, 1, 0))).used[0] == vehicles


def test_vehicles_that_only_meet_now_are_told_apart_by_their_past():
    # Both are at the origin in the newest frame, but came from different sides.
    assert merge(graph((0.0, 0.0, 1.5, 0.0)), graph((0.0, 0.0, 0.0, 1.5))).used[0] == 2


def test_two_tracks_of_one_sender_never_merge():
    merged = merge(graph((0.0, 0.0, 0, 0)), graph((0.0, 0.5, 0, 0), (0.0, -0.4, 0, 0)))
    assert merged.used[0] == 2
    assert sorted(newest(merged).round(9).tolist()) == [[0.0, -0.2], [0.0, 0.5]]


def test_tracks_without_a_common_frame_stay_apart():
    early, late = graph((0.0, 0.0, 0, 0)), graph((0.0, 0.0, 0, 0), frames=5)
    early.mask[0, -5:] = False
    assert merge(early, late).used[0] == 2


def test_one_view_fills_the_frames_that_the_other_missed():
    half = graph((10.0, 0.0, 1.0, 0.0), frames=5)
    merged = merge(half, graph((10.0, 0.0, 1.0, 0.0)))
    assert merged.used[0] == 1
    assert merged.mask[0].all()
    assert merged.position[0, :, 0] == pytest.approx(np.arange(-4.0, 11.0))


def test_an_echo_of_oneself_within_two_metres_is_left_out():
    trail = np.stack([np.arange(FRAMES) * 0.8, np.zeros(FRAMES), np.zeros(FRAMES)], axis=-1)
    here = 0.8 * (FRAMES - 1)
    for offset, kept in ((0.0, 0), (EGO_RADIUS - 0.01, 0), (EGO_RADIUS + 0.01, 1)):
        assert merge(graph(), graph((here, offset, 0.8, 0.0)), trail=trail).used[0] == kept
    assert EGO_RADIUS == 2.0


def test_an_echo_of_oneself_does_not_pull_at_a_neighbour():
    # The first says where the neighbour is, the second where the ego is; they are near enough to be taken for one.
    neighbour, echo = graph((0.0, 2.6, 0, 0)), graph((0.0, 1.8, 0, 0))
    assert newest(merge(graph(), neighbour, echo, trail=np.zeros((FRAMES, 3)))).tolist() == [[0.0, 2.6]]


def test_the_ego_rule_asks_where_the_ego_was_in_that_frame():
    # A vehicle that stands where the ego is now was another vehicle when the ego was far away.
    trail = np.stack([np.arange(FRAMES) * 1.5, np.zeros(FRAMES), np.zeros(FRAMES)], axis=-1)
    merged = merge(graph(), graph((1.5 * (FRAMES - 1), 0.0, 0.0, 0.0)), trail=trail)
    assert merged.mask[0].tolist() == [True] * (FRAMES - 2) + [False] * 2


def test_own_body_is_left_out_and_the_senders_are_taken_in():
    own = graph((0.0, 0.0, 0, 0), (30.0, 0.0, 0, 0), first_id=0)
    sender = graph((50.0, 5.0, 0, 0), (30.2, 0.0, 0, 0), first_id=0, kind=TRUCK)
    trail = np.zeros((FRAMES, 3))
    merged = merge(own, sender, first=1, trail=trail)
    assert sorted(newest(merged).tolist()) == [[30.1, 0.0], [50.0, 5.0]]


paths = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-2, 2), st.floats(-2, 2))
graphs = st.lists(paths, max_size=5).map(lambda some: graph(*some))


@given(st.lists(graphs, min_size=1, max_size=4), st.randoms(use_true_random=False))
def test_law_4_neither_order_of_arrival_nor_repetition_of_messages_matters(sent: list[GraphArrays], chance):
    def received(order: list[int]) -> list[tuple]:
        kept = [empty_graph_arrays() for _ in sent]
        for sender in order:
            receive(kept[sender], sent[sender], FRAMES, 0)
        return shown(merge(graph(), *kept))

    numbers = list(range(len(sent)))
    shuffled = numbers + chance.choices(numbers, k=3)
    chance.shuffle(shuffled)
    assert received(shuffled) == received(numbers)


@given(graphs, graphs)
def test_nobody_is_lost_or_made_up(own: GraphArrays, other: GraphArrays):
    merged = merge(own, other)
    a, b, m = int(own.used[0]), int(other.used[0]), int(merged.used[0])
    assert max(a, b) <= m <= a + b
    for rows in (own, other):
        for place in newest(rows):
            apart = np.linalg.norm(newest(merged) - place, axis=1)
            assert apart.min() <= MERGE_GATE * np.sqrt(FRAMES)


def as_sent(rows: GraphArrays, depth: int) -> GraphArrays:
    """A message holds the newest `depth` frames."""
    copy = GraphArrays(*(part.copy() for part in rows))
    copy.mask[:, : FRAMES - depth] = False
    return copy


@pytest.mark.parametrize("depth", [1, 2, 5, 15])
def test_the_receiver_assembles_the_history_from_short_messages(depth: int):
    kept = empty_graph_arrays()
    for frame in range(FRAMES):
        slide(kept)
        receive(kept, as_sent(graph((1.0 * frame, 0.0, 1.0, 0.0), frames=frame + 1), depth), depth, 0)
    assert kept.used[0] == 1
    assert kept.mask[0].all()
    assert kept.position[0, :, 0] == pytest.approx(np.arange(FRAMES))


@pytest.mark.parametrize("age", [1, 5, 14])
def test_a_late_message_is_placed_when_it_was_true(age: int):
    kept = empty_graph_arrays()
    receive(kept, graph((10.0, 0.0, 1.0, 0.0)), FRAMES, age)
    seen = FRAMES - age
    assert kept.mask[0].tolist() == [True] * seen + [False] * age
    assert kept.position[0, :seen, 0] == pytest.approx(10.0 - np.arange(seen - 1, -1, -1.0))


def test_a_lost_message_of_depth_one_leaves_a_gap_and_one_of_depth_fifteen_none():
    for depth, gap in ((1, True), (15, False)):
        kept = empty_graph_arrays()
        for frame in range(FRAMES):
            slide(kept)
            if frame != 7:
                receive(kept, as_sent(graph((1.0 * frame, 0.0, 1.0, 0.0), frames=frame + 1), depth), depth, 0)
        assert (not kept.mask[0].all()) is gap


def test_what_a_sender_no_longer_says_is_forgotten():
    kept = empty_graph_arrays()
    receive(kept, graph((0.0, 0.0, 0, 0), (9.0, 0.0, 0, 0)), FRAMES, 0)
    slide(kept)
    receive(kept, graph((0.0, 0.0, 0, 0)), FRAMES, 0)
    assert len(newest(merge(graph(), kept))) == 1
    assert merge(graph(), kept).used[0] == 1


def test_who_is_silent_is_forgotten_after_fifteen_frames():
    kept = empty_graph_arrays()
    receive(kept, graph((0.0, 0.0, 0, 0)), FRAMES, 0)
    for _ in range(FRAMES - 1):
        slide(kept)
        assert kept.used[0] == 1
    slide(kept)
    assert kept.used[0] == 0


def test_more_tracks_than_there_is_room_for_leave_the_first_in_place():
    crowds = [graph(*((12.0 * k, 40.0 * s, 0, 0) for k in range(MAX_TRACKS))) for s in range(3)]
    merged = merge(*crowds)
    assert merged.used[0] == MAX_MERGED_TRACKS
    expected = set(itertools.product(12.0 * np.arange(MAX_TRACKS), [0.0, 40.0]))
    assert set(map(tuple, newest(merged))) == expected
