"""The single-agent environment: a highway-env AbstractEnv over the compiled world. The ego decides: go or brake."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from cad_env.checks import ConfigError, check_mapping, check_range, check_seed, check_switch, check_whole, did_you_mean
from cad_env.config import check_keywords, check_names
from cad_env.envs.highway_base import HighwayBase
from cad_env.envs.highway_vehicles import WorldRoad
from cad_env.envs.rewards import ego_step, progress, reward_named
from cad_env.lidar.config import space_with
from cad_env.numerics.record_array import CopiedWhole
from cad_env.rendering.framing import screen
from cad_env.rendering.layers import LAYERS, checked_layers
from cad_env.rendering.viewer import SceneViewer, viewer_of
from cad_env.scenarios import scenario_named
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation, checked_hazard
from cad_env.types import BRAKE, COLLISION, GO, MAX_STEPS, SUCCESS, Floats, Observation
from cad_env.world.state import Truth

RENDER_MODES = ("human", "rgb_array")
_FIXED = {
    "observation": {"type": "SpatiotemporalGraph"},
    "action": {"type": "GoBrake"},
    "simulation_frequency": 20,
    "policy_frequency": 10,
}
_SIZES = {"screen_width", "screen_height"}  # pixels
_SWITCHES = {
    "object_lists", "show_trajectories", "render_agent", "manual_control", "real_time_rendering",
    "neighbour_vehicles_connected_lanes",
}  # fmt: skip
_SETUP = (
    "scenario", "ranges", "traffic", "penetration", "sensor", "radio", "pose", "depth", "cloud", "coverage", "share",
    "codec",
)  # fmt: skip


class CADEnv(CopiedWhole, HighwayBase):
    """One ego among connected vehicles. Actions: 0 go (its driver drives on), 1 brake (6 m/s2, after 0.2 s).

    Keyword arguments, or the same names in highway-env's `config`: `scenario` (name or Scenario), `radio` (preset name,
    RadioConfig or dict), `sensor` (SensorConfig or dict), `pose` (preset name, PoseConfig or dict: what vehicles know
    of where they are), `depth` (newest frames a message holds), `cloud` (CloudConfig or dict: points are shared, not
    graphs), `coverage` (True: messages also say what was seen to be empty, and the observation has the lanes on which
    somebody unseen may come), `traffic` (none, light or dense), `penetration` (share of the vehicles that is connected,
    None: two to four), `ranges` (dict of what the scenario is drawn from), `object_lists` (True adds to info what each
    connected vehicle tracks), `layers` (names of what pictures show over highway-env's view), `share` and `codec`
    (cad_env.simulation.graph_exchange), `reward` (a function of a step, cad_env.envs.rewards). By default the reward of
    a step is the share of the way to the goal covered in it, +1 on arrival, -1 on a collision. What is written into
    `config` later counts from the next `reset` on.

    >>> env = CADEnv(scenario="left_turn", radio="dsrc")
    >>> observation, info = env.reset(seed=1, options={"hazard": True})
    >>> observation["tracks"].shape, info["hazard"]
    ((24, 15, 3), True)
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012  Gymnasium's own form
    simulation: Simulation
    _spec: EnvSpec | None = None

    def __init__(self, config: Mapping[str, Any] | None = None, render_mode: str | None = None, **options: Any) -> None:
        check_render_mode(render_mode)
        check_keywords(options, [*_SETUP, "object_lists", "reward", "layers", "config", "render_mode"])
        self.viewer: SceneViewer | None = None
        settings = checked_settings(config)
        for name in options.keys() & settings.keys():
            if _differ(name, options[name], settings[name]):
                raise ValueError(f"{name} is given twice, as {options[name]!r} and in config as {settings[name]!r}")
        self._default = self.default_config()
        super().__init__(config={**settings, **options}, render_mode=render_mode)
        self._started = False  # highway-env has reset it, by a seed that nobody knows

    @property
    def spec(self) -> EnvSpec | None:
        """The id it was made by, and with what."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        check_scenario_of_id(spec, [self.simulation.scenario.name])
        self._spec = spec

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """highway-env's display settings, and what `setup_from` takes."""
        return {
            **super().default_config(),
            **_FIXED,
            **screen(scenario_named("left_turn").map),
            "scenario": "left_turn",
            "layers": tuple(LAYERS),  # what pictures show over highway-env's view
            "reward": "progress",  # of a step: a name or a function (cad_env.envs.rewards)
            "object_lists": False,  # True: info holds what each connected vehicle tracks by itself
        }

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Take settings in, those too that were written into `self.config` since the last time.

        An unknown or changed-but-fixed one is refused with its name, value and the choices. If something else is to be
        simulated from now on, the episode is over, and `reset` begins the next one.
        """
        given = checked_settings(config)
        settings = self._checked({**self._default, **self.config, **given})
        setup = setup_from({name: value for name, value in settings.items() if name in _SETUP})
        built: Simulation | None = getattr(self, "simulation", None)
        shown = scenario_named("left_turn") if built is None else built.scenario
        if setup.scenario != shown.name:  # the screen suits the scenario where it is not the user's own
            for name, value in screen(scenario_named(setup.scenario).map).items():
                if name not in given and np.array_equal(settings[name], screen(shown.map)[name]):
                    settings[name] = value
        simulation = built if built is not None and built.setup == setup else Simulation(setup)
        if built is not None:
            _check_same_observation(built, simulation)
        super().configure(settings)
        self.simulation = simulation

    def _checked(self, settings: dict[str, Any]) -> dict[str, Any]:
        """All settings, with the names of scenario and layers; ValueError for what there is not."""
        check_names("setting", settings, [*self._default, *_SETUP])
        settings = checked_display(settings)
        for name, value in _FIXED.items():
            if settings[name] != value:
                raise ValueError(f"{name} is {value!r} in this environment, got {settings[name]!r}")
        reward_named(settings["reward"])
        layers, scenario = checked_layers(settings["layers"]), scenario_named(settings["scenario"])
        return {**settings, "layers": layers, "scenario": scenario.name}

    def define_spaces(self) -> None:
        """Made once: highway-env makes new ones at every reset, which forgets a seeded action space."""
        self.observation_type = self.action_type = None
        self.observation_space: spaces.Dict = space_with(
            self.simulation.setup.cloud, self.simulation.scenario.command_count, self.simulation.setup.coverage
        )
        self.action_space: spaces.Discrete = spaces.Discrete(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Draw a scene. Options: `hazard` True or False forces the kind of episode, `config` changes settings."""
        options, seed = checked_options(options, ["hazard", "config"]), checked_seed(seed)
        gym.Env.reset(self, seed=seed)
        self.configure(options.get("config"))
        self.simulation.start(int(self.np_random.integers(2**31)) if seed is None else seed, options["hazard"], 1)
        self._started = True
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
        """Decide, let 0.1 s pass, perceive. The other connected vehicles follow their drivers.

        `terminated`: the ego has arrived or collided; `truncated`: time is up (MAX_STEPS), as Gymnasium's TimeLimit has
        it. Both may be True in the last decision; `info["outcome"]` is how it ended.
        """
        if not self._started:
            raise gym.error.ResetNeeded("call reset() before step()")
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
            simulation.observation(0), self._reward(action), outcome in (SUCCESS, COLLISION),
            simulation.steps >= MAX_STEPS, self._info(),
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

    def __getstate__(self) -> dict[str, Any]:
        """All but the picture: as highway-env's `__deepcopy__` does it."""
        return {**self.__dict__, "viewer": None, "_record_video_wrapper": None}

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
        self.viewer = viewer_of(self)
        return super().render()


def _check_same_observation(built: Simulation, simulation: Simulation) -> None:
    """Refuse with a one-line ValueError what would need another observation space."""
    if simulation.setup.cloud != built.setup.cloud:
        raise ValueError(f"cloud is a part of the observation and cannot change later, got {simulation.setup.cloud!r}")
    if simulation.setup.coverage != built.setup.coverage:
        raise ValueError(
            f"coverage is a part of the observation and cannot change later, got {simulation.setup.coverage!r}"
        )
    if simulation.scenario.command_count != built.scenario.command_count:
        raise ValueError(
            "commands are a part of the observation and cannot change later, "
            f"got the scenario {simulation.scenario.name!r}"
        )


def checked_settings(config: Any) -> dict[str, Any]:
    """highway-env's `config` as a new dict; None is an empty one."""
    return {} if config is None else check_mapping("config", config, "settings")


def _differ(name: str, one: Any, other: Any) -> bool:
    """Whether two values of a setting are not the same."""
    if name == "scenario":
        return scenario_named(one) is not scenario_named(other)
    return repr(one) != repr(other)


def check_scenario_of_id(spec: EnvSpec | None, names: Iterable[str]) -> None:
    """Refuse scenarios under the Gymnasium id of another one with a one-line ValueError."""
    registered = None if spec is None else gym.registry.get(spec.id)
    own = None if registered is None else registered.kwargs.get("scenario")
    for name in names:
        if own is not None and spec is not None and scenario_named(own).name != name:
            raise ValueError(
                f"{spec.id} is the scenario {scenario_named(own).name}, got scenario={name!r}: use CADScenario-v0"
            )


def check_render_mode(render_mode: str | None) -> None:
    """Refuse a mode that does not exist with a one-line ValueError."""
    if render_mode is not None and render_mode not in RENDER_MODES:
        near = did_you_mean(render_mode, RENDER_MODES)
        raise ConfigError(f"unknown render_mode {render_mode!r}: choose one of {', '.join(RENDER_MODES)}{near}")


def checked_options(options: Any, allowed: list[str]) -> dict[str, Any]:
    """The options of a reset, `hazard` among them checked; ValueError for what is no dict of those allowed."""
    given = {} if options is None else check_mapping("options", options, f"reset options ({', '.join(allowed)})")
    check_names("reset option", given, allowed)
    given["hazard"] = checked_hazard(given.get("hazard"))
    return given


def checked_seed(seed: Any) -> int | None:
    """The seed of a reset, any whole number from 0 on, or None to go on from the last."""
    return None if seed is None else check_seed("seed", seed)


def checked_display(given: Mapping[str, Any]) -> dict[str, Any]:
    """highway-env's settings of the viewer, as far as they are given; ValueError for one that cannot be drawn with."""
    checked = dict(given)
    for name in _SIZES & given.keys():
        checked[name] = check_whole(name, given[name], 1, 16384)
    if "scaling" in given:
        checked["scaling"] = check_range("scaling", given["scaling"], 0.01, 1000.0)
    for name in _SWITCHES & given.keys():
        checked[name] = check_switch(name, given[name])
    if "centering_position" in given:
        place = given["centering_position"]
        if not isinstance(place, Sequence | np.ndarray) or isinstance(place, str) or len(place) != 2:
            raise ValueError(f"centering_position must be a pair of shares of the picture, got {place!r}")
        checked["centering_position"] = [check_range("centering_position", each, -10.0, 10.0) for each in place]
    return checked


def as_array(given: Any) -> NDArray[Any]:
    """What was given for actions as an array; of object where lists of unequal lengths make none."""
    try:
        return np.asarray(given)
    except ValueError:
        return np.array(None, object)


def checked_action(action: Any) -> int:
    """GO or BRAKE as an int; ValueError for anything else, NaN and bools of other shapes included.

    >>> checked_action(np.int64(1))
    1
    """
    if type(action) is int and action in (GO, BRAKE):  # the usual case, which need not cost as much as the rest
        return action
    value = as_array(action)
    if value.ndim != 0 or value.dtype.kind not in "iuf" or not math.isfinite(value) or value not in (GO, BRAKE):
        raise ValueError(f"action must be {GO} (go) or {BRAKE} (brake), got {action!r}")
    return int(value)
