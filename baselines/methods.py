"""The lines of the results table: what each method knows, who decides, and how it is learned.

Names in brackets are the paper's. Controls that pass with closed eyes are named with their number
(`baselines.controls`). A method from outside is named `module:attribute` or
`module:factory(argument=value)`: a policy, or a network spec that is trained first (`baselines.references`).
"""

import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from baselines.controls.names import BEST_BLIND, FORMS, best_control, is_control, parsed_control
from baselines.references import is_reference, resolved
from cad_env.checks import ConfigError, did_you_mean
from cad_env.types import BRAKE, FRAMES, GO, Policy

KNOWLEDGE = ("nothing", "what it sees", "what it sees and is sent", "the truth")
KNOWS_NOTHING, KNOWS_SEEN, KNOWS_SENT, KNOWS_TRUTH = KNOWLEDGE
SHARED = ("nothing", "graph", "points", "features")
# What the paper's network is not told and needs, to drive between the vehicles of a stream: how everything moves, and
# how the ego's own way bends; at twice its width. A third of the frames then does, at a third of the cost.
MOTION: Mapping[str, Any] = MappingProxyType(
    {"velocity": True, "ego_way": True, "frame_stride": 3, "hidden": 24, "head_width": 12, "mlp_width": 32}
)
# Conditions under which a network learns that is told what nobody vouches for: from nobody on the air to the guaranteed
# witness, and a channel that loses most.
MIXTURE = ("nominal", "alone", "penetration-10", "penetration-50", "loss-70")


@dataclass(frozen=True)
class LearnedMethod:
    """A learned method."""

    name: str
    spec: str = "stgraph"  # by its name in policies.registry
    config: Mapping[str, Any] = field(default_factory=dict)  # knobs of its network, where they differ from the default
    shares: str = "graph"  # one of SHARED
    # Of policies.training.config.TrainingConfig, where it differs from what a run is asked for.
    training: Mapping[str, Any] = field(default_factory=dict)
    pace: float = 1.0  # optimiser steps, as a share of those that a run is asked for
    most_validated: int | None = None  # episodes after each third of a round, however many a run is asked for
    begins_with: str | None = None  # the method whose model that ships it begins with, if it learns by reward
    cost: float = 1.0  # of a frame, driven or learned from, where that of a graph is 1: for an honest progress bar

    @property
    def model(self) -> str:
        """The folder of its model among the models of a training seed."""
        return folder_of(self.name)

    @property
    def depth(self) -> int:
        """Newest frames in a message."""
        depth: int = self.training.get("depth", FRAMES)
        return depth

    @property
    def radio(self) -> str | None:
        """What it is trained on; None: what a run is asked for."""
        return self.training.get("radio")

    @property
    def blind(self) -> bool:
        """Whether it sees nothing at all."""
        return self.spec == "command"


_LEARNED = (
    LearnedMethod("stgraph"),  # the paper's "Ours": cloning, then DAgger rounds
    LearnedMethod("stgraph-own", shares="nothing"),  # [T-NS]
    LearnedMethod("stgraph-motion", config=MOTION),  # a departure: nodes are told of motion
    LearnedMethod("stgraph-motion-own", config=MOTION, shares="nothing"),
    LearnedMethod(  # a departure: it is also told of the lanes that its way meets, and of where nobody has looked
        "stgraph-coverage", config={**MOTION, "coverage": True},
        training={"conditions": MIXTURE, "batch": 150, "thresholds": (0.5, 0.35, 0.2, 0.1)},
    ),
    LearnedMethod("command-only", "command", shares="nothing"),
    LearnedMethod("gat", config={"temporal": False}, shares="nothing"),  # [GAT, NT-NS]
    LearnedMethod("collab-gat", config={"temporal": False}, training={"depth": 1}),  # [Collab-GAT, NT-S]
    # These two send more than dsrc lets a vehicle send, so they are trained over a radio that carries it. A frame of
    # points costs ten times as much as one of a graph, so batches are smaller and fewer episodes validate them.
    LearnedMethod(
        "raw-points", "point_transformer", shares="points", pace=0.5, most_validated=24, cost=12.0,
        training={"radio": "ideal", "batch": 48, "learning_rate": 1.5e-3},
    ),
    LearnedMethod(
        "compressed", "compressed", shares="features", pace=0.5, most_validated=24, cost=12.0,
        training={"radio": "cv2x", "batch": 64},
    ),
    LearnedMethod("stgraph-no-edges", config={"edge_attributes": False}),  # [Ours without edge attributes]
    # Cloning only, as in the paper; as many steps as stgraph in three rounds.
    LearnedMethod("stgraph-bc", training={"dagger_rounds": 0}, pace=2.0),
    LearnedMethod("stgraph-velocity", config={"velocity": True}),  # a departure: nodes carry their velocity
)  # fmt: skip

