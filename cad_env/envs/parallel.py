"""The multi-agent environment (PettingZoo): every connected vehicle sees, is told, and decides for itself."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from cad_env.checks import check_range, check_switch, check_whole
from cad_env.envs.global_state import global_state, global_state_space
from cad_env.envs.goals import goals
from cad_env.envs.highway_vehicles import WorldRoad
from cad_env.envs.rewards import StepOutcome, progress, reward_named
from cad_env.envs.single import (
    RENDER_MODES,
    CADEnv,
    check_render_mode,
    checked_action,
    checked_options,
    checked_seed,
)
from cad_env.lidar.config import space_with
from cad_env.numerics.record_array import CopiedWhole
from cad_env.rendering.framing import screen
from cad_env.rendering.layers import LAYERS, checked_layers
from cad_env.rendering.viewer import SceneViewer
from cad_env.scenarios.registry import scenario_named, scenario_of_id
from cad_env.scenarios.scenario import Scenario
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation, outcome_of
from cad_env.types import COLLISION, GO, MAX_STEPS, SUCCESS, TIMEOUT, Floats, Ints, Observation
from cad_env.world.state import Truth
from cad_env.world.step import struck_from_behind
from cad_env.world.time_to_contact import time_to_contact

COLLABORATORS = (3, 3)  # a fixed number unless asked otherwise: many multi-agent libraries want fixed agents
WAITED = "waited"  # the outcome of a vehicle that could only wait, and was not hit

Infos = dict[str, dict[str, Any]]
Step = tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos]


class CADParallelEnv(CopiedWhole, ParallelEnv[str, Observation, int]):
    """Agents `cav_0` (the ego), `cav_1`, ...: each connected vehicle with its own observation, go or brake, and reward.

    An agent that has arrived, crashed or run out of time leaves `agents`; its body stays in the scene and drives on.
    A connected vehicle that can only wait (at a red light, in a queue, parked) sees and tells, but is no agent: its
    number is missing among the names. With `waiting=True` it is one (`info["waits"]`); it then stays until nobody else
    is left, and leaves unharmed, with the outcome `waited` and no reward. `outcomes` has the outcome of each that has
    left.
    Whoever leaves is terminated. When time is up all that are left are truncated, those that only waited too, and
    terminated beside it only if they arrive or crash in this very step.

    Keyword arguments as for CADEnv, `max_cycles`, decisions until time is up, `waiting`, and `team`, from 0, everybody
    is paid for its own steps, to 1, everybody is paid the same: in each step the sum of all that the agents of the
    scene would be paid for their own, shared out among all that there were at the start. There are three collaborators
    unless `ranges` or `penetration` say otherwise. Every value in an `info` is a number, as TorchRL wants it;
    it keeps them as float32, which rounds a `seed` from 2**24 on: infos of `FixedAgents` have it in two numbers.

    >>> env = CADParallelEnv()
    >>> observations, infos = env.reset(seed=1)
    >>> while env.agents:
    ...     observations, rewards, terminations, truncations, infos = env.step(dict.fromkeys(env.agents, 0))
    >>> env.outcomes
    {'cav_2': 'success', 'cav_0': 'success'}
    """

    metadata = {"name": "cad_v0", "render_modes": list(RENDER_MODES), "render_fps": 10, "is_parallelizable": True}  # noqa: RUF012

    def __init__(self, render_mode: str | None = None, max_cycles: int = MAX_STEPS, **options: Any) -> None:
        check_render_mode(render_mode)
        self._reward = reward_named(options.pop("reward", "progress"))
        self.layers = checked_layers(options.pop("layers", tuple(LAYERS)))
        max_cycles = check_whole("max_cycles", max_cycles, 1)
        self._team = check_range("team", options.pop("team", 0.0), 0.0, 1.0)
        self._waiting = check_switch("waiting", options.pop("waiting", False))
        if options.get("cloud") is not None:
            raise ValueError(f"cloud is for one ego (CADEnv, CADVectorEnv) only, got {options['cloud']!r}")
        ranges = options.pop("ranges", {})
        if isinstance(ranges, Mapping) and options.get("penetration") is None:
            ranges = {"collaborators": COLLABORATORS, **ranges}
        self.simulation = Simulation(setup_from({**options, "ranges": ranges}))
        self.render_mode = render_mode
        self.max_cycles = max_cycles
        most = self.simulation.scenario.most_connected(self.simulation.ranges, self.simulation.traffic)
        self.possible_agents = [f"cav_{k}" for k in range(most)]
        commands = self.simulation.scenario.command_count
        coverage = self.simulation.setup.coverage
        self.observation_spaces = {agent: space_with(None, commands, coverage) for agent in self.possible_agents}
        self.action_spaces = {agent: spaces.Discrete(2) for agent in self.possible_agents}
        self.state_space = global_state_space()
        self.agents: list[str] = []
        self.outcomes: dict[str, str] = {}
        self.np_random: np.random.Generator | None = None  # from the first reset on, so that copies of an env differ
        self._number = {agent: k for k, agent in enumerate(self.possible_agents)}
        self._viewer: SceneViewer | None = None

    def observation_space(self, agent: str) -> spaces.Dict:
        """Equal for every agent; the same object every time."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """0 go, 1 brake; the same object every time."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, Infos]:
        """Draw a scene -> (observations, infos), a dict by agent each.

        A seed is an episode, the same one as in CADEnv, and the start of those of later resets without a seed. Option
        `hazard` True or False forces the kind of episode; an option named `options`, which PettingZoo's own tests pass,
        changes nothing.
        """
        options, seed = checked_options(options, ["hazard", "options"]), checked_seed(seed)
        if seed is not None or self.np_random is None:
            self.np_random = np.random.default_rng(seed)
        self.simulation.start(int(self.np_random.integers(2**31)) if seed is None else seed, options["hazard"])
        simulation = self.simulation
        world, rows = simulation.world, simulation.agents
        self._goal, waits = goals(world, simulation.map.routes, rows, simulation.scene.goal)
        self._waits, self.outcomes = waits.tolist(), {}
        names = zip(self.possible_agents, self._waits, strict=False)
        self.agents = [agent for agent, waits in names if self._waiting or not waits]
        self._agents_at_start = len(self.agents)
        self._start = self._progress = world.progress[rows]
        self._way = np.maximum(self._goal - self._start, 1.0)
        self._min_ttc = np.full(len(rows), np.inf)
        self._note_contacts()
        if self.render_mode == "human":
            self.render()
        return self._observations(), self._infos([None] * len(rows))

    def step(self, actions: Mapping[str, int]) -> Step:
        """Everybody decides, 0.1 s passes, everybody perceives -> observations, rewards, terminations, truncations,
        infos, of all that were there; whoever is done leaves. Actions of those who have left already are ignored."""
        if not self.agents:
            raise RuntimeError("no agent is left: call reset() before step()")
        chosen = self._chosen(actions)
        self.simulation.step(chosen)
        there, outcomes = self.agents, self._outcomes()
        rewards, infos, observations = self._rewards(outcomes, chosen), self._infos(outcomes), self._observations()
        ended = [outcomes[self._number[agent]] for agent in there]
        by_itself = (SUCCESS, COLLISION) if self._time_is_up else (SUCCESS, COLLISION, WAITED)
        terminations = {agent: end in by_itself for agent, end in zip(there, ended, strict=True)}
        truncations = dict.fromkeys(there, self._time_is_up)
        self.outcomes.update({agent: end for agent, end in zip(there, ended, strict=True) if end is not None})
        self.agents = [agent for agent, end in zip(there, ended, strict=True) if end is None]
        if self.render_mode == "human":
            self.render()
        return observations, rewards, terminations, truncations, infos

    def _chosen(self, actions: Mapping[str, int]) -> Ints:
        """(V,) what every connected vehicle does; those who have left go."""
        if not isinstance(actions, Mapping):
            raise ValueError(f"actions must be a dict with one for each of {self.agents}, got {actions!r}")
        if not (self._number.keys() >= actions.keys() >= set(self.agents)):
            raise ValueError(f"one action for each of {self.agents} is needed, got {list(actions)}")
        chosen = np.full(len(self.simulation.agents), GO)
        for agent in self.agents:
            chosen[self._number[agent]] = checked_action(actions[agent])
        return chosen

    @property
    def _time_is_up(self) -> bool:
        return self.simulation.steps >= self.max_cycles

    def _outcomes(self) -> list[str | None]:
        """How it ended for every connected vehicle, None for those who go on."""
        world, rows = self.simulation.world, self.simulation.agents
        over = self._time_is_up
        struck, arrived = (world.struck[rows] >= 0).tolist(), (world.progress[rows] >= self._goal).tolist()
        outcomes = [outcome_of(s, a, over) for s, a in zip(struck, arrived, strict=True)]
        alive = [k for k in map(self._number.__getitem__, self.agents) if outcomes[k] in (None, TIMEOUT)]
        if all(self._waits[k] or outcomes[k] == TIMEOUT for k in alive):
            for k in alive:
                if self._waits[k]:
                    outcomes[k] = WAITED
        return outcomes

    def _observations(self) -> dict[str, Observation]:
        every = self.simulation.observations()
        return {agent: every[self._number[agent]] for agent in self.agents}

    def _rewards(self, outcomes: list[str | None], chosen: Ints) -> dict[str, float]:
        """Of every agent by the environment's reward; who can only wait makes no progress."""
        simulation = self.simulation
        rows, report = simulation.agents, simulation.fleet.report
        place: Floats = simulation.world.progress[rows]
        travelled = place - self._progress
        share = travelled / self._way
        self._progress = place
        self._note_contacts()
        earned = {}
        for agent in self.agents:
            k = self._number[agent]
            step = StepOutcome(
                action=int(chosen[k]), travelled=float(travelled[k]), progress=float(share[k]),
                speed=float(simulation.world.speed[rows[k]]), time=simulation.time, outcome=outcomes[k],
                hazard=simulation.scene.hazard, min_ttc=float(self._min_ttc[k]), bytes_sent=int(report.sent_bytes[k]),
            )  # fmt: skip
            earned[agent] = float(self._reward(step))
        return self._shared_out(earned)

    def _shared_out(self, earned: dict[str, float]) -> dict[str, float]:
        """What everybody is paid, if a share of it is the team's."""
        if self._team == 0.0:
            return earned
        everybody = self._team * sum(earned.values()) / self._agents_at_start
        return {agent: (1.0 - self._team) * own + everybody for agent, own in earned.items()}

    def _note_contacts(self) -> None:
        """Keep the least time to contact of every agent, s, for rewards from outside: the usual one does not ask."""
        if self._reward is not progress:
            for agent in self.agents:
                k = self._number[agent]
                now = time_to_contact(self.simulation.world, self.simulation.agents[k])
                self._min_ttc[k] = min(self._min_ttc[k], now)

    def _infos(self, outcomes: list[str | None]) -> Infos:
        simulation, air = self.simulation, self.simulation.fleet.report
        covered = np.minimum((self._progress - self._start) / self._way, 1.0).tolist()
        speed = simulation.world.speed[simulation.agents].tolist()
        sent, received, lost = air.sent_bytes.tolist(), air.received_bytes.tolist(), air.lost.tolist()
        refused = air.messages_refused.tolist()
        episode, infos = simulation.episode_info(), {}
        for agent in self.agents:
            k = self._number[agent]
            infos[agent] = {
                **episode, "waits": self._waits[k],
                "is_success": outcomes[k] == SUCCESS, "crashed": outcomes[k] == COLLISION,
                "struck_from_behind": struck_from_behind(simulation.world, int(simulation.agents[k])),
                "covered": covered[k], "speed": speed[k],
                "bytes_sent": sent[k], "bytes_received": received[k], "messages_lost": lost[k],
                "messages_refused": refused[k],
            }  # fmt: skip
        return infos

    def __getstate__(self) -> dict[str, Any]:
        """All but the picture."""
        return {**self.__dict__, "_viewer": None}

    def state(self) -> NDArray[np.float32]:
        """The truth as a vector in `state_space`, for a centralised critic: see `cad_env.envs.global_state`."""
        return global_state(self.simulation.world, self.simulation.agents)

    def truth(self, agent: str) -> Truth:
        """The world itself, for a privileged policy."""
        return self.simulation.truth(self._number[agent])

    def render(self) -> Any:
        """An image (H, W, 3) uint8 in mode rgb_array; a window in mode human, which reset and step keep up to date."""
        if self.render_mode is None:
            gym.logger.warn(
                f"render() was called without specifying any render mode: choose one of {', '.join(RENDER_MODES)}"
            )
            return None
        simulation = self.simulation
        road = WorldRoad(simulation.map.network, simulation.world, simulation.map.routes, simulation.scene.connected)
        if self._viewer is None:
            self._viewer = SceneViewer(SimpleNamespace(config=self._display(), observation_type=None, action_type=None))
        shown = self._viewer.env
        shown.road = road
        shown.vehicle, shown.simulation = shown.road.rows[0], simulation
        self._viewer.display()
        return self._viewer.get_image() if self.render_mode == "rgb_array" else self._viewer.handle_events()

    def _display(self) -> dict[str, Any]:
        """highway-env's settings of the viewer, as CADEnv has them."""
        window = self.render_mode == "human"
        suited = screen(self.simulation.map)
        return {**CADEnv.default_config(), **suited, "layers": self.layers, "offscreen_rendering": not window}

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._viewer is not None:
            self._viewer.close()
        self._viewer = None


def parallel_env(
    env_id: str | Scenario = "CADLeftTurn-v0", render_mode: str | None = None, **options: Any
) -> CADParallelEnv:
    """The PettingZoo environment of an id or of a scenario, e.g. parallel_env("CADLeftTurn-v0", radio="cv2x")."""
    if env_id not in ("CADScenario-v0", "cad_env:CADScenario-v0"):  # which has its scenario among the options
        own = env_id if isinstance(env_id, Scenario) else scenario_of_id(env_id)
        if "scenario" in options and scenario_named(options["scenario"]) is not own:
            raise ValueError(
                f"{env_id} is the scenario {own.name}, got scenario={options['scenario']!r}: use CADScenario-v0"
            )
        options["scenario"] = own
    return CADParallelEnv(render_mode=render_mode, **options)
