"""One decision's perception and communication for a fleet: the stages in their order, as one compiled function."""

import math
from typing import NamedTuple

import numpy as np

from cad_env.compiled import compiled
from cad_env.pipeline.codec import MAX_BYTES, read, write
from cad_env.pipeline.graph import add_body, add_track
from cad_env.pipeline.merge import finish_merge, receive, start_merge, take_in
from cad_env.pipeline.observe import View, empty_view, observe_ego, observe_tracks
from cad_env.pipeline.sense import CENTRE_HEIGHT, Sensing, fix_pose, sense
from cad_env.pipeline.track import Tracks, confirmed, empty_tracks, seen_now, update
from cad_env.rows import empty_rows, slide
from cad_env.types import FRAMES, MERGED_ROWS, ROWS, Bools, Bytes, Floats, Ints, Rows
from cad_env.world.state import Routes, World

SENSE, GNSS, RADIO = 0, 1, 2  # rows of the stream keys
