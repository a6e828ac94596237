"""Many scenes side by side, moved by the compiled loops: what the vector environment and `rollouts` stand on."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cad_env.lidar.config import CloudConfig
from cad_env.numerics.record_array import CopiedWhole
from cad_env.scenarios.registry import commands_of
from cad_env.simulation.cloud_exchange import exchange
from cad_env.simulation.scene_step import OUTCOME_BY_CODE, BatchState, Truths, play
from cad_env.simulation.setup import Setup
from cad_env.simulation.simulation import REFUSALS, Simulation
from cad_env.types import COLLISION, SUCCESS, Bools, Ints, Observation

_MOST_INT64 = np.iinfo(np.int64).max
_OUTCOMES, _REFUSALS = np.array(OUTCOME_BY_CODE, object), np.array(REFUSALS, object)


class SceneBatch(CopiedWhole):
    """S scenes, each an episode of its own: one setup a scene, which may differ in all they say."""

    def __init__(self, setups: Sequence[Setup]) -> None:
        commands = commands_of(setup.scenario for setup in setups)
        # For compiled loops of one's own: `cad_env.simulation.scene_step.scene_at`.
        self.batch_state = BatchState(len(setups), _one_cloud(setups), commands, _one_coverage(setups))
        self.simulations = [Simulation(setup, self.batch_state, place) for place, setup in enumerate(setups)]
        self._episodes: dict[str, NDArray[Any]] = {}  # name -> (S,) what info says of whole episodes
        self.observations = self._shown()

    def _shown(self) -> Observation:
        """The ego's part of the stacked views: (S, ...) arrays that every step fills anew."""
        views, clouds = self.batch_state.views, self.batch_state.clouds
        shown = {name: part[:, 0] for name, part in zip(views._fields, views, strict=True)}
        if self.batch_state.coverage:
            shown.update({name: part[:, 0] for name, part in self.batch_state.lane_views._asdict().items()})
        return shown if clouds is None else {**shown, **clouds._asdict()}

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "observations"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A copy shows the arrays of its own scenes."""
        self.__dict__.update(state)
        self.observations = self._shown()

    def __len__(self) -> int:
        return len(self.simulations)

    def start(self, place: int, seed: int, hazard: bool | None = None) -> None:
        """Begin the episode of a seed in a scene."""
        simulation = self.simulations[place]
        simulation.start(seed, hazard, receivers=1)
        for name, value in simulation.episode_info().items():
            if isinstance(value, int) and value > _MOST_INT64:  # a seed: of any size, so that object takes its place
                self._episodes[name] = self._episodes.get(name, np.zeros(len(self), np.int64)).astype(object)
            if name not in self._episodes:
                self._episodes[name] = np.zeros(len(self), type(value))
            self._episodes[name][place] = value

    def step(self, which: Ints, actions: Ints) -> None:
        """One decision in the scenes `which` (n,): actions (n,) of their egos, then 0.1 s of world and perception."""
        for place in which.tolist():
            self.batch_state.check_begun(place)
        play(self.batch_state.records, which, actions, True)
        if self.batch_state.clouds is not None:
            every = [self.simulations[place].sharing for place in which.tolist()]
            exchange([sharing for sharing in every if sharing is not None], self.batch_state.rooms)
        for place in which.tolist():
            self.simulations[place].exchange_graphs()

    def observation(self, place: int) -> Observation:
        """A copy of what the ego of one scene decides on."""
        return {name: part[place].copy() for name, part in self.observations.items()}

    @property
    def outcomes(self) -> Ints:
        """(S,) int8 how each episode stands, by the numbers of `scene_step`; filled anew by every step."""
        return self.batch_state.step_info.outcome

    @property
    def rewards(self) -> NDArray[np.float64]:
        """(S,) of the newest step; filled anew by every step."""
        return self.batch_state.step_info.reward

    def step_info(self, name: str) -> NDArray[Any]:
        """(S,) one of the numbers of `cad_env.simulation.scene_step.StepInfo`; filled anew by every step."""
        part: NDArray[Any] = getattr(self.batch_state.step_info, name)
        return part

    def truths(self, which: Ints) -> Truths:
        """The worlds of the scenes `which`, for a privileged policy."""
        return Truths(self.batch_state, which)

    def infos(self, which: Bools) -> dict[str, Any]:
        """What info says of the newest step of the scenes `which` (S,), as Gymnasium's vectors say it.

        For every name of a single environment's info there are the values, (S,), and a mask `_name` of who has one.
        """
        step_info = self.batch_state.step_info
        outcome = _OUTCOMES[step_info.outcome]
        values = {
            **self._episodes,
            "speed": step_info.speed,
            "crashed": outcome == COLLISION,
            "outcome": outcome,
            "is_success": outcome == SUCCESS,
            "min_ttc": step_info.min_ttc,
            "struck_from_behind": step_info.struck_from_behind > 0,
            "bytes_sent": step_info.bytes_sent,
            "bytes_received": step_info.bytes_received,
            "largest_message": step_info.largest_message,
            "messages_sent": step_info.messages_sent,
            "messages_lost": step_info.messages_lost,
            "messages_refused": step_info.messages_refused,
            "refused": _REFUSALS[step_info.refused],
        }
        return masked(values, which)

    def object_lists(self, which: Bools) -> dict[str, Any]:
        """As `infos`, the objects that each connected vehicle of each scene tracks by itself."""
        lists = np.full(len(self), None, object)
        for place in np.flatnonzero(which):
            lists[place] = self.simulations[place].object_lists()
        return masked({"object_lists": lists}, which)


def _one_cloud(setups: Sequence[Setup]) -> CloudConfig | None:
    """How all the scenes share points, or None; ValueError if their observations would not be of one shape."""
    clouds = [setup.cloud for setup in setups]
    shapes = {cloud and (cloud.merged, cloud.codec.width) for cloud in clouds}
    if len(shapes) > 1:
        raise ValueError(f"scenes side by side must all share graphs or clouds of one shape, got {shapes}")
    return clouds[0] if clouds else None


def _one_coverage(setups: Sequence[Setup]) -> bool:
    """Whether all the scenes share coverage; ValueError if some do and some do not."""
    if len({setup.coverage for setup in setups}) > 1:
        raise ValueError("scenes side by side must all share coverage or none, as it is a part of the observation")
    return bool(setups) and setups[0].coverage


def masked(values: dict[str, NDArray[Any]], which: Bools) -> dict[str, Any]:
    """Copies of arrays (S,) with nothing (0, False, None) where `which` is not set, each with its mask beside it."""
    infos: dict[str, Any] = {}
    for name, value in values.items():
        infos[name], infos[f"_{name}"] = value.copy(), which.copy()
        infos[name][~which] = None if value.dtype == object else 0
    return infos
