"""The single-agent environment: a highway-env AbstractEnv over the compiled world. The ego decides: go or brake."""

import math
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from highway_env.envs.common.abstract import AbstractEnv

from cad_env.config import ConfigError, check_names, did_you_mean
from cad_env.envs.highway_vehicles import WorldRoad
from cad_env.envs.rewards import ego_step, progress, reward_named
from cad_env.lidar.config import space_with
from cad_env.rendering.framing import screen
from cad_env.rendering.layers import LAYERS, checked_layers
from cad_env.rendering.viewer import SceneViewer
from cad_env.scenarios import scenario_named
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, COLLISION, GO, SUCCESS, TIMEOUT, Floats, Observation
from cad_env.world.state import Truth

RENDER_MODES = ("human", "rgb_array")
_SETUP = ("scenario", "ranges", "traffic", "penetration", "sensor", "radio", "depth", "cloud", "share", "codec")


class CADEnv(AbstractEnv):
    """One ego among connected vehicles. Actions: 0 go (its driver drives on), 1 brake (6 m/s2, after 0.2 s).

    Keyword arguments, or the same names in highway-env's `config`: `scenario` (name or Scenario), `radio` (preset
    name, RadioConfig or dict), `sensor` (SensorConfig or dict), `depth` (newest frames a message holds), `cloud`
    (CloudConfig or dict: points are shared, not graphs), `traffic` (none, light or dense), `penetration` (share of the
    vehicles that is connected, None: two to four), `ranges` (dict of what the scenario is drawn from), `object_lists`
    (True adds to info what each connected vehicle tracks), `layers` (names of what pictures show over highway-env's
    view), `share` and `codec` (cad_env.simulation.graph_exchange), `reward` (a function of a step,
    cad_env.envs.rewards). By default the reward of a step is the share of the way to the goal covered in it, +1 on
    arrival, -1 on a collision.

    >>> env = CADEnv(scenario="left_turn", radio="dsrc")
    >>> observation, info = env.reset(seed=1, options={"hazard": True})
    >>> observation["tracks"].shape, info["hazard"]
    ((16, 15, 3), True)
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012  Gymnasium's own form
    simulation: Simulation

    def __init__(self, config: Mapping[str, Any] | None = None, render_mode: str | None = None, **options: Any) -> None:
        check_render_mode(render_mode)
        check_names("option", options, [*_SETUP, "object_lists", "reward", "layers", "config", "render_mode"])
        self.viewer: SceneViewer | None = None
        super().__init__(config={**dict(config or {}), **options}, render_mode=render_mode)

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """highway-env's display settings, and what `setup_from` takes."""
        return {
            **super().default_config(),
            "observation": {"type": "SpatiotemporalGraph"},
            "action": {"type": "GoBrake"},
            "simulation_frequency": 20,
            "policy_frequency": 10,
            **screen(scenario_named("left_turn").map),
            "scenario": "left_turn",
            "layers": tuple(LAYERS),  # what pictures show over highway-env's view
            "reward": "progress",  # of a step: a name or a function (cad_env.envs.rewards)
            "object_lists": False,  # True: info holds what each connected vehicle tracks by itself
        }

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Take settings in; an unknown or changed-but-fixed one is refused with its name, value and the choices."""
        default = self.default_config()
        given = dict(config or {})
        check_names("setting", given, [*default, *_SETUP])
        for name in ("observation", "action", "simulation_frequency", "policy_frequency"):
            if given.get(name, default[name]) != default[name]:
                raise ValueError(f"{name} is {default[name]!r} in this environment, got {given[name]!r}")
        reward_named(given.get("reward", default["reward"]))
        if "layers" in given:
            given["layers"] = checked_layers(given["layers"])
        if "scenario" in given:
            scenario = scenario_named(given["scenario"])
            given = {**screen(scenario.map), **given, "scenario": scenario.name}
        setup = setup_from({k: v for k, v in {**self.config, **given}.items() if k in _SETUP})
        if hasattr(self, "simulation") and self.simulation.setup.cloud != setup.cloud:
            raise ValueError(f"cloud is a part of the observation and cannot change later, got {setup.cloud!r}")
        simulation = Simulation(setup)
        if hasattr(self, "simulation") and simulation.scenario.command_count != self.simulation.scenario.command_count:
            raise ValueError(
                f"commands are a part of the observation and cannot change later, got the scenario {setup.scenario!r}"
            )
        super().configure(given)
        self.simulation = simulation

    def define_spaces(self) -> None:
        """Made once: highway-env makes new ones at every reset, which forgets a seeded action space."""
        self.observation_type = self.action_type = None
        self.observation_space: spaces.Dict = space_with(
            self.simulation.setup.cloud, self.simulation.scenario.command_count
        )
        self.action_space: spaces.Discrete = spaces.Discrete(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Draw a scene. Options: `hazard` True or False forces the kind of episode, `config` changes settings."""
        options = options or {}
        check_names("reset option", options, ["hazard", "config"])
        hazard = checked_hazard(options.get("hazard"))
        gym.Env.reset(self, seed=seed)
        if "config" in options:
            self.configure(options["config"])
        self.simulation.start(int(self.np_random.integers(2**31)) if seed is None else seed, hazard, receivers=1)
        self.time, self.steps, self.done = 0.0, 0, False
        simulation = self.simulation
        self.road = WorldRoad(
            simulation.map.network, simulation.world, simulation.map.routes, simulation.scene.connected
        )
        self.controlled_vehicles = [self.road.rows[0]]
        self._actions = np.zeros(len(simulation.agents), np.int64)
        if self.render_mode == "human":
            self.render()
        return simulation.observation(0), self._info()

    def step(self, action: int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Decide, let 0.1 s pass, perceive. The other connected vehicles follow their drivers."""
        if self.done:
            raise RuntimeError("the episode is over: call reset() before step()")
        simulation = self.simulation
        self._actions[0] = checked_action(action)
        self._before = float(simulation.world.progress[0])
        simulation.step(self._actions)
        self.time, self.steps = simulation.time, simulation.steps
        outcome = simulation.outcome()
        self.done = outcome is not None
        if self.render_mode == "human":
            self.render()
        return (
            simulation.observation(0), self._reward(action), outcome in (SUCCESS, COLLISION), outcome == TIMEOUT,
            self._info(),
        )  # fmt: skip

    def _reward(self, action: int) -> float:
        reward = reward_named(self.config["reward"])
        if reward is progress:  # which the compiled step has computed already
            return self.simulation.reward()
        return float(reward(ego_step(self.simulation, int(self._actions[0]), self._before)))

    def _info(self, *_: Any) -> dict[str, Any]:
        info = self.simulation.info()
        if self.config["object_lists"]:
            info["object_lists"] = self.simulation.object_lists()
        return info

    def truth(self) -> Truth:
        """The world itself: what a privileged policy is given in place of an observation."""
        return self.simulation.truth()

    def object_lists(self) -> list[Floats]:
        """For each connected vehicle, ego first, the (n, 3) m newest positions of the objects it tracks itself."""
        return self.simulation.object_lists()

    def render(self) -> Any:
        """An image (H, W, 3) uint8 in mode rgb_array; a window in mode human."""
        if self.render_mode is None:
            gym.logger.warn(
                f"render() was called without specifying any render mode: choose one of {', '.join(RENDER_MODES)}"
            )
            return None
        if self.viewer is None:
            self.viewer = SceneViewer(self)
        return super().render()


def check_render_mode(render_mode: str | None) -> None:
    """Refuse a mode that does not exist with a one-line ValueError."""
    if render_mode is not None and render_mode not in RENDER_MODES:
        near = did_you_mean(render_mode, RENDER_MODES)
        raise ConfigError(f"unknown render_mode {render_mode!r}: choose one of {', '.join(RENDER_MODES)}{near}")


def checked_hazard(hazard: Any) -> bool | None:
    """The reset option that forces the kind of an episode, or None to draw it; ValueError for anything else."""
    if hazard is not None and not isinstance(hazard, bool):
        raise ValueError(f"hazard must be True, False or None, got {hazard!r}")
    return hazard


def checked_action(action: Any) -> int:
    """GO or BRAKE as an int; ValueError for anything else, NaN and bools of other shapes included.

    >>> checked_action(np.int64(1))
    1
    """
    if type(action) is int and action in (GO, BRAKE):  # the usual case, which need not cost as much as the rest
        return action
    value = np.asarray(action)
    if value.ndim != 0 or value.dtype.kind not in "iuf" or not math.isfinite(value) or value not in (GO, BRAKE):
        raise ValueError(f"action must be {GO} (go) or {BRAKE} (brake), got {action!r}")
    return int(value)
