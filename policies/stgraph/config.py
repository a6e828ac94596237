"""The knobs of the spatiotemporal graph network: a frozen record that refuses nonsense."""

from dataclasses import dataclass

from cad_env.checks import ConfigError, check_numbers, check_switch, did_you_mean, settle
from cad_env.types import COMMANDS, FRAMES, MOST_COMMANDS

FUSIONS = ("last", "per_layer")
WAY_AHEAD = (10.0, 20.0, 30.0, 45.0)  # m ahead along its way, where the ego looks how far that bends aside
EGO_WAY = 1 + len(WAY_AHEAD)  # inputs of `ego_way`
TEMPORAL_EDGES = ("all", "consecutive", "causal")
_LIMITS = {
    "commands": (COMMANDS, MOST_COMMANDS), "hidden": (1, 256), "heads": (1, 16), "head_width": (1, 64),
    "layers": (1, 8), "mlp_width": (1, 1024), "position_scale": (1e-4, 1.0), "attn_slope": (0.0, 1.0),
    "frame_stride": (1, FRAMES),
}  # fmt: skip
_SWITCHES = (
    "edge_attributes",
    "temporal",
    "node_time",
    "relu_logits",
    "velocity",
    "ego_speed",
    "class_input",
    "ego_way",
    "coverage",
)


def _check_choice(name: str, value: object, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        near = did_you_mean(value, allowed)
        raise ConfigError(f"network {name} must be one of {', '.join(allowed)}, got {value!r}{near}")


@dataclass(frozen=True)
class StGraphConfig:
    """The network of the paper, in our reading of it; every option is its letter, an ablation of it or a departure.

    >>> StGraphConfig(fusion="first")
    Traceback (most recent call last):
    cad_env.checks.ConfigError: network fusion must be one of last, per_layer, got 'first'
    """

    hidden: int = 12  # columns of W_v
    heads: int = 4
    head_width: int = 6  # columns of W; inner layers concatenate the heads, the last one averages them
    layers: int = 2
    mlp_width: int = 16  # not stated in the paper
    position_scale: float = 1 / 50  # 1/m; the paper feeds metres into exp()

    # The letter of the paper, where it hinders learning or leaves a choice.
    attn_slope: float = 0.2  # LeakyReLU of the attention score; 0 is the paper's ReLU, where most scores tie at 0
    relu_logits: bool = False  # the paper's ReLU before the last softmax: no gradient when both logits are clamped
    node_time: bool = False  # time as the fourth node input, the other way to read W_v in R^(4x12)
    fusion: str = "last"  # weigh the two relations once at the end, or after every layer as HAN does
    temporal_edges: str = "all"  # of one track: all pairs, neighbouring sightings only, or only from past to future

    # The paper's ablations.
    edge_attributes: bool = True  # False: row E, edges without distances and time gaps
    temporal: bool = True  # False: rows NT, the newest frame and spatial edges only

    # Departures: inputs that the paper's network is not given.
    velocity: bool = False  # nodes carry their track's least-squares velocity over the window, the ego node its speed
    ego_speed: bool = False  # the ego's speed beside the command
    class_input: bool = False  # nodes say whether they are a truck
    ego_way: bool = False  # every node carries the ego's speed and how far its way bends aside (WAY_AHEAD)
    frame_stride: int = 1  # the newest frame and every so manieth before it have nodes; velocities are of all
    coverage: bool = False  # lanes that its way meets, and phantoms where nobody has looked (policies.stgraph.lanes)
    commands: int = COMMANDS  # that its scenarios have; more than six where one brings its own

    def __post_init__(self) -> None:
        check_numbers(self, "network", _LIMITS)
        for name in _SWITCHES:
            settle(self, name, check_switch(f"network {name}", getattr(self, name)))
        _check_choice("fusion", self.fusion, FUSIONS)
        _check_choice("temporal_edges", self.temporal_edges, TEMPORAL_EDGES)
        if not self.temporal:
            self._refuse_what_needs_time()

    def _refuse_what_needs_time(self) -> None:
        for name, idle in (
            ("node_time", False),
            ("velocity", False),
            ("fusion", "last"),
            ("temporal_edges", "all"),
            ("frame_stride", 1),
        ):
            if getattr(self, name) != idle:
                raise ValueError(f"network {name} must be {idle!r} when temporal is False, got {getattr(self, name)!r}")

    @property
    def reads(self) -> tuple[str, ...]:
        """The parts of an observation that the network reads."""
        names = ["tracks", "mask", "command"]
        names += ["ego"] * (self.velocity or self.ego_speed or self.ego_way or self.coverage)
        names += ["kind"] * self.class_input + ["route"] * self.ego_way
        return (*names, *["lanes", "lane_mask"] * self.coverage)

    @property
    def node_inputs(self) -> int:
        """Numbers that a node carries: x, y, z and what the options add."""
        return 3 + self.node_time + 2 * self.velocity + self.class_input + EGO_WAY * self.ego_way
