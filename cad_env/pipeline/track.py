"""Detections -> tracks with ids of this vehicle only: SORT in bird's-eye view.

Bewley et al., "Simple online and realtime tracking", ICIP 2016: predict, match, update, spawn, drop. Positions in
the plane take the place of image boxes, the Euclidean gate that of box overlap. Both coordinates share one
covariance, because the model treats them alike.
"""

import math
from typing import NamedTuple

import numpy as np

from cad_env.numerics.assignment import assign
from cad_env.numerics.jit import compiled, compiled_part, inlined_part
from cad_env.types import MAX_TRACKS, STEP, Bools, Floats, Ints
from cad_env.world.geometry import within

_GATE = 3.0  # m; 18 m/s is 1.8 m a frame, so a newborn track of unknown velocity still finds its next detection
BIRTH_HITS = 3  # detections before a track counts
TENTATIVE_MISSES = 1  # misses in a row that end a track before it counts ...
MAX_MISSES = 10  # ... and after: 1 s, about what a passing vehicle hides another for
MANOEUVRE = 4.0  # m/s2, standard deviation of the acceleration between frames
FIRST_SPEED = 15.0  # m/s, standard deviation of an unknown velocity
LEAST_NOISE = 0.05  # m, so that perfect sensors leave the filter well posed


class Tracks(NamedTuple):
    """The tracks of one vehicle; the first `used[0]` rows are in use."""

    used: Ints  # (1,)
    next_id: Ints  # (1,) ids start at 1: 0 is the vehicle's own body
    id: Ints  # (R,)
    mean: Floats  # (R, 4) x, y (m), vx, vy (m/s)
    covariance: Floats  # (R, 3) var(x), cov(x, vx), var(vx); the same for y
    height: Floats  # (R,) m
    kind: Ints  # (R,) int8
    hits: Ints  # (R,) detections so far
    misses: Ints  # (R,) frames since the last
    recent: Floats  # (R, BIRTH_HITS, 3) m, estimates of the newest frames, newest last
    recent_mask: Bools  # (R, BIRTH_HITS)


def empty_tracks(*lead: int) -> Tracks:
    """No tracks yet; leading dimensions stack trackers."""
    return Tracks(
        used=np.zeros((*lead, 1), np.int64),
        next_id=np.ones((*lead, 1), np.int64),
        id=np.zeros((*lead, MAX_TRACKS), np.int64),
        mean=np.zeros((*lead, MAX_TRACKS, 4)),
        covariance=np.zeros((*lead, MAX_TRACKS, 3)),
        height=np.zeros((*lead, MAX_TRACKS)),
        kind=np.zeros((*lead, MAX_TRACKS), np.int8),
        hits=np.zeros((*lead, MAX_TRACKS), np.int64),
        misses=np.zeros((*lead, MAX_TRACKS), np.int64),
        recent=np.zeros((*lead, MAX_TRACKS, BIRTH_HITS, 3)),
        recent_mask=np.zeros((*lead, MAX_TRACKS, BIRTH_HITS), np.bool_),
    )


@compiled
def confirmed(tracks: Tracks, row: int) -> bool:
    """True for a track that has been seen often enough to count."""
    return bool(tracks.hits[row] >= BIRTH_HITS)


@compiled
def seen_now(tracks: Tracks, row: int) -> bool:
    """True for a track that matched a detection of the newest frame."""
    return bool(tracks.misses[row] == 0)


@compiled
def update(tracks: Tracks, position: Floats, kind: Ints, found: int, noise: float) -> None:
    """Take in one frame of `found` detections with the given noise (m)."""
    rows = tracks.used[0]
    cost = np.empty((MAX_TRACKS, MAX_TRACKS))
    match = np.empty(MAX_TRACKS, np.int64)
    for i in range(rows):
        _predict(tracks, i)
        for j in range(found):
            dx, dy = position[j, 0] - tracks.mean[i, 0], position[j, 1] - tracks.mean[i, 1]
            cost[i, j] = math.hypot(dx, dy) if within(dx, dy, _GATE) else math.inf
    assign(cost, rows, found, _GATE, match)
    variance = max(noise, LEAST_NOISE) ** 2
    taken = np.zeros(MAX_TRACKS, np.bool_)
    for i in range(rows):
        tracks.misses[i] += 1
        if match[i] >= 0:
            _correct(tracks, i, position[match[i]], kind[match[i]], variance)
            taken[match[i]] = True
        _remember(tracks, i)
    _drop_lost(tracks)
    for j in range(found):
        if not taken[j] and tracks.used[0] < MAX_TRACKS:
            _spawn(tracks, position[j], kind[j], variance)


