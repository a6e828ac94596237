"""The state of a fleet's perception and radio: every array that the stages of a step fill, allocated at reset."""

from typing import NamedTuple

import numpy as np

from cad_env.config import PoseConfig
from cad_env.pipeline.codec import max_bytes
from cad_env.pipeline.coverage import Coverage, new_coverage
from cad_env.pipeline.graph_arrays import empty_graph_arrays
from cad_env.pipeline.hidden import Hidden, new_hidden
from cad_env.pipeline.observe import View, empty_view
from cad_env.pipeline.observe_lanes import LaneView, empty_lane_view
from cad_env.pipeline.poses import Poses, new_poses
from cad_env.pipeline.radio import Air, Link, empty_air
from cad_env.pipeline.register import Relations, new_relations
from cad_env.pipeline.stated_pose import POSE_BYTES, STATED
from cad_env.pipeline.track import Tracks, empty_tracks
from cad_env.types import FRAMES, MAX_MERGED_TRACKS, MAX_TRACKS, Bools, Bytes, Floats, GraphArrays, Ints
from cad_env.world.lanes import PLACES, Lanes, empty_lanes

OWN = -1  # in place of the length of an injected message: the vehicle sends its own


class Report(NamedTuple):
    """What the newest step put on the air: the numbers that info dicts show."""

    sent_bytes: Ints  # (V,) bytes of each sender that were accepted
    refusal: Ints  # (V,) why a sender's message was refused, 0 if it was not
    received_bytes: Ints  # (R,) bytes that reached each receiver
    lost: Ints  # (R,) messages in range that did not
    messages_refused: Ints  # (R,) messages that did, and were refused whole by the receiver


class Injected(NamedTuple):
    """What V vehicles broadcast in the next step in place of their own messages: bytes from outside."""

    length: Ints  # (V,) bytes, or OWN
    payload: Bytes  # (V, B); B is 0 until bytes come from outside, to spare the memory


class Fleet(NamedTuple):
    """V connected vehicles, of which the first R also receive, merge and observe; the ego is number 0."""

    rows: Ints  # (V,) rows of the world
    trail: Floats  # (V, T, 3) m, m, rad: own GNSS fixes, newest last; with `poses` those by odometry, in its own frame
    poses: Poses  # (V, ...) what each knows of where it is; of none where poses are exact
    relations: Relations  # (R, V, ...) where each receiver places each sender; of none where poses are exact
    tracks: Tracks  # (V, ...)
    window: GraphArrays  # (V, ...) own graphs
    kept: GraphArrays  # (R, V, ...) what each receiver holds of each sender
    merged: GraphArrays  # (R, ...)
    views: View  # (R, ...)
    coverage: Coverage  # (V, ...) what each sees to be empty; of no lanes where none is shared
    hidden: Hidden  # (R, ...) where each must reckon with a vehicle that nobody has reported
    lane_views: LaneView  # (R, ...)
    air: Air
    injected: Injected
    visible: Bools  # (V, N) who had a line of sight to whom; never leaves the simulation
    report: Report
    message: GraphArrays  # scratch: the message being read
    weight: Floats  # scratch: (M, T)
    header: Ints  # scratch: (3,)
    outlines: Floats  # scratch: (N, 3)
    near: Ints  # scratch: (N,)
    detection: Floats  # scratch: (MAX_TRACKS, 3)
    detected_kind: Ints  # scratch: (MAX_TRACKS,)
    buffer: Bytes  # scratch: for the longest message
    places: Bytes  # scratch: (B, P) of the message being read
    shrunk: Bytes  # scratch: (B, P) what is left of them
    frame: Floats  # scratch: (3,) from a vehicle's own frame to the map
    stated: Floats  # scratch: (STATED,) the pose that a message states


def new_fleet(
    rows: Ints, vehicles: int, receivers: int, link: Link, lanes: Lanes | None = None, miss: float = 0.0,
    pose: PoseConfig | None = None,
) -> Fleet:  # fmt: skip
    """A fleet that has seen nothing yet; it shares coverage of `lanes`, if any are given, at this rate of misses."""
    count, known = len(rows), empty_lanes() if lanes is None else lanes
    config = PoseConfig() if pose is None else pose
    longest = max_bytes(MAX_TRACKS, len(known.start)) + (0 if config.exact else POSE_BYTES)
    return Fleet(
        rows=rows,
        trail=np.zeros((count, FRAMES, 3)),
        poses=new_poses(count, config),
        relations=new_relations(receivers, count, empty_graph_arrays(), config.exact),
        tracks=empty_tracks(count),
        window=empty_graph_arrays(count),
        kept=empty_graph_arrays(receivers, count),
        merged=empty_graph_arrays(receivers, rows=MAX_MERGED_TRACKS),
        views=empty_view(receivers),
        coverage=new_coverage(count, vehicles, known, miss),
        hidden=new_hidden(receivers, known),
        lane_views=empty_lane_view(receivers),
        air=empty_air(count, link, longest),
        injected=nothing_injected(count, 0),
        visible=np.zeros((count, vehicles), np.bool_),
        report=Report(
            sent_bytes=np.zeros(count, np.int64),
            refusal=np.zeros(count, np.int64),
            received_bytes=np.zeros(receivers, np.int64),
            lost=np.zeros(receivers, np.int64),
            messages_refused=np.zeros(receivers, np.int64),
        ),
        message=empty_graph_arrays(),
        weight=np.zeros((MAX_MERGED_TRACKS, FRAMES)),
        header=np.zeros(3, np.int64),
        outlines=np.zeros((vehicles, 3)),
        near=np.zeros(vehicles, np.int64),
        detection=np.zeros((MAX_TRACKS, 3)),
        detected_kind=np.zeros(MAX_TRACKS, np.int8),
        buffer=np.zeros(longest, np.uint8),
        places=np.zeros((len(known.start), PLACES), np.uint8),
        shrunk=np.zeros((len(known.start), PLACES), np.uint8),
        frame=np.zeros(3),
        stated=np.zeros(STATED),
    )


def nothing_injected(vehicles: int, capacity: int) -> Injected:
    """Room for messages from outside of up to `capacity` bytes, and none in it."""
    return Injected(np.full(vehicles, OWN, np.int64), np.zeros((vehicles, capacity), np.uint8))
