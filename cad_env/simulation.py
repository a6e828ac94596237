"""One episode: a scene, its world and its fleet of connected vehicles. What every environment stands on.

`Simulation` owns all state of an episode; the Gymnasium and PettingZoo environments only give it actions and hand
out what it shows.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from cad_env.chance import stream_key
from cad_env.compiled import announce_compilation
from cad_env.config import RadioConfig, SensorConfig, check_names, check_range, radio_config
from cad_env.pipeline.observe import as_observation
from cad_env.pipeline.radio import ACCEPTED, REASONS, link_of
from cad_env.pipeline.sense import sensing
from cad_env.pipeline.step import Fleet, new_fleet, run
from cad_env.planner import Truth
from cad_env.rows import as_graph
from cad_env.scenarios import scenario_named
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import Scene, place
from cad_env.types import FRAMES, STEP, Command, Graph, Ints, Observation
from cad_env.world.clearance import time_to_contact
from cad_env.world.state import World
from cad_env.world.step import advance

MAX_STEPS = 300  # decisions: 30 s
BEYOND = 25.0  # m past its manoeuvre, where a vehicle other than the ego has arrived
SUCCESS, COLLISION, TIMEOUT = "success", "collision", "timeout"


@dataclass(frozen=True)
class Setup:
    """Everything about an environment that is not drawn from the seed."""

    scenario: str = "left_turn"
    ranges: Mapping[str, Any] = field(default_factory=dict)  # of the scenario, by name
    traffic: str = "light"  # none, light or dense: how much is on the road around the cast
    penetration: float | None = None  # share of all vehicles that is connected; None: as many as `collaborators` says
    sensor: SensorConfig = field(default_factory=SensorConfig)
    radio: RadioConfig = field(default_factory=lambda: radio_config("dsrc"))
    depth: int = FRAMES  # newest frames in a message

    def __post_init__(self) -> None:
        check_range("depth", self.depth, 1, FRAMES)
        if int(self.depth) != self.depth:
            raise ValueError(f"depth must be a whole number, got {self.depth!r}")
        Traffic(self.traffic, self.penetration)
        scenario_named(self.scenario).configured(dict(self.ranges))


def setup_from(options: Mapping[str, Any]) -> Setup:
    """A Setup from keyword arguments: radio by preset, record or dict, sensor by record or dict.

    >>> setup_from({"radio": "cv2x"}).radio.budget
    90000.0
    >>> setup_from({"radoi": "cv2x"})
    Traceback (most recent call last):
    ...
    ValueError: unknown option radoi='cv2x': choose among depth, penetration, radio, ranges, scenario, ...
    """
    check_names("option", dict(options), [f.name for f in fields(Setup)])
    given = dict(options)
    for name, kind in (("radio", RadioConfig), ("sensor", SensorConfig)):
        if isinstance(given.get(name), Mapping):
            check_names(f"{name} setting", dict(given[name]), [f.name for f in fields(kind)])
            given[name] = kind(**given[name])
    if "radio" in given:
        given["radio"] = radio_config(given["radio"])
    if "sensor" in given and not isinstance(given["sensor"], SensorConfig):
        raise ValueError(f"sensor must be a SensorConfig or a dict of its settings, got {given['sensor']!r}")
    if "ranges" in given and not isinstance(given["ranges"], Mapping):
        raise ValueError(f"ranges must be a dict of the scenario's ranges, got {given['ranges']!r}")
    return Setup(**given)


class Simulation:
    """The state of one episode, and what happens in a decision step."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.scenario = scenario_named(setup.scenario)
        self.map = self.scenario.map
        self.ranges = self.scenario.configured(dict(setup.ranges))
        self.traffic = Traffic(setup.traffic, setup.penetration)
        self._sensor = sensing(setup.sensor)
        self._link = link_of(setup.radio)

    def start(self, seed: int, hazard: bool | None = None, receivers: int | None = None) -> None:
        """Begin the episode of a seed. `receivers`: how many of the connected, in order, merge and observe."""
        announce_compilation("step.run")
        self.seed, self.steps = seed, 0
        self.scene: Scene = self.scenario.scene(self.ranges, self.traffic, seed, hazard)
        self.world: World = place(self.scene, self.map.routes)
        self.agents: Ints = np.array(self.scene.connected, np.int64)
        self._keys = np.stack([stream_key(seed, name) for name in ("sense", "radio")])
        self._scratch = np.zeros(len(self.world.speed))
        count = len(self.agents) if receivers is None else receivers
        self.fleet: Fleet = new_fleet(self.agents, len(self.world.speed), count, self._link)
        self.min_ttc = math.inf
        self._perceive()

    def step(self, actions: Ints) -> None:
        """One decision: actions (V,), GO or BRAKE for each connected vehicle, then 0.1 s of world and perception."""
        advance(self.world, self.map.routes, self.agents, actions, self._scratch)
        self.steps += 1
        self._perceive()

    def _perceive(self) -> None:
        run(
            self.world, self.map.routes, self.fleet, self._sensor, self._link, self.setup.depth, self._keys, self.steps
        )  # fmt: skip
        self.min_ttc = min(self.min_ttc, float(time_to_contact(self.world, 0)))

    def observation(self, agent: int) -> Observation:
        """What receiver `agent` decides on."""
        return as_observation(_at(self.fleet.views, agent))

    def outcome(self, agent: int = 0) -> str | None:
        """success, collision, timeout, or None while the episode of this agent goes on."""
        row = self.agents[agent]
        if self.world.struck[row] >= 0:
            return COLLISION
        if self.world.progress[row] >= self.goal(agent):
            return SUCCESS
        return TIMEOUT if self.steps >= MAX_STEPS else None

    def goal(self, agent: int) -> float:
        """m along its route where an agent has arrived: the scene's goal for the ego, past the junction for others."""
        row = self.agents[agent]
        if row == 0:
            return self.scene.goal
        routes, route = self.map.routes, self.world.route[row]
        turning = np.flatnonzero(routes.command[route] != Command.FOLLOW_LANE)
        return float(turning[-1] * routes.spacing + BEYOND) if len(turning) else float(routes.length[route])

    def truth(self, agent: int = 0) -> Truth:
        """The world itself, for a privileged policy."""
        return Truth(self.world, self.map.routes, int(self.agents[agent]))

    @property
    def time(self) -> float:
        """s since the start."""
        return self.steps * STEP

    def traffic_on_air(self) -> dict[str, Any]:
        """Bytes and losses of the newest step, over all connected vehicles; scalars for an info dict."""
        air = self.fleet.report
        return {
            "bytes_sent": int(air.sent_bytes.sum()),
            "bytes_received": int(air.received_bytes[0]),
            "largest_message": int(air.sent_bytes.max()),
            "messages_sent": int((air.refusal == ACCEPTED).sum()),
            "messages_lost": int(air.lost[0]),
            "refused": next((REASONS[int(reason)] for reason in air.refusal if reason != ACCEPTED), None),
        }

    def own_graph(self, agent: int) -> Graph:
        """What connected vehicle `agent` knows by itself."""
        return as_graph(_at(self.fleet.window, agent), agent, self.time)

    def merged_graph(self, agent: int) -> Graph:
        """What receiver `agent` knows with what it was sent."""
        return as_graph(_at(self.fleet.merged, agent), agent, self.time)


def _at(stack: Any, index: int) -> Any:
    return type(stack)(*(part[index] for part in stack))
