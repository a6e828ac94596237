"""Connected autonomous driving: accident-prone scenes, and what passes between vehicles that share what they see.

    seed -> scenario -> world --truth--> sense -> track -> graph -----+------------> merge -> observe -> decide
            (who, where)  ^              (line of  (who    (last 15   |               ^                    |
                          |               sight)    is who) frames)   v               |                    |
                          |                                         encode -> radio --+ decode             |
                          +------------------------- go / brake -------------------------------------------+

One step of `CADEnv` (Gymnasium, the ego decides) or `parallel_env` (PettingZoo, every connected vehicle decides)
runs this once for every connected vehicle. No learning here, and no torch: networks live in `policies`.

>>> import gymnasium as gym
>>> env = gym.make("CADLeftTurn-v0", radio="dsrc")
>>> observation, info = env.reset(seed=0)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from cad_env.config import RADIO_PRESETS, RadioConfig, SensorConfig
from cad_env.types import BRAKE, GO, Command, Graph, Policy

if TYPE_CHECKING:
    from cad_env.envs.parallel import CADParallelEnv
    from cad_env.envs.rewards import StepOutcome
    from cad_env.envs.single import CADEnv
    from cad_env.envs.vector import CADVectorEnv
    from cad_env.lidar.config import CloudConfig
    from cad_env.pipeline.varint import DecodeError
    from cad_env.rules.planner import Planner
    from cad_env.scenarios import register
    from cad_env.scoring.rollout import Episode, rollout, rollouts
    from cad_env.simulation.graph_exchange import GraphCodec

__all__ = [
    "BRAKE", "GO", "RADIO_PRESETS", "CADEnv", "CADParallelEnv", "CADVectorEnv", "CloudConfig", "Command", "DecodeError",
    "Episode", "Graph", "GraphCodec", "Planner", "Policy", "RadioConfig", "SensorConfig", "StepOutcome",
    "parallel_env", "register",
    "rollout", "rollouts",
]  # fmt: skip
__version__ = "0.1.0"

# Public names that bring compiled code or highway-env with them: imported when they are first asked for.
_LAZY = {
    "CADEnv": "cad_env.envs.single",
    "CADParallelEnv": "cad_env.envs.parallel",
    "CADVectorEnv": "cad_env.envs.vector",
    "CloudConfig": "cad_env.lidar.config",
    "DecodeError": "cad_env.pipeline.varint",
    "Episode": "cad_env.scoring.rollout",
    "GraphCodec": "cad_env.simulation.graph_exchange",
    "Planner": "cad_env.rules.planner",
    "StepOutcome": "cad_env.envs.rewards",
    "rollout": "cad_env.scoring.rollout",
    "register": "cad_env.scenarios",
    "rollouts": "cad_env.scoring.rollout",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_LAZY[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})


# Ids by name, not by import, so that `import cad_env` stays instant.
_IDS = {
    "CADLeftTurn-v0": "left_turn",
    "CADOvertaking-v0": "overtaking",
    "CADStreetCrossing-v0": "street_crossing",
}
for _id, _scenario in [*_IDS.items(), ("CADScenario-v0", None)]:
    if _id not in gym.registry:
        gym.register(
            _id,
            entry_point="cad_env.envs.single:CADEnv",
            vector_entry_point="cad_env.envs.vector:CADVectorEnv",
            kwargs={} if _scenario is None else {"scenario": _scenario},  # CADScenario-v0 is told which one
        )


def parallel_env(env_id: str = "CADLeftTurn-v0", render_mode: str | None = None, **options: Any) -> "CADParallelEnv":
    """The PettingZoo environment of a registered id, e.g. parallel_env("CADLeftTurn-v0", radio="cv2x")."""
    from cad_env.envs.parallel import parallel_env as make

    return make(env_id, render_mode, **options)
