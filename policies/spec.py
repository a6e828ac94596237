"""What a kind of network must be able to do, so that the same code trains, saves and drives them all.

A spec is everything that differs between networks: their knobs, the environment they need, what is kept of a frame
for them, and how a batch becomes logits. Demonstrations, DAgger, validation and model folders know only this.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Protocol, TypeVar

from numpy.typing import NDArray
from torch import Tensor, nn

from cad_env.scenarios.registry import commands_of
from cad_env.scoring.rollout import BatchPolicy
from cad_env.simulation.simulation import Simulation
from cad_env.types import COMMANDS, Ints, Observation, Policy

Self = TypeVar("Self", bound="Frames")


class Frames(Protocol):
    """F labelled frames of whole episodes, in a form that takes little memory."""

    @property
    def label(self) -> Ints:
        """(F,) int8 what the expert would do."""

    def __len__(self) -> int:
        """F."""

    def batch(self, frames: Ints) -> dict[str, NDArray[Any]]:
        """What the network reads of some frames, stacked; the shapes behind the first do not depend on them."""

    def joined(self: Self, others: Sequence[Self]) -> Self:
        """These frames and then the others'."""


class LearnedPolicy(Policy, BatchPolicy, Protocol):
    """A learned policy: it decides one by one or in batches, and says how sure it is."""

    def brake_probability(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """P(brake), (n,), for observations stacked along a new first axis."""


class NetworkSpec(Protocol):
    """One kind of network; `SpecDefaults` has what is trivial for most."""

    @property
    def name(self) -> str:
        """In config.json of its models."""

    @property
    def config_type(self) -> type:
        """The frozen, checked dataclass of its knobs: what config.json holds of it."""

    @property
    def kept_as(self) -> type | None:
        """The dataclass of its frames, of arrays and numbers, if they are dearer to make than to keep on the disk."""

    def build(self, config: Any, seed: int) -> nn.Module:
        """A new network whose `config` attribute is the given one; `seed` is the only source of its first weights."""

    def environment(self, network: nn.Module) -> dict[str, Any]:
        """The options of the environment it needs, beside scenario, radio and depth: none for graphs.

        A network that takes part in what is sent (a learned encoder) goes into them as it is then.
        """

    def replayed(self, network: nn.Module) -> dict[str, Any]:
        """The options of an environment to replay in: as those of `environment`, without what `look` does not read."""

    def looked_with(self, config: Any) -> dict[str, Any]:
        """The knobs that `look` and `replayed` read: networks that agree on them learn from the same frames."""

    def look(self, simulation: Simulation, observation: Observation) -> Any:
        """What is kept of the frame that is being decided on; it must not depend on the network's weights."""

    def frames(self, looks: Sequence[Any], labels: Sequence[int]) -> Frames:
        """What was looked at, with the expert's labels, as one record."""

    def logits(self, network: nn.Module, batch: Mapping[str, Tensor]) -> Tensor:
        """Logits (B, 2) of GO and BRAKE with their gradients."""

    def policy(self, network: nn.Module, threshold: float) -> LearnedPolicy:
        """The network as it is now, as a policy that brakes when P(brake) reaches the threshold."""


class SpecDefaults:
    """A spec whose network reads observations as any environment shows them, and whose frames are replayed fast."""

    kept_as: type | None = None

    def environment(self, network: nn.Module) -> dict[str, Any]:
        """Nothing beside scenario, radio and depth."""
        return {}

    def replayed(self, network: nn.Module) -> dict[str, Any]:
        """The same as in `environment`."""
        return self.environment(network)

    def looked_with(self, config: Any) -> dict[str, Any]:
        """None."""
        return {}


def fitting(config: Any, scenarios: Sequence[str]) -> Any:
    """The knobs of a network for some scenarios: with as many `commands` as these have, where there is such a knob.

    ValueError, one line, for scenarios that differ in it, and for a number that was chosen and is another one.
    """
    wanted = commands_of(scenarios)
    if "commands" not in {knob.name for knob in fields(config)}:
        if wanted != COMMANDS:
            raise ValueError(f"a network without a setting `commands` knows {COMMANDS}, not {wanted} commands")
        return config
    if config.commands == wanted:
        return config
    if config.commands != COMMANDS:
        raise ValueError(f"network commands must be {wanted}, as {' '.join(scenarios)} have, got {config.commands}")
    return replace(config, commands=wanted)
