"""What a vehicle's sensors report: range, line of sight, misses, noise and class, and nothing that is hidden."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import boxes
from stages import detect

from cad_env.config import SensorConfig
from cad_env.numerics.philox import stream_key
from cad_env.pipeline.sense import CENTRE_HEIGHT, MOUNT, can_see, fix_pose, outline, sensing
from cad_env.types import CAR, TRUCK
from cad_env.world.geometry import box_hides
from cad_env.world.state import OFF, World

KEY = stream_key(0, "sense")
PERFECT = SensorConfig(noise=0.0, miss=0.0)


def seen(world: World, config: SensorConfig = PERFECT, step: int = 0, observer: int = 0) -> set[tuple[float, ...]]:
    return set(map(tuple, detect(world, observer, config, KEY, step).position))


def sees(world: World, observer: int, target: int, reach: float = 80.0) -> bool:
    outlines, near = np.zeros((len(world.speed), 3)), np.zeros(len(world.speed), np.int64)
    outline(world, outlines)
    return can_see(world, outlines, observer, target, reach, near)


def test_truck_hides_the_car_behind_it():
    world = boxes((0, 0, 0), (20, 0, 0, 12.0, 2.5), (40, 0, 0))
    world.kind[1] = TRUCK
    assert seen(world) == {(20.0, 0.0, CENTRE_HEIGHT[TRUCK])}


def test_without_the_truck_the_car_is_seen():
    world = boxes((0, 0, 0), (20, 0, 0, 12.0, 2.5), (40, 0, 0))
    world.driver[1] = OFF
    assert seen(world) == {(40.0, 0.0, CENTRE_HEIGHT[CAR])}


def test_a_corner_that_shows_is_enough():
    # The centre is hidden, and so is the near flank; one corner is in the open.
    world = boxes((0, 0, 0), (20, 0, 0, 4.0, 2.5), (40, 3.0, 0))
    assert sees(world, 0, 2)
    world.position[2, 1] = 1.0
    assert not sees(world, 0, 2)


def test_nobody_hides_behind_its_own_body():
    world = boxes((0, 0, 0, 14.0, 2.5), (-30, 0, 0))
    assert sees(world, 0, 1)


def test_the_range_is_to_the_nearest_of_five_points():
    sensor_x = MOUNT * 4.8
    world = boxes((0, 0, 0), (0, 0, 0))
    nearest = 80.0 * math.cos(math.asin(0.95 / 80.0))  # a rear corner is 0.95 m to the side
    for beyond, visible in ((-0.01, True), (0.01, False)):
        world.position[1] = sensor_x + nearest + 2.4 + beyond, 0.0
        assert sees(world, 0, 1) is visible
        assert bool(seen(world)) is visible


def test_no_object_is_reported_twice_nor_oneself_nor_who_is_gone():
    world = boxes((0, 0, 0), (15, 5, 0), (15, -5, 0), (-15, 0, 0))
    world.driver[3] = OFF
    assert seen(world) == {(15.0, 5.0, 0.75), (15.0, -5.0, 0.75)}


def test_cars_and_trucks_are_told_apart():
    world = boxes((0, 0, 0), (20, 5, 0), (20, -5, 0))
    world.kind[2] = TRUCK
    found = detect(world, 0, PERFECT, KEY, 3)
    assert dict(zip(found.kind.tolist(), found.position[:, 2], strict=True)) == {CAR: 0.75, TRUCK: 1.75}
    assert found.time == pytest.approx(0.3)


def reports(config: SensorConfig, frames: int = 5000) -> np.ndarray:
    """(n, 2) errors of a detected car over many frames, m."""
    world = boxes((3, 4, 0.3), (20, 5, 1.0))
    found = [detect(world, 0, config, KEY, step).position[:, :2] for step in range(frames)]
    return np.concatenate(found) - world.position[1]


def test_noise_is_normal_and_as_large_as_it_says():
    error = reports(SensorConfig(noise=0.2, miss=0.0))
    count = len(error)
    assert count == 5000
    assert np.abs(error.mean(axis=0)).max() < 5 * 0.2 / math.sqrt(count)
    assert np.abs(error.std(axis=0) / 0.2 - 1.0).max() < 5 / math.sqrt(2 * count)
    assert abs(np.corrcoef(error.T)[0, 1]) < 5 / math.sqrt(count)
    assert abs(np.corrcoef(error[1:, 0], error[:-1, 0])[0, 1]) < 5 / math.sqrt(count)
    assert (np.abs(error) > 2 * 0.2).mean() == pytest.approx(0.0455, abs=0.01)


def test_misses_come_at_their_rate_and_take_the_whole_object():
    missed = 5000 - len(reports(SensorConfig(miss=0.05)))
    assert abs(missed - 250) < 5 * math.sqrt(5000 * 0.05 * 0.95)
    assert len(reports(SensorConfig(miss=1.0), 100)) == 0


def test_two_observers_err_independently():
    world = boxes((0, 0, 0), (0, 10, 0), (20, 5, 0))
    config = SensorConfig(miss=0.0)
    errors = [
        [detect(world, observer, config, KEY, step).position[-1, 0] for step in range(2000)] for observer in (0, 1)
    ]
    assert abs(np.corrcoef(errors)[0, 1]) < 5 / math.sqrt(2000)


def fix(world: World, config: SensorConfig, step: int) -> np.ndarray:
    pose = np.zeros(3)
    fix_pose(world, 0, sensing(config), KEY, step, pose)
    return pose


def test_without_gnss_noise_a_vehicle_knows_where_it_is():
    world = boxes((3, 4, 0.3))
    assert fix(world, PERFECT, 7).tolist() == [3.0, 4.0, 0.3]


def test_a_wrong_fix_moves_own_position_and_detections_alike():
    world = boxes((3, 4, 0.3), (20, 5, 1.0), (-10, 9, 2.0))
    config = SensorConfig(noise=0.0, miss=0.0, gnss_noise=2.0)
    pose = fix(world, config, 5)
    shift = pose[:2] - world.position[0]
    assert 0.1 < np.linalg.norm(shift) < 15.0
    assert detect(world, 0, config, KEY, 5).position[:, :2] == pytest.approx(world.position[1:] + shift)


def test_a_wrong_heading_turns_detections_about_the_vehicle():
    world = boxes((3, 4, 0.3), (20, 5, 1.0))
    config = SensorConfig(noise=0.0, miss=0.0, gnss_yaw_noise=0.1)
    pose = fix(world, config, 5)
    assert pose[:2].tolist() == [3.0, 4.0]
    turn = pose[2] - 0.3
    assert abs(turn) > 1e-4
    turned = np.exp(1j * turn) * complex(17, 1)
    assert detect(world, 0, config, KEY, 5).position[0, :2] == pytest.approx([3 + turned.real, 4 + turned.imag])


def test_gnss_errors_have_their_size_and_leave_sensor_errors_alone():
    world = boxes((3, 4, 0.3), (20, 5, 1.0))
    noisy, still = SensorConfig(gnss_noise=1.0), SensorConfig()
    fixes = np.array([fix(world, noisy, step)[:2] for step in range(3000)]) - world.position[0]
    assert np.abs(fixes.std(axis=0) - 1.0).max() < 5 / math.sqrt(2 * 3000)
    for step in range(50):
        moved, unmoved = (detect(world, 0, config, KEY, step).position[:, :2] for config in (noisy, still))
        assert moved - fixes[step] == pytest.approx(unmoved)


def test_a_false_alarm_is_a_second_detection_at_a_corner_and_moves_nothing_else():
    world = boxes((0, 0, 0), (30, 5, 0.0, 4.8, 1.9))
    config = SensorConfig(noise=0.0, miss=0.0, false_alarm=0.2)
    found = [detect(world, 0, config, KEY, step).position[:, :2] for step in range(2000)]
    extra = np.array([one[0] for one in found if len(one) == 2])
    assert abs(len(extra) - 400) < 5 * math.sqrt(2000 * 0.2 * 0.8)
    assert all((one[-1] == (30.0, 5.0)).all() for one in found)
    assert np.abs(np.abs(extra - (30.0, 5.0)) - (2.4, 0.95)).max() < 1e-9
    assert len(np.unique(extra, axis=0)) == 4


def test_a_detection_is_drawn_to_what_is_seen_and_not_where_all_is():
    half, none = (boxes((0, 0, 0), (40, 0, 0, 4.8, 4.0), (20, y, 0, 4.8, 1.9)) for y in (1.5, 30.0))
    config = SensorConfig(noise=0.0, miss=0.0, partial=1.0)
    (seen, _), (whole, _) = (detect(world, 0, config, KEY, 0).position for world in (half, none))
    assert whole[:2].tolist() == [40.0, 0.0]
    assert -2.0 < seen[1] < -0.3
    drawn = detect(half, 0, SensorConfig(noise=0.0, miss=0.0, partial=0.5), KEY, 0).position[0]
    assert drawn[1] == pytest.approx(0.5 * seen[1])


def test_classes_are_wrong_at_their_rate():
    world = boxes((0, 0, 0), (30, 5, 0))
    wrong = [
        detect(world, 0, SensorConfig(miss=0.0, class_error=0.1), KEY, step).kind[0] == TRUCK for step in range(3000)
    ]
    assert abs(sum(wrong) - 300) < 5 * math.sqrt(3000 * 0.1 * 0.9)


def test_further_errors_leave_the_others_alone():
    world = boxes((0, 0, 0), (30, 5, 0), (20, -9, 1.0))
    usual, more = SensorConfig(), SensorConfig(class_error=0.5, false_alarm=0.5)
    for step in range(200):
        one, other = (detect(world, 0, config, KEY, step).position[:, :2].tolist() for config in (usual, more))
        assert all(place in other for place in one)


def test_what_is_hidden_leaves_no_trace():
    # The car behind the truck drives, grows and turns into another one: nothing that is reported changes.
    world = boxes((0, 0, 0), (20, 0, 0, 12.0, 2.5), (40, 0, 0), (30, 12, 0))
    before = [detect(world, 0, SensorConfig(), KEY, step).position.tolist() for step in range(20)]
    world.position[2], world.speed[2], world.size[2], world.kind[2] = (45.0, 0.3), 20.0, (3.0, 1.5), TRUCK
    assert [detect(world, 0, SensorConfig(), KEY, step).position.tolist() for step in range(20)] == before


spots = st.tuples(
    st.floats(-60.0, 60.0), st.floats(-60.0, 60.0), st.floats(-3.2, 3.2), st.floats(2.0, 14.0), st.floats(1.0, 2.6)
)


@settings(max_examples=300)
@given(st.lists(spots, min_size=2, max_size=12), spots, st.integers(0, 1000))
def test_law_3_adding_an_occluder_never_adds_a_detection(placed, occluder, step):
    before = seen(boxes(*placed), SensorConfig(), step)
    after = seen(boxes(*placed, occluder), SensorConfig(), step)
    new = after - before
    # Chance is a function of observer, target and step, so what is still seen is reported in the same place.
    assert len(new) <= 1
    assert all(math.dist(place[:2], occluder[:2]) < 7 * 0.2 * math.sqrt(2) for place in new)


def test_an_occluder_does_take_detections_away():
    # Otherwise the law above could hold of a sensor that looks through everything.
    world, with_occluder = boxes((0, 0, 0), (40, 0, 0)), boxes((0, 0, 0), (40, 0, 0), (20, 0, 1.57, 14.0, 2.6))
    assert len(seen(world)) == 1
    assert [place[0] for place in seen(with_occluder)] == [20.0]


spots = st.tuples(
    st.floats(-40.0, 40.0), st.floats(-40.0, 40.0), st.floats(-4.0, 4.0), st.floats(1.0, 14.0), st.floats(0.5, 3.0)
)


@settings(max_examples=300)
@given(st.lists(spots, min_size=3, max_size=9))
def test_a_line_of_sight_is_free_if_no_box_at_all_is_in_it(placed):
    # `can_see` asks only the boxes near a line; here every one is asked.
    world = boxes(*placed)
    x, y, heading, length, _ = placed[0]
    eye = x + MOUNT * length * math.cos(heading), y + MOUNT * length * math.sin(heading)
    for target, (tx, ty, turn, long, wide) in enumerate(placed[1:], start=1):
        others = [box for row, box in enumerate(placed) if row not in (0, target)]
        cos, sin = math.cos(turn), math.sin(turn)
        sides = ((0.0, 0.0), (0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5))
        points = [(tx + a * long * cos - b * wide * sin, ty + a * long * sin + b * wide * cos) for a, b in sides]
        free = [
            not any(box_hides(*eye, *point, bx, by, math.cos(h), math.sin(h), n, m) for bx, by, h, n, m in others)
            for point in points
            if math.dist(eye, point) <= 30.0
        ]
        assert sees(world, 0, target, 30.0) == any(free)
