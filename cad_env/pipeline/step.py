"""One decision's perception and communication for a fleet: the stages in their order, as one compiled function."""

import numpy as np

from cad_env.numerics.jit import inlined_part
from cad_env.pipeline.codec import DECODED as READ
from cad_env.pipeline.codec import read, read_with_places, read_with_pose, write, write_with_places, write_with_pose
from cad_env.pipeline.coverage import look_at_lanes, outer_corners, shrink, vouch
from cad_env.pipeline.fleet import OWN, Fleet
from cad_env.pipeline.graph import add_body, add_track
from cad_env.pipeline.graph_arrays import slide
from cad_env.pipeline.hidden import grow, hidden_at, note_known, take_out
from cad_env.pipeline.merge import CLOSE, finish_merge, receive, start_merge, take_in, take_in_placed
from cad_env.pipeline.observe import observe_ego, observe_tracks, view_at
from cad_env.pipeline.observe_lanes import lane_view_at, observe_lanes
from cad_env.pipeline.poses import frame_to, has_fix, move
from cad_env.pipeline.radio import (
    ACCEPTED,
    LOST,
    NOT_SENT,
    REACHES,
    SILENT,
    STEP_MS,
    Link,
    fate,
    fetch,
    is_as_sent,
    send,
)
from cad_env.pipeline.register import LEVER, PLACED, hear, place_rows, place_sender, spread_at
from cad_env.pipeline.sense import CENTRE_HEIGHT, Sensing, fix_pose, outline, sense
from cad_env.pipeline.track import Tracks, confirmed, seen_now, update
from cad_env.types import FRAMES, Bytes, Floats, GraphArrays, Ints
from cad_env.world.lanes import Lanes
from cad_env.world.state import OFF, Routes, World

SENSE, RADIO, POSE = 0, 1, 2  # rows of the stream keys
UNREAD, REFUSED = -1, -2  # in place of a message's length
# First rows of a graph to merge: row 0 of the own one is the own body. Of a numpy type, because numba compiles a
# function anew for every plain number that is written in a call of it.
ALL, OTHERS = np.int64(0), np.int64(1)


@inlined_part
def run(world: World, routes: Routes, lanes: Lanes, fleet: Fleet, sensor: Sensing, link: Link, depth: int, keys: Ints,
        step: int) -> None:  # fmt: skip
    """Sense, track, graph, encode and send for every vehicle; then deliver, merge and observe for every receiver."""
    outline(world, fleet.outlines)
    outer_corners(world, fleet.outlines, fleet.coverage.corner)
    for v in range(fleet.rows.shape[0]):
        if is_gone(world, fleet, v):
            fall_silent(fleet, v)
        else:
            perceive(world, routes, fleet, v, sensor, keys, step)
            if shares_coverage(fleet) and (link.budget > 0.0 or v < fleet.merged.used.shape[0]):
                cover(world, lanes, fleet, v, sensor)
            broadcast(world, fleet, v, link, depth, step)
    deliver(world, lanes, fleet, link, keys[RADIO], step)
    merge_all(world, routes, lanes, fleet, step)


@inlined_part
def merge_all(world: World, routes: Routes, lanes: Lanes, fleet: Fleet, step: int) -> None:
    """Merge and observe for every receiver."""
    for r in range(fleet.merged.used.shape[0]):
        fuse(fleet, r)
        show(world, routes, fleet, r)
        if shares_coverage(fleet):
            show_lanes(world, routes, lanes, fleet, r, step)


@inlined_part
def shares_coverage(fleet: Fleet) -> bool:
    """Whether messages say what was seen to be empty."""
    return bool(fleet.places.shape[0] > 0)


@inlined_part
def has_poses(fleet: Fleet) -> bool:
    """Whether vehicles know their poses with errors, and each keeps what it knows in a frame of its own."""
    return bool(fleet.poses.place.shape[0] > 0)


@inlined_part
def _place_of(fleet: Fleet, v: int) -> Floats:
    """(3,) where vehicle v takes itself to be on the map."""
    place: Floats = fleet.poses.place[v] if has_poses(fleet) else fleet.trail[v, FRAMES - 1]
    return place


