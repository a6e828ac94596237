"""A scenario of one's own for cad-env: from a ramp into the right lane of a highway that parked lorries hide."""

from cad_highway_merge.expert import MergeConfig, MergeExpert
from cad_highway_merge.road import MERGE
from cad_highway_merge.scenario import HIGHWAY_MERGE, HighwayMergeRanges

__all__ = ["HIGHWAY_MERGE", "MERGE", "HighwayMergeRanges", "MergeConfig", "MergeExpert"]
