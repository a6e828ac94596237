"""The lidar: what its rays meet is what the line of sight allows, and where on it the beams of an azimuth end."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import boxes

from cad_env.config import SensorConfig
from cad_env.lidar.cast import (  # fmt: skip
    HEIGHT,
    HIGHEST,
    LOWEST,
    NOTHING,
    TOO_FAR,
    Rays,
    cast,
    cast_centimetres,
    meet,
    rays_of,
)
from cad_env.lidar.points import POINT_REACH, thinned
from cad_env.numerics.philox import stream_key
from cad_env.pipeline.sense import MOUNT, can_see, outline, sensing
from cad_env.types import CAR, TRUCK
from cad_env.world.geometry import box_hides, boxes_touch
from cad_env.world.state import OFF, World

KEY = stream_key(0, "cast")
PERFECT = SensorConfig(noise=0.0)
LIDAR, FLAT = rays_of(1024, 64), rays_of(1024, 1)
FAR = 200.0  # m


def outlines_of(world: World) -> np.ndarray:
    outlines = np.zeros((len(world.speed), 3))
    outline(world, outlines)
    return outlines


def met(world: World, rays: Rays = FLAT, observer: int = 0, reach: float = FAR) -> tuple[np.ndarray, np.ndarray]:
    """Distance and row of every azimuth."""
    distance, struck = np.zeros(len(rays.direction)), np.zeros(len(rays.direction), np.int64)
    meet(world, outlines_of(world), observer, reach, rays, distance, struck)
    return distance, struck


def points(
    world: World, rays: Rays = LIDAR, config: SensorConfig = PERFECT, step: int = 0, ground: bool = True
) -> np.ndarray:
    cloud = np.full((len(rays.direction) * len(rays.slope), 3), np.nan)
    count = cast(world, outlines_of(world), 0, sensing(config), KEY, step, rays, ground, cloud)
    return cloud[:count]


def whole_cm(world: World, rays: Rays, config: SensorConfig, step: int = 0) -> np.ndarray | None:
    cloud = np.full((len(rays.direction) * len(rays.slope), 3), 9999, np.int16)
    count = cast_centimetres(world, outlines_of(world), 0, sensing(config), KEY, step, rays, cloud)
    return None if count == TOO_FAR else cloud[:count]


def sees(world: World, target: int) -> bool:
    return can_see(world, outlines_of(world), 0, target, FAR, np.zeros(len(world.speed), np.int64))


def sensor(world: World) -> np.ndarray:
    heading = world.heading[0]
    return world.position[0] + MOUNT * world.size[0, 0] * np.array([math.cos(heading), math.sin(heading)])


def hides(world: World, row: int, point: np.ndarray) -> bool:
    box = math.cos(world.heading[row]), math.sin(world.heading[row]), *world.size[row]
    return box_hides(*sensor(world), *point, *world.position[row], *box)


def apart(world: World) -> bool:
    """No two vehicles touch."""
    box = [(*world.position[k], world.heading[k], *world.size[k]) for k in range(len(world.speed))]
    return not any(boxes_touch(*box[i], *box[j]) for i in range(len(box)) for j in range(i))


angles = st.floats(-math.pi, math.pi)
places = st.tuples(st.floats(4.0, 50.0), angles, angles)


def around(away: float, where: float, heading: float, *size: float) -> tuple[float, ...]:
    return (away * math.cos(where), away * math.sin(where), heading, *size)


def test_truck_hides_the_car_behind_it_from_the_rays():
    world = boxes((0, 0, 0), (20, 0, 0, 12.0, 2.5), (40, 0, 0))
    assert set(met(world)[1]) == {NOTHING, 1}
    world.position[2, 1] = 6.0
    assert set(met(world)[1]) == {NOTHING, 1, 2}


@settings(max_examples=300)
@given(angles, places, places)
def test_behind_one_truck_a_car_has_returns_if_and_only_if_there_is_a_line_of_sight(heading, truck, car):
    # What one box hides is convex: if the centre and the corners of the car are in it, all of the car is.
    world = boxes((0, 0, heading), around(*truck, 12.0, 2.5), around(*car))
    assume(apart(world))
    returns = bool((met(world)[1] == 2).any())
    if returns:
        assert sees(world, 2)
    if not hides(world, 1, world.position[2]):  # half of the car shows, which at 50 m is three rays wide
        assert returns
        assert sees(world, 2)


@settings(max_examples=100)
@given(angles, st.lists(places, min_size=1, max_size=8), st.sampled_from([60.0, 15.0]))
def test_what_a_ray_meets_is_on_a_box_in_range_and_nothing_is_in_between(heading, others, reach):
    world = boxes((0, 0, heading), *(around(*one, 6.0, 2.2) for one in others))
    assume(apart(world))
    distance, struck = met(world, rays_of(64, 1), reach=reach)
    for a in np.flatnonzero(struck != NOTHING):
        angle, row = heading + 2 * math.pi * a / 64, struck[a]
        ray = np.array([math.cos(angle), math.sin(angle)])
        point = sensor(world) + distance[a] * ray
        assert 0.0 <= distance[a] <= reach
        gap = point - world.position[row]
        cos, sin = math.cos(world.heading[row]), math.sin(world.heading[row])
        over = abs(gap @ [cos, sin]) - 3.0, abs(gap @ [-sin, cos]) - 1.1
        assert max(over) == pytest.approx(0.0, abs=1e-9)
        assert not any(hides(world, k, point - 1e-6 * ray) for k in range(1, len(world.speed)))
    for a in np.flatnonzero(struck == NOTHING):
        angle = heading + 2 * math.pi * a / 64
        end = sensor(world) + reach * (1.0 - 1e-9) * np.array([math.cos(angle), math.sin(angle)])
        assert not any(hides(world, k, end) for k in range(1, len(world.speed)))


@settings(max_examples=100)
@given(st.lists(places, min_size=1, max_size=5), places)
def test_law_3_one_more_occluder_never_adds_a_point_on_another(others, more):
    usual = boxes((0, 0, 0), *(around(*one) for one in others))
    fuller = boxes((0, 0, 0), *(around(*one) for one in others), around(*more, 12.0, 2.5))
    (before, who), (after, whom) = met(usual), met(fuller)
    assert (after <= before).all()
    same = whom != len(others) + 1
    assert (who[same] == whom[same]).all()
    assert before[same].tobytes() == after[same].tobytes()


def test_nobody_meets_itself_or_who_is_gone():
    world = boxes((0, 0, 0, 14.0, 2.5), (20, 0, 0), (-20, 0, 0))
    world.driver[1] = OFF
    assert set(met(world)[1]) == {NOTHING, 2}


def test_on_an_empty_road_every_falling_beam_meets_the_ground_where_its_slope_takes_it():
    cloud = points(boxes((5, 5, 1)))
    cloud[:, 0] -= MOUNT * 4.8
    falling = [slope for slope in np.tan(np.linspace(LOWEST, HIGHEST, 64)) if 0 < -HEIGHT / slope <= PERFECT.range]
    assert len(cloud) == 1024 * len(falling)
    assert set(cloud[:, 2]) == {0.0}
    rings = np.hypot(cloud[:, 0], cloud[:, 1]).reshape(1024, -1)
    np.testing.assert_allclose(rings, [[-HEIGHT / slope for slope in falling]] * 1024, rtol=1e-12)
    assert np.allclose(np.diff(np.unwrap(np.arctan2(cloud[:, 1], cloud[:, 0])[:: len(falling)])), 2 * math.pi / 1024)


@pytest.mark.parametrize(("kind", "height"), [(CAR, 1.5), (TRUCK, 3.5)])
def test_beams_end_on_a_vehicle_within_its_height_and_see_no_ground_behind_it(kind: int, height: float):
    world = boxes((0, 0, 0), (13, 0, 0, 10.0, 2.5), kind=kind)  # its rear is at x = 8, 6.08 m from the sensor
    cloud = points(world)
    straight = cloud[np.abs(cloud[:, 1]) < 1e-9]
    straight = straight[straight[:, 0] > 0.0]
    hits = straight[straight[:, 2] > 0.0]
    assert len(hits) > 5
    assert hits[:, 0] == pytest.approx(8.0)
    assert hits[:, 2].max() <= height
    highest = HEIGHT + 6.08 * math.tan(HIGHEST)
    assert hits[:, 2].max() > min(height, highest) - 0.05
    assert straight[straight[:, 2] == 0.0, 0].max() < 8.0


def test_the_one_beam_of_a_flat_lidar_ends_at_half_the_height():
    world = boxes((0, 0, 0), (20, 5, 0), (20, -5, 0))
    world.kind[2] = TRUCK
    cloud = points(world, FLAT)
    assert set(zip(np.sign(cloud[:, 1]), cloud[:, 2], strict=True)) == {(1.0, 0.75), (-1.0, 1.75)}


def test_a_range_errs_by_a_tenth_of_what_a_detection_does_and_alike_for_all_beams():
    world = boxes((0, 0, 0), (20, 0, 0, 10.0, 60.0))
    straight = points(world, FLAT)
    errors = [points(world, FLAT, SensorConfig(noise=0.5), step) - straight for step in range(20)]
    along = np.concatenate(
        [error[:, 0] / np.cos(np.arctan2(straight[:, 1], straight[:, 0] - 1.92)) for error in errors]
    )
    assert len(along) > 5000
    assert abs(along.std() / 0.05 - 1.0) < 5 / math.sqrt(2 * len(along))
    assert abs(along.mean()) < 5 * 0.05 / math.sqrt(len(along))
    exact, noisy = points(world), points(world, config=SensorConfig(noise=0.5))
    error = np.hypot(noisy[:, 0] - exact[:, 0], noisy[:, 1] - exact[:, 1])
    assert len(exact) == len(noisy)
    assert (exact[:, 2] == noisy[:, 2]).all()
    assert error[:3].max() - error[:3].min() < 1e-9 < error[0]  # the lowest beams of the first azimuth


def test_one_more_vehicle_moves_no_other_point():
    noisy = SensorConfig(noise=0.5)
    fewer = set(map(tuple, points(boxes((0, 0, 0), (20, 5, 0)), config=noisy)))
    more = points(boxes((0, 0, 0), (20, 5, 0), (-30, 5, 0)), config=noisy)
    new = [point for point in map(tuple, more) if point not in fewer]
    assert len(new) > 0
    assert all(point[2] > 0.0 and point[0] < -20.0 for point in new)


crowds = st.lists(places, max_size=6)
noises = st.sampled_from([0.0, 0.2, 3.0])


@settings(max_examples=40)
@given(crowds, noises, st.sampled_from([(256, 64), (64, 1)]), st.sampled_from([CAR, TRUCK]))
def test_without_the_ground_the_returns_of_vehicles_are_the_same_to_the_last_bit(others, noise, lidar, kind):
    world, rays = boxes((0, 0, 0.7), *(around(*one) for one in others), kind=kind), rays_of(*lidar)
    config = SensorConfig(noise=noise)
    every, high = points(world, rays, config), points(world, rays, config, ground=False)
    assert every[every[:, 2] != 0.0].tobytes() == high[high[:, 2] != 0.0].tobytes()
    assert thinned(every, 300).tobytes() == thinned(high, 300).tobytes()
    assert len(high) <= (met(world, rays, reach=config.range)[1] != NOTHING).sum() * lidar[1]


@settings(max_examples=40)
@given(crowds, noises, st.sampled_from([(256, 64), (64, 1)]))
def test_in_centimetres_a_cloud_is_the_same_to_the_nearest_and_half_of_one_rounds_up(others, noise, lidar):
    world, rays = boxes((0, 0, 0.7), *(around(*one) for one in others)), rays_of(*lidar)
    config = SensorConfig(noise=noise)
    for step in range(2):
        usual, whole = points(world, rays, config, step), whole_cm(world, rays, config, step)
        assert np.floor(usual * 100.0 + 0.5).astype(int).tolist() == whole.tolist()


def test_what_two_bytes_of_centimetres_cannot_hold_is_told():
    wall = boxes((0, 0, 0), (326.0, 0, 0, 2.0, 400.0))
    ring = Rays(FLAT.direction, np.array([-HEIGHT / 324.0, 0.0]), np.array([324.0, math.inf]))  # on the road
    config = SensorConfig(range=330.0, noise=10.0)
    for world, rays in ((wall, FLAT), (boxes((0, 0, 0)), ring)):
        told = set()
        for step in range(20):
            far = bool(np.abs(points(world, rays, config, step)).max() > POINT_REACH)
            assert far == (whole_cm(world, rays, config, step) is None)
            told.add(far)
        assert told == {True, False}


@settings(max_examples=20)
@given(st.floats(-1000, 1000), st.floats(-1000, 1000), angles, places)
def test_law_6_a_cloud_does_not_depend_on_where_the_world_is(dx, dy, turn, other):
    here = boxes((0, 0, 0.3), around(*other))
    there = boxes((0, 0, 0.3), around(*other))
    cos, sin = math.cos(turn), math.sin(turn)
    there.position[:] = here.position @ np.array([[cos, sin], [-sin, cos]]) + [dx, dy]
    there.heading[:] += turn
    one, two = points(here, config=SensorConfig()), points(there, config=SensorConfig())
    np.testing.assert_allclose(one, two, atol=1e-6)
