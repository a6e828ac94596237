"""Oriented boxes against shapely: do two touch, does one hide a point."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cad_env.numerics.jit import compiled
from cad_env.world.geometry import box_hides, boxes_touch, within

shapely = pytest.importorskip("shapely")

NEARLY = 1e-6  # m, below which the two may disagree on what touches
place = st.floats(-15.0, 15.0)
boxes = st.tuples(place, place, st.floats(-10.0, 10.0), st.floats(0.5, 18.0), st.floats(0.5, 3.0))
points = st.tuples(place, place)


def polygon(x: float, y: float, heading: float, length: float, width: float):
    cos, sin = math.cos(heading), math.sin(heading)
    corners = [(a * length / 2, b * width / 2) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    return shapely.Polygon([(x + a * cos - b * sin, y + a * sin + b * cos) for a, b in corners])


def hides(x0, y0, x1, y1, x, y, heading, length, width) -> bool:
    return box_hides(x0, y0, x1, y1, x, y, math.cos(heading), math.sin(heading), length, width)


@settings(max_examples=1000)
@given(boxes, boxes)
def test_two_boxes_touch_when_shapely_says_so(a, b):
    one, other = polygon(*a), polygon(*b)
    if one.distance(other) > NEARLY:
        assert not boxes_touch(*a, *b)
    elif one.buffer(-NEARLY).intersects(other):
        assert boxes_touch(*a, *b)


@settings(max_examples=1000)
@given(points, points, boxes)
def test_a_box_hides_a_point_when_shapely_says_so(eye, target, box):
    line, body = shapely.LineString([eye, target]), polygon(*box)
    if line.distance(body) > NEARLY:
        assert not hides(*eye, *target, *box)
    elif line.intersects(body.buffer(-NEARLY)):
        assert hides(*eye, *target, *box)


def test_the_oracle_sees_both_answers_often():
    # Otherwise the two tests above could pass on boxes that never meet.
    car = (0.0, 0.0, 0.0, 4.8, 1.9)
    grid = [(0.5 * i, 0.5 * j, 0.1 * (i + j)) for i in range(-12, 13) for j in range(-12, 13)]
    touching = sum(boxes_touch(*car, x, y, heading, 12.0, 2.5) for x, y, heading in grid)
    hiding = sum(hides(-10.0, 0.5, 10.0, -0.5, x, y, heading, 12.0, 2.5) for x, y, heading in grid)
    for count in (touching, hiding):
        assert len(grid) / 10 < count < 9 * len(grid) / 10
    assert touching == sum(polygon(*car).intersects(polygon(x, y, h, 12.0, 2.5)) for x, y, h in grid)
    sight = shapely.LineString([(-10.0, 0.5), (10.0, -0.5)])
    assert hiding == sum(sight.intersects(polygon(x, y, h, 12.0, 2.5)) for x, y, h in grid)


@given(boxes, boxes, points)
def test_touching_and_hiding_have_no_direction(a, b, eye):
    assert boxes_touch(*a, *b) == boxes_touch(*b, *a)
    one, other = hides(*eye, a[0], a[1], *b), hides(a[0], a[1], *eye, *b)
    if one != other:  # only where the line grazes a corner
        grazed = shapely.LineString([eye, (a[0], a[1])])
        assert grazed.distance(polygon(*b).exterior) < NEARLY


def test_a_box_behind_the_eye_or_beyond_the_point_hides_nothing():
    assert hides(0, 0, 20, 0, 10, 0, 0, 5, 2)
    assert not hides(0, 0, 20, 0, -10, 0, 0, 5, 2)
    assert not hides(0, 0, 20, 0, 30, 0, 0, 5, 2)
    assert not hides(0, 0, 20, 0, 10, 1.01, 0, 5, 2)


@compiled
def root(dx: float, dy: float) -> float:
    """The root that machine code takes: Python's own may differ from it in the last bit."""
    return math.hypot(dx, dy)


@settings(max_examples=1000)
@given(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0), st.floats(0.0, 200.0), st.floats(-2e-9, 2e-9))
def test_within_is_the_root_s_own_answer(dx, dy, reach, nearly):
    for limit in (reach, root(dx, dy), root(dx, dy) * (1.0 + nearly)):
        assert within(dx, dy, limit) == (root(dx, dy) <= limit)
    assert within(dx, dy, math.inf)
    assert not within(math.nan, dy, reach)
