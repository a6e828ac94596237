"""Where a sender's frame is in the receiver's: one rigid transform with its covariance, from what both of them see.

Each vehicle keeps its graph in its own odometry frame. The relation of two such frames changes only by the errors of
their odometries, so it is kept from message to message and refined by each (`registered`):

    predict     the relation stays; its covariance grows with the ways of both
    prior       what the two fixes say, by their stated accuracies; taken where it is surer than what was kept
    candidates  pairs of a sender's track and an own one, bodies included, that the prior lets be one vehicle and that
                have moved equally far in their common frames: that length, like distances, depends on no frame
    choice      two pairs whose distances agree, or one that moves, give a transform in closed form (Kabsch, "A
                solution for the best rotation to relate two sets of vectors", Acta Crystallographica A32, 1976); the
                one with the most pairs within INLIER wins, unless a different one is nearly as good: then nothing is
                learned
    update      least squares over the chosen pairs and the prior, robust, to second order

Who is not sure enough *abstains*: the sender is ignored, and vouches for nothing. So is one whose stated fix is
contradicted: where its pairs fit well, but not where it says to be.

Beside it stand three simpler methods. `fixes`: what the two fixes say is believed. `single`: as above, without a
memory. `nearest`: from the fixes on, nearest neighbours are aligned again and again (Besl and McKay, "A method for
registration of 3-D shapes", IEEE PAMI 14, 1992).
"""

import math
from typing import NamedTuple

import numpy as np

from cad_env.config import PLACINGS
from cad_env.numerics.jit import compiled, compiled_part, inlined_part
from cad_env.numerics.rigid import Pose, between, compose, from_to, pose_of, put_pose_in, turned
from cad_env.pipeline.poses import Poses, has_fix
from cad_env.pipeline.stated_pose import STATED
from cad_env.types import FRAMES, Floats, GraphArrays, Ints

FIXES, NEAREST, SINGLE, REGISTERED = (PLACINGS.index(name) for name in ("fixes", "nearest", "single", "registered"))
UNHEARD, ABSTAINS, PLACED = 0, 1, 2  # how a sender stands with a receiver
NOT_THERE = -1  # in place of the sender's track that is the receiver itself

MOST_SPREAD = 1.25  # m, standard deviation LEVER away from the sender, above which it is not sure enough
LEVER = 30.0  # m
INLIER = 0.9  # m, within which a pair fits a transform
SURE = 0.3  # m, standard deviation of the prior up to which pairs are taken by it alone
_DETECTOR = 0.35  # m, standard deviation of half a track against the same half of another vehicle's
_LASTS = 3.0  # messages over which its errors last
_WAY = 0.07  # of the ways of both, growth of the standard deviation in a step
_TURN = 0.0025  # rad in a step, the same
_LEAST_SPREAD, _LEAST_YAW = 0.05, 0.003  # m and rad, below which no covariance comes
_GATE = 3.5  # standard deviations
_WIDE = (15.0, 0.35)  # m and rad, standard deviations of a prior that says next to nothing
_LEAST_COMMON = 3  # frames
_APART = 6.0  # m between the two pairs of a proposal
_ALIKE = 0.6  # m by which their distances, or ways, may differ
_MOVES = 4.0  # m between its halves, from which on one pair alone shows a heading
_OTHER = (1.5, 0.09)  # m and rad, from which on two transforms are different
_CANDIDATES, _PROPOSALS = 96, 150  # at most
_SEARCHES = 5  # steps between two searches elsewhere
_BORNE_OUT = 10  # messages that must bear a relation out for which no fixes speak
_LEAST_SCORE, _LEAST_ALONE = 1.2, 2.9  # of a transform, with a prior and without
_CONTRADICTED = 16.0  # square of standard deviations, of three numbers, by which fixes may be off