@inlined_part
def _frame_of(fleet: Fleet, v: int) -> Floats:
    """(3,) the change of frames from that in which vehicle v tracks to the map."""
    if has_poses(fleet):
        frame_to(fleet.trail[v], fleet.poses.place[v], fleet.frame)
    return fleet.frame


@inlined_part
def is_gone(world: World, fleet: Fleet, v: int) -> bool:
    """Whether connected vehicle v has left the map: it does not sense, send or receive any more."""
    return bool(world.driver[fleet.rows[v]] == OFF)


@inlined_part
def fall_silent(fleet: Fleet, v: int) -> None:
    """One frame of a vehicle that is gone: what it knew gets older, and it sends nothing."""
    slide(_rows_at(fleet.window, v))
    for row in range(fleet.visible.shape[1]):
        fleet.visible[v, row] = False
    fleet.coverage.vouched[v] = 0
    fleet.report.refusal[v], fleet.report.sent_bytes[v] = SILENT, 0
    fleet.injected.length[v] = OWN


@inlined_part
def perceive(world: World, routes: Routes, fleet: Fleet, v: int, sensor: Sensing, keys: Ints, step: int) -> None:
    """One frame of one vehicle: fix, detections, tracks, and the window of its graph."""
    row, trail, key = fleet.rows[v], fleet.trail[v], keys[SENSE]
    tracks, window = _tracks_at(fleet.tracks, v), _rows_at(fleet.window, v)
    for t in range(FRAMES - 1):
        for axis in range(3):
            trail[t, axis] = trail[t + 1, axis]
    pose = trail[FRAMES - 1]
    if has_poses(fleet):
        move(fleet.poses, v, world, routes, row, keys[POSE], step, trail)
    else:
        fix_pose(world, row, sensor, key, step, pose)
    if step == 0:  # nothing is known of the time before the start: the vehicle is taken to have stood there
        for t in range(FRAMES - 1):
            for axis in range(3):
                trail[t, axis] = pose[axis]
    found = sense(
        world, fleet.outlines, row, sensor, key, step, pose, fleet.detection, fleet.detected_kind, fleet.visible[v],
        fleet.near,
    )  # fmt: skip
    update(tracks, fleet.detection, fleet.detected_kind, found, sensor.noise)
    slide(window)
    add_body(window, pose, CENTRE_HEIGHT[world.kind[row]], world.kind[row])
    for i in range(tracks.used[0]):
        if confirmed(tracks, i) and seen_now(tracks, i):
            add_track(window, tracks.id[i], tracks.kind[i], tracks.recent[i], tracks.recent_mask[i])


@inlined_part
def cover(world: World, lanes: Lanes, fleet: Fleet, v: int, sensor: Sensing) -> None:
    """One frame of what one vehicle sees to be empty, after it has perceived what is there."""
    coverage, pose = fleet.coverage, _place_of(fleet, v)
    look_at_lanes(
        world, fleet.outlines, lanes, fleet.rows[v], sensor, pose, coverage.seen[v], coverage.corner, coverage.near,
        fleet.near,
    )  # fmt: skip
    vouch(lanes, _tracks_at(fleet.tracks, v), pose, _frame_of(fleet, v), coverage.seen[v], coverage.vouched[v])


@inlined_part
def broadcast(world: World, fleet: Fleet, v: int, link: Link, depth: int, step: int) -> None:
    """Write one vehicle's graph as bytes and hand them to the radio."""
    size = _take_injected(fleet, v)
    if size == OWN:
        size = 0
        if link.budget > 0.0:  # a radio without a budget refuses whatever is written: spare the writing
            size = _write_to(fleet, v, STEP_MS * step, depth)
    place = world.position[fleet.rows[v]]
    reason = send(fleet.air, link, step, v, fleet.buffer, size, place[0], place[1])
    fleet.report.refusal[v] = reason
    fleet.report.sent_bytes[v] = size if reason == ACCEPTED else 0