LEARNED: Mapping[str, LearnedMethod] = MappingProxyType({row.name: row for row in _LEARNED})
# What learns by reward, not from demonstrations: the network of the main job, from scratch, and as it was cloned.
REWARDED: Mapping[str, LearnedMethod] = MappingProxyType(
    {
        "ppo": LearnedMethod("ppo", config=MOTION),
        "ppo-from-clone": LearnedMethod("ppo-from-clone", config=MOTION, begins_with="stgraph-motion"),
    }
)


def folder_of(name: str) -> str:
    """The folder of a method's model: its name, with `_` for whatever a file name should not hold."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name)


@dataclass
class Always:
    """The same decision whatever it sees."""

    action: int
    privileged: bool = False

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Any) -> int:
        """The decision it was made with."""
        return self.action


@dataclass(frozen=True)
class Method:
    """One line of the results table: rules, made for a scenario, or a learned policy, loaded from its model."""

    name: str
    knows: str  # one of KNOWLEDGE
    make_policy: Callable[[str], Policy] | None = None  # for the scenario of this name
    learned: LearnedMethod | None = None
    coverage: bool = (
        False  # it is told what was seen to be empty: by its own sensor and, if it is sent anything, by others
    )

    @property
    def shares(self) -> bool:
        """False: nothing is sent, whatever the radio could carry."""
        return self.knows == KNOWS_SENT

    @property
    def model(self) -> str | None:
        """The folder of its model among those of a training seed, if it has one."""
        return None if self.learned is None else self.learned.model

    @property
    def depth(self) -> int:
        """Newest frames in a message that is sent to it."""
        return FRAMES if self.learned is None else self.learned.depth


def _planner(_: str) -> Policy:
    from cad_env.rules.planner import Planner  # here, because numba takes half a second that --help need not wait

    return Planner()


def _coverage_planner(_: str) -> Policy:
    from cad_env.rules.coverage_planner import CoveragePlanner

    return CoveragePlanner()


def _expert(scenario: str) -> Policy:
    from cad_env.rules.expert import expert_of

    expert: Policy = expert_of(scenario)
    return expert


def _control(name: str) -> Method:
    """The control of this name; ValueError, one line, for a wrong number."""
    parsed_control(name)

    def make(scenario: str) -> Policy:
        from baselines.controls.policies import control

        return control(name, scenario)

    return Method(name, KNOWS_NOTHING, make)


def _best_blind(scenario: str) -> Policy:
    from baselines.controls.policies import control

    return control(best_control(scenario), scenario)


def _of(learned: LearnedMethod) -> Method:
    knows = KNOWS_NOTHING if learned.blind else KNOWS_SEEN if learned.shares == "nothing" else KNOWS_SENT
    return Method(learned.name, knows, learned=learned)


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        method.name: method
        for method in (
            Method("always-go", KNOWS_NOTHING, lambda _: Always(GO)),
            Method("always-brake", KNOWS_NOTHING, lambda _: Always(BRAKE)),
            Method(BEST_BLIND, KNOWS_NOTHING, _best_blind),  # of all controls, chosen on training seeds
            Method("planner-own", KNOWS_SEEN, _planner),
            Method("planner-shared", KNOWS_SENT, _planner),
            Method("expert", KNOWS_TRUTH, _expert),
            *map(_of, LEARNED.values()),
            Method("planner-coverage", KNOWS_SENT, _coverage_planner, coverage=True),
            Method("cautious-own", KNOWS_SEEN, _coverage_planner, coverage=True),  # the same rules, alone
            *map(_of, REWARDED.values()),
        )
    }
)
SHIPPED_METHODS = (
    "always-go", "always-brake", BEST_BLIND, "planner-own", "planner-shared", "expert", "stgraph", "stgraph-own",
    "stgraph-motion", "stgraph-motion-own",
)  # fmt: skip


def method_named(name: str) -> Method:
    """The method called `name`, or one from outside; ConfigError that lists the choices and names the nearest one."""
    if is_reference(name):
        return _outside(name)
    if is_control(name):
        return _control(name)
    if name not in METHODS:
        known = (*METHODS, *FORMS)
        choices = f"choose among {', '.join(known)} or give module:policy{did_you_mean(name, known)}"
        raise ConfigError(f"unknown method {name!r}: {choices}")
    return METHODS[name]


def learned_named(name: str) -> LearnedMethod:
    """How the method called `name` is learned; ValueError that lists the choices where it is not."""
    if is_reference(name):
        learned = _outside(name).learned
        if learned is None:
            raise ValueError(f"{name} is a policy, not a network spec: there is nothing to train")
        return learned
    trained = {**LEARNED, **REWARDED}
    if name not in trained:
        choices = f"choose among {', '.join(trained)} or give module:spec{did_you_mean(name, trained)}"
        what = f"{name} is not learned" if name in METHODS else f"unknown method {name!r}"
        raise ConfigError(f"{what}: {choices}")
    return trained[name]


def choices(names: Iterable[str] | None = None) -> str:
    """For `--help`: the names of methods, by default of all, and of scenarios."""
    from cad_env.scenarios import scenario_names  # here, because it takes a second that only this help need wait

    said = ", ".join((*METHODS, *FORMS) if names is None else names)
    return f"Methods: {said}.\nScenarios: {', '.join(scenario_names())}."


def how_to_train(name: str, scenarios: Sequence[str] = ()) -> str:
    """The command that trains a method, by default for all scenarios that ship, and how its model is then found."""
    where = f"runs/{folder_of(name)}"
    chosen = f"--scenario {shlex.join(scenarios)} " if scenarios else ""
    return f"`python train.py {chosen}--method {shlex.quote(name)} --out {where}` trains it; then --models {where}"


def radio_of(method: str, usual: str) -> str:
    """The radio that a method is asked and driven over: that which it learned over, if its messages need another."""
    learned = method_named(method).learned
    return (learned.radio if learned is not None else None) or usual


@cache
def _outside(name: str) -> Method:
    found = resolved(name)
    if is_network_spec(found):
        from policies.registry import register_spec

        register_spec(found, name)
        register_spec(found)  # the name that its model folders hold
        shares, training = getattr(found, "shares", "graph"), getattr(found, "training", {})
        if shares not in SHARED:
            near = did_you_mean(shares, SHARED)
            raise ConfigError(f"{name} must share one of {', '.join(SHARED)}, got {shares!r}{near}")
        return _of(LearnedMethod(name, spec=name, shares=shares, training=training))
    policy = _checked(found, name)
    knows = getattr(policy, "knows", KNOWS_TRUTH if policy.privileged else KNOWS_SENT)
    if knows not in KNOWLEDGE:
        near = did_you_mean(knows, KNOWLEDGE)
        raise ConfigError(f"{name} must know one of {', '.join(KNOWLEDGE)}, got {knows!r}{near}")
    return Method(name, knows, lambda _: _checked(resolved(name), name))


def is_network_spec(found: Any) -> bool:
    """Whether an object from outside is a kind of network, and not a policy."""
    return all(hasattr(found, part) for part in ("build", "frames", "logits", "config_type"))


def _checked(found: Any, name: str) -> Policy:
    for part in ("reset", "act"):
        if not callable(getattr(found, part, None)):
            raise ValueError(f"{name} is no policy: it has no {part}()")
    if not isinstance(getattr(found, "privileged", None), bool):
        raise ValueError(f"{name} is no policy: it does not say whether it is privileged")
    policy: Policy = found
    return policy


def shipped_models() -> Path:
    """Where the package keeps the models that ship: one for all scenarios."""
    import policies

    return Path(policies.__path__[0]) / "weights" / "all"