class Relations(NamedTuple):
    """What R receivers make of V senders; of none where poses are exact."""

    stated: Floats  # (R, V, STATED) of the newest message
    sent: Ints  # (R, V) step of it
    new: Ints  # (R, V) 1 in the step in which it came
    body: Floats  # (R, V, 3) the sender's body then, in its own frame
    there: Floats  # (R, V, 3) the same in the receiver's frame
    covariance: Floats  # (R, V, 3, 3) of `there`
    state: Ints  # (R, V) UNHEARD, ABSTAINS or PLACED
    kept: Ints  # (R, V) 1 where pairs have refined `there`
    support: Ints  # (R, V) messages by which pairs have borne out `there`, less those by which they have not
    me: Ints  # (R, V) the sender's track that is the receiver, or NOT_THERE
    rows: GraphArrays  # scratch: a sender's rows in the receiver's frame
    spread: Floats  # scratch: (rows,) m, their standard deviations
    pair: Ints  # scratch: (C, 2) candidates: rows of the sender and the receiver
    halves: Floats  # scratch: (C, 8) m: x, y of the older and the newer half, sender's, then receiver's
    weight: Floats  # scratch: (C,) of the chosen ones, else 0
    best: Ints  # scratch: (rows,) the candidate of each sender's row


def new_relations(receivers: int, vehicles: int, rows: GraphArrays, exact: bool) -> Relations:
    """Nobody is known yet. rows: an empty graph to keep as scratch."""
    shape = (0, 0) if exact else (receivers, vehicles)
    most = len(rows.track)
    return Relations(
        stated=np.zeros((*shape, STATED)),
        sent=np.zeros(shape, np.int64),
        new=np.zeros(shape, np.int64),
        body=np.zeros((*shape, 3)),
        there=np.zeros((*shape, 3)),
        covariance=np.zeros((*shape, 3, 3)),
        state=np.full(shape, UNHEARD),
        kept=np.zeros(shape, np.int64),
        support=np.zeros(shape, np.int64),
        me=np.full(shape, NOT_THERE),
        rows=rows,
        spread=np.zeros(most),
        pair=np.zeros((_CANDIDATES, 2), np.int64),
        halves=np.zeros((_CANDIDATES, 8)),
        weight=np.zeros(_CANDIDATES),
        best=np.zeros(most, np.int64),
    )


@compiled_part
def hear(relations: Relations, r: int, v: int, kept: GraphArrays, stated: Floats, sent: int, age: int) -> None:
    """Take in the pose (STATED,) that a message of step `sent` states; kept: its rows, already received."""
    newest = FRAMES - 1 - age
    body = (kept.position[0, newest, 0], kept.position[0, newest, 1], stated[0])
    if relations.state[r, v] != UNHEARD:
        _go_on(relations, r, v, body, sent - relations.sent[r, v])
    put_pose_in(relations.body[r, v], body)
    for k in range(STATED):
        relations.stated[r, v, k] = stated[k]
    relations.sent[r, v], relations.new[r, v] = sent, 1


@inlined_part
def _go_on(relations: Relations, r: int, v: int, body: Pose, steps: int) -> None:
    """Move what is known of a sender on to its newest body, by its odometry."""
    there, covariance = relations.there[r, v], relations.covariance[r, v]
    way = between(pose_of(relations.body[r, v]), body)
    before = pose_of(there)
    after = compose(before, way)
    _carry(covariance, after[0] - before[0], after[1] - before[1])
    put_pose_in(there, after)
    covariance[2, 2] += steps * _TURN**2


@inlined_part
def _carry(covariance: Floats, dx: float, dy: float) -> None:
    """Turn the covariance of a pose into that of a pose (dx, dy) m away on the same rigid body."""
    for i, lever in ((0, -dy), (1, dx)):
        for j in range(3):
            covariance[i, j] += lever * covariance[2, j]
    for i, lever in ((0, -dy), (1, dx)):
        for j in range(3):
            covariance[j, i] += lever * covariance[j, 2]


