"""The multi-agent environment (PettingZoo): every connected vehicle sees, is told, and decides for itself."""

from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from cad_env.env import RENDER_MODES, CADEnv, check_render_mode, checked_action, checked_hazard
from cad_env.pipeline.observe import observation_space
from cad_env.planner import Truth
from cad_env.scenarios import SCENARIOS
from cad_env.simulation import COLLISION, SUCCESS, TIMEOUT, Simulation, setup_from
from cad_env.types import GO, Observation
from cad_env.views import NorthUpViewer, WorldRoad

COLLABORATORS = (3, 3)  # a fixed number unless asked otherwise: many multi-agent libraries want fixed agents


class CADParallelEnv(ParallelEnv[str, Observation, int]):
    """Agents `cav_0` (the ego), `cav_1`, ...: each connected vehicle with its own observation, go or brake, and reward.

    A vehicle that has arrived, crashed or run out of time leaves `agents`; its body stays in the scene and drives on.
    Keyword arguments as for CADEnv; there are three collaborators unless `ranges` or `penetration` say otherwise.
    """

    metadata = {"name": "cad_v0", "render_modes": list(RENDER_MODES), "render_fps": 10, "is_parallelizable": True}  # noqa: RUF012

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        check_render_mode(render_mode)
        ranges = options.pop("ranges", {})
        if isinstance(ranges, Mapping):
            ranges = {"collaborators": COLLABORATORS, **ranges}
        self.simulation = Simulation(setup_from({**options, "ranges": ranges}))
        self.render_mode = render_mode
        most = self.simulation.scenario.most_connected(self.simulation.ranges, self.simulation.traffic)
        self.possible_agents = [f"cav_{k}" for k in range(most)]
        self.agents: list[str] = []
        self.np_random = np.random.default_rng()
        self._viewer: NorthUpViewer | None = None

    @cache  # noqa: B019  PettingZoo compares the identity of spaces; an env lives as long as its spaces
    def observation_space(self, agent: str) -> spaces.Dict:
        """The same for every agent."""
        return observation_space()

    @cache  # noqa: B019
    def action_space(self, agent: str) -> spaces.Discrete:
        """0 go, 1 brake."""
        return spaces.Discrete(2)

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Draw a scene; option `hazard` True or False forces the kind of episode, others are PettingZoo's to pass."""
        hazard = checked_hazard((options or {}).get("hazard"))
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self.simulation.start(int(self.np_random.integers(2**31)) if seed is None else seed, hazard)
        self.agents = self.possible_agents[: len(self.simulation.agents)]
        return self._observations(), {agent: self._info(k) for k, agent in enumerate(self.agents)}

    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[
        dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:  # fmt: skip
        """Everybody decides, 0.1 s passes, everybody perceives; whoever is done leaves."""
        if not self.agents:
            raise RuntimeError("no agent is left: call reset() before step()")
        if set(actions) != set(self.agents):
            raise ValueError(f"one action for each of {self.agents} is needed, got {sorted(actions)}")
        chosen = np.full(len(self.simulation.agents), GO)
        for agent, action in actions.items():
            chosen[self._index(agent)] = checked_action(action)
        self.simulation.step(chosen)
        outcomes = {agent: self.simulation.outcome(self._index(agent)) for agent in self.agents}
        rewards = {agent: self.simulation.reward(self._index(agent)) for agent in self.agents}
        observations = self._observations()
        infos = {agent: self._info(self._index(agent)) for agent in self.agents}
        terminations = {agent: outcome in (SUCCESS, COLLISION) for agent, outcome in outcomes.items()}
        truncations = {agent: outcome == TIMEOUT for agent, outcome in outcomes.items()}
        self.agents = [agent for agent in self.agents if outcomes[agent] is None]
        return observations, rewards, terminations, truncations, infos

    def _index(self, agent: str) -> int:
        return self.possible_agents.index(agent)

    def _observations(self) -> dict[str, Observation]:
        return {agent: self.simulation.observation(self._index(agent)) for agent in self.agents}

    def _info(self, index: int) -> dict[str, Any]:
        simulation, air = self.simulation, self.simulation.fleet.report
        outcome = simulation.outcome(index)
        return {
            "seed": simulation.seed, "hazard": simulation.scene.hazard, "outcome": outcome,
            "is_success": outcome == SUCCESS, "speed": float(simulation.world.speed[simulation.agents[index]]),
            "bytes_sent": int(air.sent_bytes[index]), "bytes_received": int(air.received_bytes[index]),
            "messages_lost": int(air.lost[index]),
        }  # fmt: skip

    def truth(self, agent: str) -> Truth:
        """The world itself, for a privileged policy."""
        return self.simulation.truth(self._index(agent))

    def render(self) -> Any:
        """An image (H, W, 3) uint8 in mode rgb_array; a window in mode human."""
        if self.render_mode is None:
            return None
        simulation = self.simulation
        road = WorldRoad(simulation.map.network, simulation.world, simulation.map.routes, simulation.scene.connected)
        if self._viewer is None:
            config = {**CADEnv.default_config(), "offscreen_rendering": self.render_mode != "human"}
            self._viewer = NorthUpViewer(SimpleNamespace(config=config, observation_type=None, action_type=None))
        self._viewer.env.road, self._viewer.env.vehicle = road, road.rows[0]
        self._viewer.display()
        return self._viewer.get_image() if self.render_mode == "rgb_array" else self._viewer.handle_events()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._viewer is not None:
            self._viewer.close()
        self._viewer = None


def parallel_env(env_id: str = "CADLeftTurn-v0", render_mode: str | None = None, **options: Any) -> CADParallelEnv:
    """The PettingZoo environment of a registered id, e.g. parallel_env("CADLeftTurn-v0", radio="cv2x")."""
    ids = {scenario.gym_id: scenario.name for scenario in SCENARIOS.values()}
    if env_id not in ids:
        raise ValueError(f"unknown environment {env_id!r}: choose among {', '.join(ids)}")
    return CADParallelEnv(render_mode=render_mode, scenario=ids[env_id], **options)
