"""The learned rows of the tables: which network, what is shared with it, and how it is trained.

Every row learns from the same recorded episodes. Names in brackets are the paper's.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from cad_env.types import FRAMES

SHARED = ("nothing", "graph", "points", "features")


@dataclass(frozen=True)
class LearnedMethod:
    """A learned method."""

    name: str
    spec: str = "stgraph"  # by its name in policies.registry
    config: Mapping[str, Any] = field(default_factory=dict)  # knobs of its network, where they differ from the default
    shares: str = "graph"  # one of SHARED
    depth: int = FRAMES  # newest frames in a message
    dagger_rounds: int | None = None  # DAgger rounds; None: as many as a run is asked for
    radio: str | None = None  # what it is trained on; None: what a run is asked for
    recipe: Mapping[str, Any] = field(default_factory=dict)  # of policies.training.cloning.Recipe, where it differs
    pace: float = 1.0  # optimiser steps, as a share of those that a run is asked for
    most_validated: int | None = None  # episodes after each third of a round, however many a run is asked for
    cost: float = 1.0  # of a frame, driven or learned from, where that of a graph is 1: for an honest progress bar

    @property
    def model(self) -> str:
        """The folder of its model among the models of a training seed."""
        return self.name

    @property
    def blind(self) -> bool:
        """Whether it sees nothing at all."""
        return self.spec == "command"


# A frame of points costs ten times that of a graph, so their batches are smaller.
POINTS, FEATURES = {"batch": 48, "learning_rate": 1.5e-3}, {"batch": 64, "learning_rate": 5e-3}

_LEARNED = (
    LearnedMethod("stgraph"),  # the paper's "Ours"; clones, and then corrects
    LearnedMethod("stgraph-own", shares="nothing"),  # [T-NS]
    LearnedMethod("command-only", "command", shares="nothing"),
    LearnedMethod("gat", config={"temporal": False}, shares="nothing"),  # [GAT, NT-NS]
    LearnedMethod("collab-gat", config={"temporal": False}, depth=1),  # [Collab-GAT, NT-S]
    # What these two send is more than dsrc lets a vehicle send, so they learn over a radio that carries it.
    # Their episodes are the dearest, so fewer validate them.
    LearnedMethod(
        "raw-points", "point_transformer", shares="points", radio="ideal", recipe=POINTS, pace=0.5, most_validated=24,
        cost=12.0,
    ),
    LearnedMethod(
        "compressed", "compressed", shares="features", radio="cv2x", recipe=FEATURES, pace=0.5, most_validated=24,
        cost=12.0,
    ),
    LearnedMethod("stgraph-no-edges", config={"edge_attributes": False}),  # [Ours without edge attributes]
    # Clones only, as the paper does; as many steps as stgraph in three rounds.
    LearnedMethod("stgraph-bc", dagger_rounds=0, pace=2.0),
    LearnedMethod("stgraph-velocity", config={"velocity": True}),  # a departure: nodes carry their velocity
)  # fmt: skip

LEARNED: Mapping[str, LearnedMethod] = MappingProxyType({row.name: row for row in _LEARNED})


def learned_named(name: str) -> LearnedMethod:
    """The row called `name`; ValueError that lists the choices otherwise."""
    if name not in LEARNED:
        raise ValueError(f"unknown row {name!r}: choose among {', '.join(LEARNED)}")
    return LEARNED[name]


def radio_of(method: str, usual: str) -> str:
    """The radio that a method is asked and driven over: that which it learned over, if its messages need another."""
    return (LEARNED[method].radio if method in LEARNED else None) or usual