@compiled_part
def place_sender(
    relations: Relations, poses: Poses, r: int, v: int, own: GraphArrays, kept: GraphArrays, trail: Floats
) -> None:
    """Place sender v in receiver r's frame, if a message of it has come; own and kept: the rows of both."""
    if relations.new[r, v] == 0:
        return
    relations.new[r, v] = 0
    placing = poses.model.placing
    there, covariance = relations.there[r, v], relations.covariance[r, v]
    fix, by_fix = np.empty(3), np.empty((3, 3))
    said = _by_fixes(relations, poses, r, v, trail, fix, by_fix)
    known = placing == REGISTERED and relations.kept[r, v] != 0
    if known:
        _spread_out(covariance, _way_of(own) + _way_of(kept))
    if said and (not known or spread_at(by_fix, LEVER) < spread_at(covariance, LEVER)):
        known = True
        for i in range(3):
            there[i] = fix[i]
            for j in range(3):
                covariance[i, j] = by_fix[i, j]
    relations.me[r, v] = NOT_THERE
    if placing == FIXES:
        relations.state[r, v] = PLACED if said else ABSTAINS
    elif placing == NEAREST:
        relations.state[r, v] = _align(relations, r, v, own, kept) if said else ABSTAINS
    else:
        placed = _match(relations, r, v, own, kept, known, said, placing == SINGLE)
        placed = placed and spread_at(covariance, LEVER) <= MOST_SPREAD
        contradicted = said and _off(there, fix, covariance, by_fix) > _CONTRADICTED
        relations.state[r, v] = PLACED if placed and not contradicted else ABSTAINS


@inlined_part
def _by_fixes(relations: Relations, poses: Poses, r: int, v: int, trail: Floats, fix: Floats, spread: Floats) -> bool:
    """Write to fix (3,) and spread (3, 3) where the two fixes place the sender's body; False if one is missing."""
    stated = relations.stated[r, v]
    if stated[6] == 0.0 or not has_fix(poses, r):
        return False
    frame = from_to(pose_of(poses.fix[r]), pose_of(trail[FRAMES - 1]))
    pose = compose(frame, (stated[1], stated[2], stated[3]))
    fix[0], fix[1], fix[2] = pose[0], pose[1], turned(pose[2])
    own = poses.accuracy[r]
    for i in range(3):
        for j in range(3):
            spread[i, j] = 0.0
    spread[0, 0] = spread[1, 1] = own[0] ** 2 + _LEAST_SPREAD**2
    spread[2, 2] = own[1] ** 2 + _LEAST_YAW**2
    _carry(spread, pose[0] - trail[FRAMES - 1, 0], pose[1] - trail[FRAMES - 1, 1])
    spread[0, 0] += stated[4] ** 2
    spread[1, 1] += stated[4] ** 2
    spread[2, 2] += stated[5] ** 2
    return True


@inlined_part
def _way_of(rows: GraphArrays) -> float:
    """m that the body in row 0 has moved in a step of late."""
    newest = FRAMES - 1
    while newest > 1 and not rows.mask[0, newest]:
        newest -= 1
    if not rows.mask[0, newest - 1]:
        return 0.0
    return math.hypot(
        rows.position[0, newest, 0] - rows.position[0, newest - 1, 0],
        rows.position[0, newest, 1] - rows.position[0, newest - 1, 1],
    )


@inlined_part
def _spread_out(covariance: Floats, way: float) -> None:
    covariance[0, 0] += (_WAY * way) ** 2
    covariance[1, 1] += (_WAY * way) ** 2
    covariance[2, 2] += _TURN**2


@compiled_part
def spread_at(covariance: Floats, away: float) -> float:
    """m, standard deviation of each coordinate of what is so far away from the sender."""
    return math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1]) + away * away * covariance[2, 2])