@inlined_part
def _write_to(fleet: Fleet, v: int, time_ms: int, depth: int) -> int:
    window = _rows_at(fleet.window, v)
    if has_poses(fleet):
        shrink(fleet.coverage.vouched[v], fleet.poses.accuracy[v, 0], fleet.shrunk)
        _state_pose(fleet, v)
        return write_with_pose(fleet.buffer, v, time_ms, depth, window, fleet.shrunk, fleet.stated)
    if shares_coverage(fleet):
        return write_with_places(fleet.buffer, v, time_ms, depth, window, fleet.coverage.vouched[v])
    return write(fleet.buffer, v, time_ms, depth, window)


@inlined_part
def _state_pose(fleet: Fleet, v: int) -> None:
    poses, stated = fleet.poses, fleet.stated
    stated[0] = fleet.trail[v, FRAMES - 1, 2]
    for k in range(3):
        stated[1 + k] = poses.fix[v, k]
    stated[4], stated[5], stated[6] = poses.accuracy[v, 0], poses.accuracy[v, 1], has_fix(poses, v)


@inlined_part
def _take_injected(fleet: Fleet, v: int) -> int:
    """Move what vehicle v is to send from outside to the buffer; answers its length, or OWN."""
    size = int(fleet.injected.length[v])
    for index in range(size):
        fleet.buffer[index] = fleet.injected.payload[v, index]
    fleet.injected.length[v] = OWN
    return size


@inlined_part
def deliver(world: World, lanes: Lanes, fleet: Fleet, link: Link, key: Ints, step: int) -> None:
    """Give what arrives to every receiver that it reaches; a message is parsed once, if it reaches any."""
    report = fleet.report
    receivers = fleet.merged.used.shape[0]
    for r in range(receivers):
        report.received_bytes[r] = report.lost[r] = report.messages_refused[r] = 0
        for v in range(fleet.rows.shape[0]):
            slide(_kept_at(fleet.kept, r, v))
        if shares_coverage(fleet):
            grow(hidden_at(fleet.hidden, r), lanes, world.route[fleet.rows[r]])
            _take_out(world, lanes, fleet, r, fleet.coverage.vouched[r], step, 0)
    for v in range(fleet.rows.shape[0]):
        length = UNREAD
        for r in range(receivers):
            end = NOT_SENT if is_gone(world, fleet, r) else fate(fleet.air, link, key, step, v, r)
            report.lost[r] += end == LOST
            if end != REACHES:
                continue
            if length == UNREAD:
                length = _read_from(fleet, link, v, step)
            if length == REFUSED:
                report.messages_refused[r] += 1
                continue
            report.received_bytes[r] += length
            receive(_kept_at(fleet.kept, r, v), fleet.message, fleet.header[2], link.delay)
            if has_poses(fleet):
                _find(fleet, r, v, step - link.delay, link.delay)
            if shares_coverage(fleet):
                _believe(world, lanes, fleet, r, v, step, link.delay)


@inlined_part
def _find(fleet: Fleet, r: int, v: int, sent: int, age: int) -> None:
    """Place the sender of the message that receiver r has just received in the frame of r."""
    hear(fleet.relations, r, v, _kept_at(fleet.kept, r, v), fleet.stated, sent, age)
    place_sender(
        fleet.relations, fleet.poses, r, v, _rows_at(fleet.window, r), _kept_at(fleet.kept, r, v), fleet.trail[r]
    )  # fmt: skip


@inlined_part
def _believe(world: World, lanes: Lanes, fleet: Fleet, r: int, v: int, step: int, age: int) -> None:
    """Take out what the sender of the message being read vouches for, as far as it is known where that is."""
    if not has_poses(fleet):
        _take_out(world, lanes, fleet, r, fleet.places, step, age)
    elif fleet.relations.state[r, v] == PLACED:
        shrink(fleet.places, spread_at(fleet.relations.covariance[r, v], LEVER), fleet.shrunk)
        _take_out(world, lanes, fleet, r, fleet.shrunk, step, age)


