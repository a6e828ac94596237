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
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from cad_env.config import RADIO_PRESETS, RadioConfig, SensorConfig
from cad_env.types import BRAKE, GO, MAX_STEPS, Command, Graph, Policy

if TYPE_CHECKING:
    from cad_env.envs.parallel import CADParallelEnv
    from cad_env.envs.rewards import StepOutcome
    from cad_env.envs.single import CADEnv
    from cad_env.envs.vector import CADVectorEnv
    from cad_env.lidar.config import CloudConfig
    from cad_env.pipeline.varint import DecodeError
    from cad_env.rules.planner import Planner
    from cad_env.scenarios import register
    from cad_env.scenarios.scenario import Scenario
    from cad_env.scoring.check_scenario import check_scenario
    from cad_env.scoring.rollout import Episode, rollout, rollouts
    from cad_env.scoring.scorecard import Scorecard, scorecards
    from cad_env.scoring.table import table
    from cad_env.scoring.time_lost import TimeLost, time_lost
    from cad_env.simulation.graph_exchange import GraphCodec

__all__ = [
    "BRAKE", "GO", "RADIO_PRESETS", "CADEnv", "CADParallelEnv", "CADVectorEnv", "CloudConfig", "Command", "DecodeError",
    "Episode", "Graph", "GraphCodec", "Planner", "Policy", "RadioConfig", "Scenario", "Scorecard", "SensorConfig",
    "StepOutcome", "TimeLost", "check_scenario", "parallel_env", "register", "rollout", "rollouts", "scorecards",
    "table", "time_lost",
]  # fmt: skip
__version__ = "0.1.0"

# Public names that bring compiled code or highway-env with them: imported when they are first asked for.
_LAZY = {
    "CADEnv": "cad_env.envs.single",
    "CADParallelEnv": "cad_env.envs.parallel",
    "CADVectorEnv": "cad_env.envs.vector",
    "CloudConfig": "cad_env.lidar.config",
    "DecodeError": "cad_env.pipeline.varint",
    "check_scenario": "cad_env.scoring.check_scenario",
    "Episode": "cad_env.scoring.rollout",
    "GraphCodec": "cad_env.simulation.graph_exchange",
    "Planner": "cad_env.rules.planner",
    "Scenario": "cad_env.scenarios.scenario",
    "Scorecard": "cad_env.scoring.scorecard",
    "StepOutcome": "cad_env.envs.rewards",
    "TimeLost": "cad_env.scoring.time_lost",
    "register": "cad_env.scenarios",
    "rollout": "cad_env.scoring.rollout",
    "rollouts": "cad_env.scoring.rollout",
    "scorecards": "cad_env.scoring.scorecard",
    "table": "cad_env.scoring.table",
    "time_lost": "cad_env.scoring.time_lost",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_LAZY[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})


def _id_of(scenario: str) -> str:
    """highway_merge -> CADHighwayMerge-v0."""
    return f"CAD{scenario.title().replace('_', '')}-v0"


# Ids by name, not by import, so that `import cad_env` stays instant: of installed packages only the metadata is read.
_IDS = {
    "CADScenario-v0": None,  # any, as the keyword argument `scenario`
    "CADLeftTurn-v0": "left_turn",
    "CADOvertaking-v0": "overtaking",
    "CADStreetCrossing-v0": "street_crossing",
    "CADUnsignalised-v0": "unsignalised",
    **{_id_of(entry.name): entry.name for entry in entry_points(group="cad_env.scenarios")},
}
for _id, _scenario in _IDS.items():
    if _id not in gym.registry:
        gym.register(
            _id,
            entry_point="cad_env.envs.single:CADEnv",
            vector_entry_point="cad_env.envs.vector:CADVectorEnv",
            max_episode_steps=MAX_STEPS,
            kwargs={"scenario": _scenario},
        )


def parallel_env(
    env_id: "str | Scenario" = "CADLeftTurn-v0", render_mode: str | None = None, **options: Any
) -> "CADParallelEnv":
    """The PettingZoo environment of an id or of a scenario, e.g. parallel_env("CADLeftTurn-v0", radio="cv2x")."""
    from cad_env.envs.parallel import parallel_env as make

    return make(env_id, render_mode, **options)