@compiled_part
def _match(relations: Relations, r: int, v: int, own: GraphArrays, kept: GraphArrays, known: bool, said: bool,
           single: bool) -> bool:  # fmt: skip
    """Refine `there` by the pairs that fit; answers whether the sender's place is known."""
    there, covariance, support = relations.there[r, v], relations.covariance[r, v], relations.support[r]
    body, searches = pose_of(relations.body[r, v]), single or (relations.sent[r, v] + v) % _SEARCHES == 0
    chosen = count = 0
    if known or searches:
        count = _candidates(relations, own, kept, body, there, covariance, known)
        chosen = _choose(relations, count, body, there, covariance, known)
    if chosen > 0:
        _refine(relations, count, body, there, covariance, known, 1.0 if single else _LASTS)
        _find_me(relations, r, v, kept, count)
        relations.kept[r, v], support[v] = 1, min(max(support[v], 0) + 1, 2 * _BORNE_OUT)
    elif support[v] < 0:
        support[v] += 1
    elif known and searches and _fits_elsewhere(relations, own, kept, body, there):
        relations.kept[r, v], support[v] = 0, -2 * _SEARCHES
    elif known and not said:
        support[v] -= 1
        relations.kept[r, v] = support[v] > 0
    return bool(support[v] >= (0 if said else 1 if single else _BORNE_OUT) and (known or chosen > 0))


@inlined_part
def _fits_elsewhere(relations: Relations, own: GraphArrays, kept: GraphArrays, body: Pose, there: Floats) -> bool:
    """Whether pairs fit well where the sender is not taken to be."""
    elsewhere, wide = there.copy(), np.zeros((3, 3))
    wide[0, 0] = wide[1, 1] = _WIDE[0] ** 2
    wide[2, 2] = _WIDE[1] ** 2
    count = _candidates(relations, own, kept, body, elsewhere, wide, True)
    return _choose(relations, count, body, elsewhere, wide, True) >= 3


@inlined_part
def _find_me(relations: Relations, r: int, v: int, kept: GraphArrays, count: int) -> None:
    """Note which of the sender's tracks is the receiver."""
    for c in range(count):
        if relations.weight[c] > 0.0 and relations.pair[c, 1] == 0:
            relations.me[r, v] = kept.track[relations.pair[c, 0]]


@compiled_part
def _candidates(relations: Relations, own: GraphArrays, kept: GraphArrays, body: Pose, there: Floats,
                covariance: Floats, known: bool) -> int:  # fmt: skip
    """Write down the pairs of tracks that may be one vehicle, and answer how many."""
    frame, count = from_to(body, pose_of(there)), 0
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    near, turn = 0.5 * (covariance[0, 0] + covariance[1, 1]), covariance[2, 2]
    for s in range(kept.used[0]):
        for e in range(own.used[0]):
            if count == _CANDIDATES or kept.kind[s] != own.kind[e] or (kept.track[s] == 0 and e == 0):
                continue
            common, newest = 0, -1
            for t in range(FRAMES):
                if kept.mask[s, t] and own.mask[e, t]:
                    common, newest = common + 1, t
            if common < _LEAST_COMMON:
                continue
            if known:
                x, y = kept.position[s, newest, 0], kept.position[s, newest, 1]
                dx = frame[0] + x * cos - y * sin - own.position[e, newest, 0]
                dy = frame[1] + x * sin + y * cos - own.position[e, newest, 1]
                away = (x - body[0]) ** 2 + (y - body[1]) ** 2
                gate = INLIER + _GATE * math.sqrt(near + away * turn)
                if dx * dx + dy * dy > gate * gate:
                    continue
            halves = relations.halves[count]
            _halve(kept, s, own, e, common, halves)
            moved = math.hypot(halves[2] - halves[0], halves[3] - halves[1])
            if abs(moved - math.hypot(halves[6] - halves[4], halves[7] - halves[5])) > _ALIKE:
                continue
            relations.pair[count, 0], relations.pair[count, 1] = s, e
            count += 1
    return count


@inlined_part
def _halve(kept: GraphArrays, s: int, own: GraphArrays, e: int, common: int, halves: Floats) -> None:
    """Write the means of the older and of the newer half of the common frames, of both."""
    for k in range(8):
        halves[k] = 0.0
    older, seen = (common + 1) // 2, 0
    newer = common - older
    for t in range(FRAMES):
        if kept.mask[s, t] and own.mask[e, t]:
            first = 0 if seen < older else 2
            share = 1.0 / (older if seen < older else newer)
            for axis in range(2):
                halves[first + axis] += share * kept.position[s, t, axis]
                halves[4 + first + axis] += share * own.position[e, t, axis]
            seen += 1


