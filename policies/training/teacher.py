"""Who says what would have been right in a frame: the expert on the truth, or a teacher that also waits.

The expert knows the truth, so it drives on where nobody has looked and nobody happens to be. A network that imitates it
there learns that silence means an empty road. The teacher knows the truth of what is known and the phantoms of what is
not: it also brakes where the rules of `cad_env.rules.coverage_planner` wait for whom nobody vouches for. So the same
road has another label when it is talked about than when it is not, and the network can tell the two apart.
"""

from typing import Any

import numpy as np

from cad_env.checks import ConfigError
from cad_env.numerics.jit import compiled
from cad_env.pipeline.observe import View, view_at, view_of
from cad_env.pipeline.observe_lanes import LaneView, lane_view_at
from cad_env.rules.coverage_planner import CoverageConfig, Reserve, is_braking, must_wait
from cad_env.rules.expert import decisions, expert_of
from cad_env.rules.planner import known_vehicles, way_of
from cad_env.simulation.batch import SceneBatch
from cad_env.types import BRAKE, Bools, Ints, Observation


class Teacher:
    """Labels frames of a scenario; `waits`: also by what nobody vouches for, which takes scenes with coverage."""

    def __init__(self, batch: SceneBatch, waits: bool = False) -> None:
        if waits and not batch.batch_state.coverage:
            raise ConfigError("a teacher that waits needs to know what was seen to be empty: scenes with coverage=True")
        self._batch, self.waits = batch, waits
        self._expert: Any = expert_of(batch.simulations[0].scenario)

    def labels(self, which: Ints) -> Ints:
        """GO or BRAKE, (n,), in the scenes `which` (n,) as they are now."""
        label = decisions(self._expert, self._batch.truths(which))
        if not self.waits:
            return label
        seen = {name: part[which] for name, part in self._batch.observations.items()}
        return np.where(waiting(seen), BRAKE, label)


def waiting(observations: Observation) -> Bools:
    """Whether the ego must stop now for a lane, (n,), by observations with coverage, stacked along a first axis."""
    waits = np.empty(len(observations["mask"]), np.bool_)
    lanes = LaneView(observations["lanes"], observations["lane_mask"])
    _wait(view_of(observations), lanes, CoverageConfig().reserve, waits)
    return waits


@compiled
def _wait(views: View, lanes: LaneView, reserve: Reserve, waits: Bools) -> None:
    for k in range(waits.shape[0]):
        view = view_at(views, k)
        others = known_vehicles(view, way_of(view.route))
        ego, brakes = view.ego.astype(np.float64), is_braking(view.odometry)
        waits[k] = must_wait(lane_view_at(lanes, k), ego, brakes, others, reserve)
