"""What the paper reports: Tables II and III of "Collaborative Decision-Making Using Spatiotemporal Graphs in Connected
Autonomy", digit by digit.

Both tables hold the same numbers for NT-NS and GAT, and for NT-S and Collab-GAT. The EAR of the latter in overtaking
is printed "0. 7020" in both, and is read as 0.7020 here.
"""

from typing import NamedTuple

SCENES = ("overtaking", "left_turn", "street_crossing")  # in the order of the paper's columns


class Published(NamedTuple):
    """One row of a table of the paper."""

    title: str
    method: str  # the row of ours that stands for it
    package: str  # as printed
    scores: tuple[float, ...]  # AD and EAR of each scene, in their order

    def of(self, scene: str) -> tuple[float, float]:
        """AD and EAR in a scene."""
        place = 2 * SCENES.index(scene)
        return self.scores[place], self.scores[place + 1]


TABLE_2 = (
    Published("A) Raw Data Sharing", "raw-points", "6 MB",
              (0.7619, 0.7126, 0.3522, 0.6440, 0.3165, 0.8650)),
    Published("B) GAT", "gat", "0.6 KB",
              (0.7588, 0.6565, 0.2272, 0.6041, 0.2960, 0.7505)),
    Published("C) Collab-GAT", "collab-gat", "0.6 KB",
              (0.5983, 0.7020, 0.2561, 0.6204, 0.5018, 0.7195)),
    Published("D) Compressed Feature Sharing", "compressed", "510 KB",
              (0.7066, 0.7485, 0.4962, 0.6603, 0.4690, 0.8651)),
    Published("E) Ours w.o. Edge Attribute", "stgraph-no-edges", "4.8 KB",
              (0.7434, 0.7322, 0.4148, 0.7427, 0.2564, 0.7785)),
    Published("F) Ours (All Elements)", "stgraph", "4.9 KB",
              (0.9265, 0.8336, 0.6070, 0.7670, 0.6451, 0.7846)),
)  # fmt: skip
TABLE_3 = (
    Published("NT-NS", "gat", "", (0.7588, 0.6565, 0.2272, 0.6041, 0.2960, 0.7505)),
    Published("T-NS", "stgraph-own", "", (0.5873, 0.7018, 0.2271, 0.6564, 0.1762, 0.7575)),
    Published("NT-S", "collab-gat", "", (0.5983, 0.7020, 0.2561, 0.6204, 0.5018, 0.7195)),
    Published("Full (Ours)", "stgraph", "", (0.9265, 0.8336, 0.6070, 0.7670, 0.6451, 0.7846)),
)

SIMULATORS = (
    "The paper's numbers are from CARLA with AutoCast, a camera pipeline and 12 test trials, without intervals; ours "
    "are from this project's scenes. Only orders and ratios compare, never a number with the number beside it."
)
PAPER_UNITS = (
    "The paper calls kilobits kilobytes: 2 Mbit/s for 0.1 s, one slot of DSRC, are 200 kbit = 25 kB (25,000 bytes), "
    'not its "200 KB". The package sizes of its baselines look alike (510 kbit are the 64 kB of 128 points with 128 '
    "float32 features each), so its ratio of 104 may mix units; ours are bytes as encoded."
)