@compiled_part
def _choose(relations: Relations, count: int, body: Pose, there: Floats, covariance: Floats, known: bool) -> int:
    """Set the weights of the pairs that the best transform explains, put it into `there`, and answer how many."""
    if count == 0:
        return 0
    if known and spread_at(covariance, LEVER) < SURE:
        return _accept(relations, count, from_to(body, pose_of(there)))
    inverse = np.zeros((3, 3))
    if known:
        _invert(covariance, inverse)
    best, second, pose, proposals = 0.0, 0.0, pose_of(there), 0
    for a in range(count):
        for b in range(a, count):
            if proposals == _PROPOSALS:
                break
            if not _proposes(relations, a, b):
                continue
            frame = _kabsch(relations.halves, a, b)
            found = compose(frame, body)
            off = _square(found, there, inverse) if known else 0.0
            if off > _GATE * _GATE:
                continue
            proposals += 1
            score = _score(relations, count, frame) - 0.1 * off
            other = math.hypot(found[0] - pose[0], found[1] - pose[1]) > _OTHER[0]
            other = other or abs(turned(found[2] - pose[2])) > _OTHER[1]
            if score > best:
                if other or best == 0.0:
                    second = best
                best, pose = score, found
            elif other and score > second:
                second = score
    if best < (_LEAST_SCORE if known else _LEAST_ALONE) or second > best - 0.5:
        return 0
    if not known:  # which the least squares then begin from
        put_pose_in(there, (pose[0], pose[1], turned(pose[2])))
    return _accept(relations, count, from_to(body, pose))


@inlined_part
def _proposes(relations: Relations, a: int, b: int) -> bool:
    """Whether pairs a and b can be two vehicles with equal distances, or a, where b is a too, shows a heading."""
    one, two = relations.halves[a], relations.halves[b]
    if a == b:
        return bool(math.hypot(one[2] - one[0], one[3] - one[1]) > _MOVES)
    if relations.pair[a, 0] == relations.pair[b, 0] or relations.pair[a, 1] == relations.pair[b, 1]:
        return False
    theirs = math.hypot(two[2] - one[2], two[3] - one[3])
    mine = math.hypot(two[6] - one[6], two[7] - one[7])
    return bool(theirs > _APART and abs(theirs - mine) < _ALIKE)


@inlined_part
def _kabsch(halves: Floats, a: int, b: int) -> Pose:
    """The rigid transform that takes the sender's points of pairs a and b nearest to the receiver's."""
    sx = sy = ex = ey = 0.0
    for c in (a, b):
        for k in (0, 2):
            sx += 0.25 * halves[c, k]
            sy += 0.25 * halves[c, k + 1]
            ex += 0.25 * halves[c, k + 4]
            ey += 0.25 * halves[c, k + 5]
    dot = cross = 0.0
    for c in (a, b):
        for k in (0, 2):
            px, py = halves[c, k] - sx, halves[c, k + 1] - sy
            qx, qy = halves[c, k + 4] - ex, halves[c, k + 5] - ey
            dot += px * qx + py * qy
            cross += px * qy - py * qx
    angle = math.atan2(cross, dot)
    cos, sin = math.cos(angle), math.sin(angle)
    return (ex - sx * cos + sy * sin, ey - sx * sin - sy * cos, angle)