@inlined_part
def _predict(tracks: Tracks, i: int) -> None:
    mean, spread = tracks.mean[i], tracks.covariance[i]
    mean[0] += STEP * mean[2]
    mean[1] += STEP * mean[3]
    power = MANOEUVRE * MANOEUVRE
    spread[0] += 2.0 * STEP * spread[1] + STEP * STEP * spread[2] + 0.25 * STEP**4 * power
    spread[1] += STEP * spread[2] + 0.5 * STEP**3 * power
    spread[2] += STEP * STEP * power


@inlined_part
def _correct(tracks: Tracks, i: int, detection: Floats, kind: int, variance: float) -> None:
    mean, spread = tracks.mean[i], tracks.covariance[i]
    gain_place = spread[0] / (spread[0] + variance)
    gain_speed = spread[1] / (spread[0] + variance)
    for axis in range(2):
        surprise = detection[axis] - mean[axis]
        mean[axis] += gain_place * surprise
        mean[axis + 2] += gain_speed * surprise
    spread[2] -= gain_speed * spread[1]
    spread[1] *= 1.0 - gain_place
    spread[0] *= 1.0 - gain_place
    tracks.height[i] = detection[2]
    tracks.kind[i] = kind
    tracks.hits[i] += 1
    tracks.misses[i] = 0


@inlined_part
def _remember(tracks: Tracks, i: int) -> None:
    recent, mask = tracks.recent[i], tracks.recent_mask[i]
    for k in range(BIRTH_HITS - 1):
        mask[k] = mask[k + 1]
        for axis in range(3):
            recent[k, axis] = recent[k + 1, axis]
    mask[BIRTH_HITS - 1] = tracks.misses[i] == 0
    recent[BIRTH_HITS - 1, 0] = tracks.mean[i, 0]
    recent[BIRTH_HITS - 1, 1] = tracks.mean[i, 1]
    recent[BIRTH_HITS - 1, 2] = tracks.height[i]


@inlined_part
def _spawn(tracks: Tracks, detection: Floats, kind: int, variance: float) -> None:
    i = tracks.used[0]
    tracks.used[0] += 1
    tracks.id[i] = tracks.next_id[0]
    tracks.next_id[0] += 1
    tracks.mean[i, 0], tracks.mean[i, 1] = detection[0], detection[1]
    tracks.mean[i, 2], tracks.mean[i, 3] = 0.0, 0.0
    tracks.covariance[i, 0], tracks.covariance[i, 1] = variance, 0.0
    tracks.covariance[i, 2] = FIRST_SPEED * FIRST_SPEED
    tracks.height[i], tracks.kind[i] = detection[2], kind
    tracks.hits[i], tracks.misses[i] = 1, 0
    tracks.recent_mask[i] = False
    _remember(tracks, i)


@compiled_part
def _drop_lost(tracks: Tracks) -> None:
    kept = 0
    for i in range(tracks.used[0]):
        patience = MAX_MISSES if tracks.hits[i] >= BIRTH_HITS else TENTATIVE_MISSES
        if tracks.misses[i] > patience:
            continue
        if kept != i:
            tracks.id[kept], tracks.kind[kept] = tracks.id[i], tracks.kind[i]
            tracks.hits[kept], tracks.misses[kept] = tracks.hits[i], tracks.misses[i]
            tracks.height[kept] = tracks.height[i]
            for k in range(4):
                tracks.mean[kept, k] = tracks.mean[i, k]
            for k in range(3):
                tracks.covariance[kept, k] = tracks.covariance[i, k]
            for k in range(BIRTH_HITS):
                tracks.recent_mask[kept, k] = tracks.recent_mask[i, k]
                for axis in range(3):
                    tracks.recent[kept, k, axis] = tracks.recent[i, k, axis]
        kept += 1
    tracks.used[0] = kept