@inlined_part
def _take_out(world: World, lanes: Lanes, fleet: Fleet, r: int, places: Bytes, step: int, age: int) -> None:
    take_out(hidden_at(fleet.hidden, r), lanes, world.route[fleet.rows[r]], places, step, age)


@inlined_part
def _read_from(fleet: Fleet, link: Link, v: int, step: int) -> int:
    """Read the message that arrives from vehicle v; answers its length, or REFUSED if any of it is not acceptable."""
    length = fetch(fleet.air, link, step, v, fleet.buffer)
    if _read_message(fleet, length) != READ:
        return REFUSED
    return length if is_as_sent(fleet.header[0], fleet.header[1], v, step - link.delay) else REFUSED


@inlined_part
def _read_message(fleet: Fleet, length: int) -> int:
    if has_poses(fleet):
        return read_with_pose(fleet.buffer, length, fleet.header, fleet.message, fleet.places, fleet.stated)
    if shares_coverage(fleet):
        return read_with_places(fleet.buffer, length, fleet.header, fleet.message, fleet.places)
    return read(fleet.buffer, length, fleet.header, fleet.message)


@inlined_part
def fuse(fleet: Fleet, r: int) -> None:
    """Merge what receiver r knows by itself with what it holds of the others, in the order of their numbers."""
    merged, trail = _rows_at(fleet.merged, r), fleet.trail[r]
    start_merge(merged)
    take_in(merged, fleet.weight, _rows_at(fleet.window, r), OTHERS, trail)
    for v in range(fleet.rows.shape[0]):
        if v == r:
            continue
        if not has_poses(fleet):
            take_in(merged, fleet.weight, _kept_at(fleet.kept, r, v), ALL, trail)
        elif fleet.relations.state[r, v] == PLACED:
            relations = fleet.relations
            place_rows(relations, r, v, _kept_at(fleet.kept, r, v))
            take_in_placed(merged, fleet.weight, relations.rows, ALL, trail, relations.spread, CLOSE)
    finish_merge(merged, trail)


@inlined_part
def show(world: World, routes: Routes, fleet: Fleet, r: int) -> None:
    """Fill receiver r's view."""
    row, view, trail = fleet.rows[r], view_at(fleet.views, r), fleet.trail[r]
    observe_tracks(view, _rows_at(fleet.merged, r), trail)
    observe_ego(
        view, trail, _place_of(fleet, r), routes, world.route[row], world.progress[row], world.speed[row],
        world.target_speed[row], world.size[row, 0], world.size[row, 1],
    )  # fmt: skip


@inlined_part
def show_lanes(world: World, routes: Routes, lanes: Lanes, fleet: Fleet, r: int, step: int) -> None:
    """Fill receiver r's view of the lanes that its way meets."""
    row, hidden = fleet.rows[r], hidden_at(fleet.hidden, r)
    note_known(hidden, lanes, world.route[row], _rows_at(fleet.merged, r), _frame_of(fleet, r))
    observe_lanes(
        lane_view_at(fleet.lane_views, r), hidden, lanes, routes, world.route[row], world.progress[row],
        world.size[row, 0], _place_of(fleet, r), step,
    )  # fmt: skip


@inlined_part
def _rows_at(stack: GraphArrays, v: int) -> GraphArrays:
    return GraphArrays(stack.used[v], stack.track[v], stack.position[v], stack.mask[v], stack.kind[v])


@inlined_part
def _kept_at(stack: GraphArrays, r: int, v: int) -> GraphArrays:
    return GraphArrays(stack.used[r, v], stack.track[r, v], stack.position[r, v], stack.mask[r, v], stack.kind[r, v])


@inlined_part
def _tracks_at(stack: Tracks, v: int) -> Tracks:
    return Tracks(
        stack.used[v], stack.next_id[v], stack.id[v], stack.mean[v], stack.covariance[v], stack.height[v],
        stack.kind[v], stack.hits[v], stack.misses[v], stack.recent[v], stack.recent_mask[v],
    )  # fmt: skip
