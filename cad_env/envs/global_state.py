"""The truth as one vector of a fixed length: PettingZoo's `state()`, for critics that are centralised in training."""

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from cad_env.types import Ints
from cad_env.world.state import OFF, World

STATE_VEHICLES = 40  # those beyond, of the unconnected, are left out
# name -> least, most; m, rad, m/s, m/s2; world frame
STATE_FEATURES = {
    "present": (0, 1), "connected": (0, 1), "x": (-1000, 1000), "y": (-1000, 1000), "heading": (-np.pi, np.pi),
    "speed": (0, 50), "acceleration": (-20, 20), "length": (0, 20), "width": (0, 5), "kind": (0, 1), "struck": (0, 1),
}  # fmt: skip


def global_state_space() -> spaces.Box:
    """(STATE_VEHICLES * len(STATE_FEATURES),), finite."""
    bounds = np.tile(np.array(list(STATE_FEATURES.values()), np.float32), (STATE_VEHICLES, 1))
    return spaces.Box(bounds[:, 0], bounds[:, 1], dtype=np.float32)


def global_state(world: World, agents: Ints) -> NDArray[np.float32]:
    """All features of one vehicle, then of the next; agents first and in their order, zeros for who is not there.

    `global_state(...).reshape(STATE_VEHICLES, -1)` has a row for each vehicle.
    """
    others = np.setdiff1d(np.arange(len(world.speed)), agents)
    rows = np.concatenate([agents, others])[:STATE_VEHICLES]
    on_map = world.driver[rows] != OFF
    heading = (world.heading[rows] + np.pi) % (2 * np.pi) - np.pi
    features = np.column_stack(
        [
            on_map, np.isin(rows, agents), world.position[rows], heading, world.speed[rows], world.acceleration[rows],
            world.size[rows], world.kind[rows], world.struck[rows] >= 0,
        ]
    )  # fmt: skip
    state = np.zeros((STATE_VEHICLES, len(STATE_FEATURES)), np.float32)
    state[: len(rows)][on_map] = features[on_map]
    space = global_state_space()
    return np.clip(state.ravel(), space.low, space.high)