@compiled_part
def _invert(matrix: Floats, inverse: Floats) -> None:
    """Write the inverse of a symmetric, positive matrix (3, 3)."""
    a, b, c, d, e, f = matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[1, 1], matrix[1, 2], matrix[2, 2]
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    share = 1.0 / (a * inverse[0, 0] + b * inverse[0, 1] + c * inverse[0, 2])
    inverse[1, 1], inverse[1, 2], inverse[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    for i in range(3):
        for j in range(i, 3):
            inverse[i, j] *= share
            inverse[j, i] = inverse[i, j]


@inlined_part
def _square(pose: Pose, mean: Floats, inverse: Floats) -> float:
    """The square of the distance of a pose from a mean, in standard deviations."""
    d = (pose[0] - mean[0], pose[1] - mean[1], turned(pose[2] - mean[2]))
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += d[i] * inverse[i, j] * d[j]
    return total


@inlined_part
def _misfit(halves: Floats, c: int, x: float, y: float, cos: float, sin: float) -> float:
    """m, the larger distance of the two halves of a pair under a transform."""
    h, most = halves[c], 0.0
    for k in (0, 2):
        dx = x + h[k] * cos - h[k + 1] * sin - h[k + 4]
        dy = y + h[k] * sin + h[k + 1] * cos - h[k + 5]
        most = max(most, dx * dx + dy * dy)
    return math.sqrt(most)


@compiled_part
def _score(relations: Relations, count: int, frame: Pose) -> float:
    """How many of the sender's rows fit, each counted by how well; the bodies, whose identity is half known, more."""
    cos, sin, total, row, best = math.cos(frame[2]), math.sin(frame[2]), 0.0, -1, 0.0
    for c in range(count):  # candidates come in the order of the sender's rows
        if relations.pair[c, 0] != row:
            total, row, best = total + best, relations.pair[c, 0], 0.0
        misfit = _misfit(relations.halves, c, frame[0], frame[1], cos, sin)
        if misfit < INLIER:
            worth = 1.25 if row == 0 or relations.pair[c, 1] == 0 else 1.0
            best = max(best, worth * (1.0 - 0.5 * (misfit / INLIER) ** 2))
    return total + best


@compiled_part
def _accept(relations: Relations, count: int, frame: Pose) -> int:
    """Give weight to the pairs within INLIER that are each other's nearest, and answer how many."""
    cos, sin, chosen = math.cos(frame[2]), math.sin(frame[2]), 0
    for c in range(count):
        relations.weight[c] = _misfit(relations.halves, c, frame[0], frame[1], cos, sin)
    for c in range(count):
        mine = abs(relations.weight[c])
        nearest = mine < INLIER
        for other in range(count):
            shares = (
                relations.pair[c, 0] == relations.pair[other, 0] or relations.pair[c, 1] == relations.pair[other, 1]
            )
            if other != c and shares and abs(relations.weight[other]) < mine:
                nearest = False
        if nearest:
            relations.weight[c] = -mine - 1e-9
    for c in range(count):
        fits = relations.weight[c] < 0.0
        relations.weight[c] = 1.0 if fits else 0.0
        chosen += fits
    return chosen


@compiled_part
def _refine(relations: Relations, count: int, body: Pose, there: Floats, covariance: Floats, known: bool,
            lasts: float) -> None:  # fmt: skip
    """Least squares over the chosen pairs and, where something is known, what is: Gauss and Newton's, two steps."""
    prior, mean = np.zeros((3, 3)), there.copy()
    if known:
        _invert(covariance, prior)
    information, found = prior.copy(), np.empty((3, 3))
    for _ in range(2):
        pull = np.zeros(3)
        for i in range(3):
            for j in range(3):
                information[i, j] = prior[i, j]
                pull[i] += prior[i, j] * (turned(mean[j] - there[j]) if j == 2 else mean[j] - there[j])
        _add_pairs(relations, count, body, there, information, pull, lasts)
        _invert(information, found)
        for i in range(3):
            there[i] += found[i, 0] * pull[0] + found[i, 1] * pull[1] + found[i, 2] * pull[2]
    for i in range(3):
        for j in range(3):
            covariance[i, j] = found[i, j]
    covariance[0, 0] = max(covariance[0, 0], _LEAST_SPREAD**2)
    covariance[1, 1] = max(covariance[1, 1], _LEAST_SPREAD**2)
    covariance[2, 2] = max(covariance[2, 2], _LEAST_YAW**2)
    there[2] = turned(there[2])


@inlined_part
def _add_pairs(relations: Relations, count: int, body: Pose, there: Floats, information: Floats, pull: Floats,
               lasts: float) -> None:  # fmt: skip
    frame = from_to(body, pose_of(there))
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    for c in range(count):
        if relations.weight[c] == 0.0:
            continue
        h = relations.halves[c]
        for k in (0, 2):
            x, y = frame[0] + h[k] * cos - h[k + 1] * sin, frame[1] + h[k] * sin + h[k + 1] * cos
            ax, ay = there[1] - y, x - there[0]  # how the point moves with the heading
            dx, dy = h[k + 4] - x, h[k + 5] - y
            weight = 1.0 / (lasts * _DETECTOR**2 * (1.0 + 4.0 * (dx * dx + dy * dy)))
            pull[0] += weight * dx
            pull[1] += weight * dy
            pull[2] += weight * (ax * dx + ay * dy)
            information[0, 0] += weight
            information[1, 1] += weight
            information[2, 2] += weight * (ax * ax + ay * ay)
            information[0, 2] += weight * ax
            information[2, 0] += weight * ax
            information[1, 2] += weight * ay
            information[2, 1] += weight * ay


@inlined_part
def _off(there: Floats, fix: Floats, covariance: Floats, by_fix: Floats) -> float:
    """The square of the distance of what pairs say from what fixes say, in standard deviations of both."""
    both, inverse = np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            both[i, j] = covariance[i, j] + by_fix[i, j]
    _invert(both, inverse)
    return _square(pose_of(there), fix, inverse)


@compiled_part
def _align(relations: Relations, r: int, v: int, own: GraphArrays, kept: GraphArrays) -> int:
    """Iterate: each of the sender's rows takes the nearest own one within 3 m, and all are aligned."""
    there, covariance = relations.there[r, v], relations.covariance[r, v]
    body, wide = pose_of(relations.body[r, v]), np.zeros((3, 3))
    wide[0, 0] = wide[1, 1] = 1.0
    count = _candidates(relations, own, kept, body, there, wide, True)
    found = 0
    for _ in range(8):
        frame, found, row = from_to(body, pose_of(there)), 0, -1
        cos, sin = math.cos(frame[2]), math.sin(frame[2])
        for c in range(count):
            relations.weight[c] = 0.0
        for c in range(count):
            if relations.pair[c, 0] == row:
                continue
            row, nearest, best = relations.pair[c, 0], 3.0, -1
            for other in range(c, count):
                if relations.pair[other, 0] == row:
                    misfit = _misfit(relations.halves, other, frame[0], frame[1], cos, sin)
                    if misfit < nearest:
                        nearest, best = misfit, other
            if best >= 0:
                relations.weight[best] = 1.0
                found += 1
        if found < 2:
            return PLACED
        _refine(relations, count, body, there, covariance, False, 1.0)
    return PLACED


@compiled
def place_rows(relations: Relations, r: int, v: int, kept: GraphArrays) -> None:
    """Write a placed sender's rows in the receiver's frame, with their standard deviations, to `rows` and `spread`."""
    rows = relations.rows
    body, there = pose_of(relations.body[r, v]), pose_of(relations.there[r, v])
    covariance, frame = relations.covariance[r, v], from_to(body, there)
    cos, sin, count = math.cos(frame[2]), math.sin(frame[2]), 0
    for i in range(kept.used[0]):
        if kept.track[i] == relations.me[r, v]:
            continue
        rows.track[count], rows.kind[count] = kept.track[i], kept.kind[i]
        away = 0.0
        for t in range(FRAMES):
            x, y = kept.position[i, t, 0], kept.position[i, t, 1]
            rows.mask[count, t] = kept.mask[i, t]
            rows.position[count, t, 0] = frame[0] + x * cos - y * sin
            rows.position[count, t, 1] = frame[1] + x * sin + y * cos
            rows.position[count, t, 2] = kept.position[i, t, 2]
            if kept.mask[i, t]:
                away = math.hypot(x - body[0], y - body[1])
        relations.spread[count] = spread_at(covariance, away)
        count += 1
    rows.used[0] = count
