"""Oriented boxes: do two touch, does one hide a point. A box is (x, y, heading, length, width)."""

import math

from cad_env.numerics.jit import compiled

CROSSING = math.radians(40.0)  # rad between two headings, above which one does not go along with the other
ALONG = math.cos(CROSSING)


@compiled
def boxes_touch(
    ax: float, ay: float, a_heading: float, a_length: float, a_width: float,
    bx: float, by: float, b_heading: float, b_length: float, b_width: float,
) -> bool:  # fmt: skip
    """True if the two boxes overlap (separating axis theorem; Gottschalk et al., OBBTree, 1996, in the plane)."""
    dx, dy = bx - ax, by - ay
    reach = 0.5 * (math.hypot(a_length, a_width) + math.hypot(b_length, b_width))
    if dx * dx + dy * dy > reach * reach:
        return False
    ac, asn = math.cos(a_heading), math.sin(a_heading)
    bc, bsn = math.cos(b_heading), math.sin(b_heading)
    # Cosine and sine of the angle between the boxes project each box onto the other's axes.
    cross_cos, cross_sin = abs(ac * bc + asn * bsn), abs(ac * bsn - asn * bc)
    al, aw, bl, bw = 0.5 * a_length, 0.5 * a_width, 0.5 * b_length, 0.5 * b_width
    if abs(dx * ac + dy * asn) > al + bl * cross_cos + bw * cross_sin:
        return False
    if abs(-dx * asn + dy * ac) > aw + bl * cross_sin + bw * cross_cos:
        return False
    if abs(dx * bc + dy * bsn) > bl + al * cross_cos + aw * cross_sin:
        return False
    return abs(-dx * bsn + dy * bc) <= bw + al * cross_sin + aw * cross_cos


@compiled
def within(dx: float, dy: float, reach: float) -> bool:
    """Whether hypot(dx, dy) <= reach, to the last bit, and hardly ever at its cost."""
    square, limit = dx * dx + dy * dy, reach * reach
    if square < limit * (1.0 - 1e-9):
        return True
    if square > limit * (1.0 + 1e-9):
        return False
    return math.hypot(dx, dy) <= reach


@compiled
def box_hides(
    x0: float, y0: float, x1: float, y1: float, bx: float, by: float, cos: float, sin: float, length: float,
    width: float,
) -> bool:  # fmt: skip
    """True if the box cuts the line of sight from (x0, y0) to (x1, y1) (slab test in the frame of the box).

    cos and sin are those of the box's heading, because a box is asked for many lines.
    """
    dx, dy = x1 - x0, y1 - y0
    px, py = bx - x0, by - y0
    square = dx * dx + dy * dy
    reach = 0.25 * (length * length + width * width)  # squared radius of the circle around the box
    along = px * dx + py * dy
    cross = px * dy - py * dx
    if cross * cross > reach * square:  # most boxes are nowhere near the line: leave early
        return False
    if along < 0.0 and px * px + py * py > reach:
        return False
    start_x, start_y = -(px * cos + py * sin), px * sin - py * cos
    step_x, step_y = dx * cos + dy * sin, -dx * sin + dy * cos
    near, far = 0.0, 1.0
    for start, step, half in ((start_x, step_x, 0.5 * length), (start_y, step_y, 0.5 * width)):
        if abs(step) < 1e-12:
            if abs(start) > half:
                return False
        else:
            first, second = (-half - start) / step, (half - start) / step
            near = max(near, min(first, second))
            far = min(far, max(first, second))
    return near <= far
