"""Who is near whom in a cloud: the nearest points of every point, an even selection of them, and the largest of groups.

Clouds of a batch lie one behind the other, without padding: cloud b is rows first[b] to first[b + 1]. Coordinates are
whole centimetres, so distances are exact, ties are settled by the order of the rows and nothing depends on rounding.
"""

import math

import numpy as np

from cad_env.numerics.jit import compiled, inlined
from cad_env.types import Floats, Ints


@compiled
def nearest(point: Floats, first: Ints, k: int) -> Ints:
    """The rows of the k nearest points of each, (P, k), itself the first; in a smaller cloud itself again and again.

    point (P, 3) cm, in every cloud by rising x, which lets the search stop early; first (B + 1,).
    """
    near = np.empty((len(point), k), np.int64)
    row, distance = np.empty(k, np.int64), np.empty(k)
    for b in range(len(first) - 1):
        for i in range(first[b], first[b + 1]):
            row[:], distance[:] = i, math.inf
            distance[0] = 0.0
            for step in (1, -1):
                j = i + step
                while first[b] <= j < first[b + 1] and (point[j, 0] - point[i, 0]) ** 2 < distance[k - 1]:
                    _insert(distance, row, _apart(point, i, j), j)
                    j += step
            for a in range(k):
                near[i, a] = row[a]
    return near


@inlined
def _apart(point: Floats, i: int, j: int) -> float:
    """The square of a distance."""
    dx, dy, dz = point[i, 0] - point[j, 0], point[i, 1] - point[j, 1], point[i, 2] - point[j, 2]
    return float(dx * dx + dy * dy + dz * dz)


@inlined
def _insert(distance: Floats, row: Ints, far: float, j: int) -> None:
    """Put j at its place among the nearest so far, if it has one; entry 0 is the point itself and stays."""
    a = len(distance) - 1
    if far < distance[a]:
        while a > 1 and distance[a - 1] > far:
            distance[a], row[a] = distance[a - 1], row[a - 1]
            a -= 1
        distance[a], row[a] = far, j


@compiled
def farthest(point: Floats, first: Ints, share: int) -> tuple[Ints, Ints]:
    """One in `share` points of every cloud, rounded up, each as far as can be from those before it.

    Returns the chosen rows in rising order, and where each cloud begins in them, (B + 1,). The first one is the point
    nearest to the origin, so the choice is a function of the cloud. (Farthest point sampling, as in PointNet++.)
    """
    begin = np.zeros(len(first), np.int64)
    for b in range(len(first) - 1):
        begin[b + 1] = begin[b] + (first[b + 1] - first[b] + share - 1) // share
    chosen = np.empty(begin[-1], np.int64)
    gap = np.empty(len(point))
    for b in range(len(first) - 1):
        start, end = first[b], first[b + 1]
        at, least = start, math.inf
        for i in range(start, end):
            gap[i] = math.inf
            far = point[i, 0] ** 2 + point[i, 1] ** 2 + point[i, 2] ** 2
            if far < least:
                at, least = i, far
        for c in range(begin[b], begin[b + 1]):
            chosen[c] = at
            at = _spread(point, gap, start, end, at)
        chosen[begin[b] : begin[b + 1]].sort()
    return chosen, begin


@compiled
def _spread(point: Floats, gap: Floats, start: int, end: int, at: int) -> int:
    """Note how near the newest chosen point is to all others; the row of the one that is farthest from all chosen."""
    x, y, z = point[at, 0], point[at, 1], point[at, 2]
    best, most = at, -1.0
    for i in range(start, end):
        far = (point[i, 0] - x) ** 2 + (point[i, 1] - y) ** 2 + (point[i, 2] - z) ** 2
        gap[i] = min(gap[i], far)
        if gap[i] > most:
            best, most = i, gap[i]
    return best


@compiled
def largest(x: Floats, group: Ints, groups: int) -> Ints:
    """Where the largest of each column of x (N, D) is in each of G groups (N,): rows (G, D), the first of equals.

    A group without members is given row -1.
    """
    row = np.full((groups, x.shape[1]), -1, np.int64)
    for i in range(len(x)):
        g = group[i]
        for d in range(x.shape[1]):
            if row[g, d] < 0 or x[i, d] > x[row[g, d], d]:
                row[g, d] = i
    return row
