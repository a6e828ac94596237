"""Observations for networks that want their inputs in about [-1, 1]: divided by fixed scales, the same for everybody.

Fixed ones, unlike running means, mean the same in every run, need not be kept with a model, and leave zeros zero, which
is what masked entries hold.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from cad_env.pipeline.observe_lanes import LANE_FEATURES
from cad_env.types import Floats, Observation

DISTANCE = 50.0  # m: most of what a decision is about is nearer
SPEED = 15.0  # m/s: a fast ego
BODY = (10.0, 2.5)  # m, length and width: about a truck's
DURATION = 5.0  # s
_LANES = {
    "cos": 1.0, "sin": 1.0, "phantom_cos": 1.0, "phantom_sin": 1.0, "age": DURATION, "time": DURATION, "speed": SPEED,
}  # fmt: skip
# What each part of an observation is divided by, along its last axis; parts that are not here are 0 or 1 already.
SCALES: Mapping[str, Floats] = MappingProxyType(
    {
        "tracks": np.full(3, DISTANCE),
        "odometry": np.array([DISTANCE, DISTANCE, 1.0]),  # the last is an angle, rad
        "ego": np.array([SPEED, SPEED, *BODY]),
        "route": np.full(2, DISTANCE),
        "lanes": np.array([_LANES.get(name, DISTANCE) for name in LANE_FEATURES]),
        "cloud": np.full(3, DISTANCE),  # x, y, z; what a codec says of a point is left as it is
    }
)


def scaled_observation(observation: Mapping[str, Any]) -> Observation:
    """A copy with every part float32 and divided by its scale; leading axes, of many scenes, may stand before."""
    return {name: _scaled(name, part) for name, part in observation.items()}


def scaled_space(space: Any) -> spaces.Dict:
    """The boxes of such observations: those of the Dict `space`, divided likewise."""
    return spaces.Dict(
        {
            name: spaces.Box(_scaled(name, box.low), _scaled(name, box.high), dtype=np.float32)
            for name, box in space.spaces.items()
        }
    )


class ScaledObservation(gym.ObservationWrapper[Observation, Any, Observation], RecordConstructorArgs):
    """Observations in about [-1, 1]: every part divided by its scale in `SCALES`, as float32.

    What is farther than 50 m or faster than 15 m/s is beyond 1; nothing is cut off, and zeros stay zeros.

    >>> env = ScaledObservation(gym.make("cad_env:CADLeftTurn-v0"))
    >>> observation, info = env.reset(seed=1)
    >>> observation["ego"].astype(float).round(2).tolist()
    [0.57, 0.67, 0.48, 0.76]
    """

    def __init__(self, env: gym.Env[Observation, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        self.observation_space: Any = scaled_space(env.observation_space)

    def observation(self, observation: Observation) -> Observation:
        """One observation, divided."""
        return scaled_observation(observation)


def _scaled(name: str, part: Any) -> Any:
    scaled = np.array(part, np.float32)
    if name in SCALES:
        scale = SCALES[name].astype(np.float32)
        scaled[..., : len(scale)] /= scale
    return scaled
