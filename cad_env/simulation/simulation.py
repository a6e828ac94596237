"""One episode: a scene, its world and its fleet of connected vehicles. What every environment stands on.

`Simulation` owns all state of an episode; the Gymnasium and PettingZoo environments only give it actions and hand
out what it shows.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from cad_env.checks import check_seed
from cad_env.config import radio_config
from cad_env.lidar.config import OwnCloud
from cad_env.numerics.jit import announce_compilation
from cad_env.numerics.philox import stream_key
from cad_env.numerics.record_array import CopiedWhole
from cad_env.pipeline.fleet import Fleet, new_fleet, nothing_injected
from cad_env.pipeline.graph_arrays import as_graph
from cad_env.pipeline.observe import as_observation, empty_view
from cad_env.pipeline.radio import NOT_SENT, REASONS, fate, link_of
from cad_env.pipeline.sense import sensing
from cad_env.scenarios import scenario_named
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import Scene, place
from cad_env.simulation.cloud_exchange import Sharing, exchange
from cad_env.simulation.graph_exchange import GraphExchange
from cad_env.simulation.scene_step import (
    FINAL_REWARDS,
    OUTCOME_BY_CODE,
    BatchState,
    SceneState,
    play,
    play_exchanged,
    verdict,
)
from cad_env.simulation.setup import Setup
from cad_env.types import COLLISION, STEP, SUCCESS, Floats, Graph, Ints, Observation
from cad_env.world.lanes import empty_lanes
from cad_env.world.state import IDM, YIELDING, Truth, World, indices_on_map

FINAL_REWARD: Mapping[str | None, float] = MappingProxyType(dict(zip(OUTCOME_BY_CODE, FINAL_REWARDS, strict=True)))
# What an episode has, and a simulation before its first one has not.
_OF_AN_EPISODE = ("seed", "scene", "world", "agents", "fleet", "_keys", "_scene_state")
REFUSALS = (None, *REASONS[1:])  # what info says of the number why a message was refused


class Simulation(CopiedWhole):
    """The state of one episode, and what happens in a decision step; it has a place in a batch, alone or not."""

    def __init__(self, setup: Setup, batch_state: BatchState | None = None, place: int = 0) -> None:
        self.setup = setup
        self.scenario = scenario_named(setup.scenario)
        self.map = self.scenario.map
        self.ranges = self.scenario.configured(dict(setup.ranges))
        self.traffic = Traffic(setup.traffic, setup.penetration)
        self._sensor = sensing(setup.sensor)
        self._batch_state = batch_state or BatchState(1, setup.cloud, self.scenario.command_count, setup.coverage)
        self._lanes = self.map.lanes if setup.coverage else empty_lanes()
        self._place, self._which = place, np.array([place])
        link, shown = link_of(setup.radio), self._batch_state.clouds_at(place)
        self.sharing: Sharing | None = None
        if setup.cloud is not None and shown is not None:  # points are on the air, and graphs are not
            self.sharing, link = Sharing(setup.cloud, link, shown), link_of(radio_config("none"))
        self.graph_exchange: GraphExchange | None = None
        if setup.exchanges_graphs:
            self.graph_exchange = GraphExchange(setup.share, setup.codec, link, setup.depth)
            link = link_of(radio_config("none"))
        self._link = link

    def start(self, seed: int, hazard: bool | None = None, receivers: int | None = None) -> None:
        """Begin the episode of a seed, any whole number from 0 on. `hazard` True or False forces its kind.

        `receivers`: how many of the connected, in order, observe and decide.
        """
        seed, hazard = check_seed("seed", seed), checked_hazard(hazard)
        announce_compilation("scene_step.play")
        self.seed = seed
        self.scene: Scene = self.scenario.scene(self.ranges, self.traffic, seed, hazard)
        self.world: World = place(self.scene.placements, self.map.routes)
        self.agents: Ints = np.array(self.scene.connected, np.int64)
        vehicles, count = len(self.world.speed), len(self.agents) if receivers is None else receivers
        deciding = self.agents[:count]  # nobody decides for them as well
        self.world.driver[deciding[self.world.driver[deciding] == YIELDING]] = IDM
        commands = self.scenario.command_count
        views = self._batch_state.views_at(self._place) if count == 1 else empty_view(count, commands=commands)
        self.fleet: Fleet = new_fleet(
            self.agents, vehicles, count, self._link, self._lanes, self.setup.sensor.miss, self.setup.pose
        )._replace(views=views)
        if count == 1:
            self.fleet = self.fleet._replace(lane_views=self._batch_state.lane_views_at(self._place))
        self._keys = np.stack([stream_key(seed, name) for name in ("sense", "radio", "pose")])
        goal, step_info = self.scene.goal, self._batch_state.step_info_at(self._place)
        step_info.min_ttc[0], step_info.progress[0] = math.inf, self.world.progress[0]
        self._scene_state = SceneState(
            world=self.world,
            routes=self.map.routes,
            lanes=self._lanes,
            fleet=self.fleet,
            sensor=self._sensor,
            link=self._link,
            depth=self.setup.depth,
            keys=self._keys,
            clock=np.zeros(1, np.int64),
            actions=np.zeros(len(self.agents), np.int64),
            goal=float(goal),
            way=float(goal - self.world.progress[0]),
            step_info=step_info,
            scratch=np.zeros(vehicles),
        )
        self._batch_state.put(self._place, self._scene_state)
        if self.sharing is not None:
            self.sharing.start(self._scene_state, seed)
        if self.graph_exchange is not None:
            self.graph_exchange.start(self._scene_state)
        self._perceive()

    def step(self, actions: Ints) -> None:
        """One decision: actions (V,), GO or BRAKE for each connected vehicle, then 0.1 s of world and perception."""
        self._scene_state.actions[:] = actions
        self._play(True)

    if not TYPE_CHECKING:  # which would take any attribute for granted

        def __getattr__(self, name: str) -> Any:
            if name in _OF_AN_EPISODE:
                raise gym.error.ResetNeeded("no episode has begun: call reset() first")
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_scene_state", "world", "fleet")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A copy has its place in a copy of the batch, with whatever else is in it."""
        self.__dict__.update(state)
        scene, clouds = self._batch_state.scene(self._place), self._batch_state.clouds_at(self._place)
        if scene is not None:
            self._scene_state, self.world, self.fleet = scene, scene.world, scene.fleet
        if self.sharing is not None and clouds is not None:
            self.sharing.move_to(scene, clouds)
        if self.graph_exchange is not None and scene is not None:
            self.graph_exchange.move_to(scene)

    def _perceive(self) -> None:
        self._play(False)

    def _play(self, moves: bool) -> None:
        play(self._batch_state.records, self._which, self._scene_state.actions, moves)
        if self.sharing is not None:
            exchange([self.sharing], self._batch_state.rooms)
        self.exchange_graphs()

    def exchange_graphs(self) -> None:
        """Send and receive graphs by rules from outside, if there are any, after the compiled step."""
        if self.graph_exchange is not None:
            self.graph_exchange.exchange()
            play_exchanged(self._batch_state.records, self._place)

    def observation(self, agent: int) -> Observation:
        """What receiver `agent` decides on; the ego, number 0, is the only one that is shown clouds."""
        seen = as_observation(_at(self.fleet.views, agent))
        if self.setup.coverage:
            seen.update(as_observation(_at(self.fleet.lane_views, agent)))
        if self.sharing is not None and agent == 0:
            seen.update(as_observation(self.sharing.view))
        return seen

    def observations(self) -> list[Observation]:
        """What every receiver decides on, in their order: one copy of each part for all, and a row of it for each."""
        shown: list[Any] = [self.fleet.views, *([self.fleet.lane_views] if self.setup.coverage else [])]
        parts = {name: part.copy() for views in shown for name, part in zip(views._fields, views, strict=True)}
        return [{name: part[k] for name, part in parts.items()} for k in range(len(self.fleet.views.ego))]

    def outcome(self) -> str | None:
        """success, collision, timeout, or None while the episode of the ego goes on."""
        return OUTCOME_BY_CODE[self._scene_state.step_info.outcome.item()]

    def reward(self) -> float:
        """Of the ego in the newest step: the share of its way that it covered, +1 on arrival, -1 on a collision."""
        return self._scene_state.step_info.reward.item()

    @property
    def min_ttc(self) -> float:
        """s, the least time to contact of the ego so far; inf if nothing was on a collision course."""
        return self._scene_state.step_info.min_ttc.item()

    @property
    def way(self) -> float:
        """m from the start of the ego to its goal."""
        return self._scene_state.way

    def truth(self, agent: int = 0) -> Truth:
        """The world itself, for a privileged policy."""
        return Truth(self.world, self.map.routes, int(self.agents[agent]))

    @property
    def steps(self) -> int:
        """Decisions since the start."""
        return int(self._scene_state.clock[0])

    @property
    def time(self) -> float:
        """s since the start."""
        return self.steps * STEP

    def episode_info(self) -> dict[str, Any]:
        """What info says of a whole episode, the same in every environment.

        `hazard_time`, s after the start: when an ego that never brakes would be hit; inf if it would not.
        """
        return {"seed": self.seed, "hazard": self.scene.hazard, "hazard_time": self.scene.hazard_time}

    def info(self) -> dict[str, Any]:
        """What info says of the newest step, for the ego: plain numbers. `SceneBatch.infos` says the same of many."""
        step_info = self._scene_state.step_info
        outcome = OUTCOME_BY_CODE[step_info.outcome.item()]
        return {
            **self.episode_info(),
            "speed": step_info.speed.item(),
            "crashed": outcome == COLLISION,
            "outcome": outcome,
            "is_success": outcome == SUCCESS,
            "min_ttc": self.min_ttc,
            "struck_from_behind": bool(step_info.struck_from_behind.item()),
            "bytes_sent": step_info.bytes_sent.item(),
            "bytes_received": step_info.bytes_received.item(),
            "largest_message": step_info.largest_message.item(),
            "messages_sent": step_info.messages_sent.item(),
            "messages_lost": step_info.messages_lost.item(),
            "messages_refused": step_info.messages_refused.item(),
            "refused": REFUSALS[step_info.refused.item()],
        }

    def inject(self, sender: int | np.integer[Any], payload: bytes) -> None:
        """Let a connected vehicle, the ego is 0, broadcast these bytes in the next step in place of its own message.

        They are counted, paid for, lost and delayed as any message. Nothing in them is checked here: what receivers
        make of them is in `info["messages_refused"]`, or in what they then hold. A vehicle that leaves the map before
        the next step sends nothing; bytes given again before it take the place of the former. ValueError for an unknown
        vehicle, and for more than any message has where graphs are sent in the project's own format.
        """
        if "fleet" not in self.__dict__:
            raise RuntimeError("there is no episode yet: call reset() before inject()")
        if not isinstance(payload, bytes):
            raise TypeError(f"payload must be bytes, got {type(payload).__name__}")
        last = len(self.agents) - 1
        if isinstance(sender, bool) or not isinstance(sender, int | np.integer) or not 0 <= sender <= last:
            raise ValueError(f"sender must be a connected vehicle, a whole number from 0 to {last}, got {sender!r}")
        outside = self.sharing or self.graph_exchange
        if outside is not None:
            outside.inject(int(sender), payload)
        else:
            self._inject(int(sender), payload)

    def _inject(self, sender: int, payload: bytes) -> None:
        longest = len(self.fleet.buffer)
        if len(payload) > longest:
            raise ValueError(f"payload must have at most {longest} bytes, as no message has more, got {len(payload)}")
        if self.fleet.injected.payload.shape[1] == 0:  # the first one: make room
            self.fleet = self.fleet._replace(injected=nothing_injected(len(self.agents), longest))
            self._scene_state = self._scene_state._replace(fleet=self.fleet)
            self._batch_state.put(self._place, self._scene_state)
        self.fleet.injected.length[sender] = len(payload)
        self.fleet.injected.payload[sender, : len(payload)] = np.frombuffer(payload, np.uint8)

    def object_lists(self) -> list[Floats]:
        """For each connected vehicle, ego first, the (n, 3) m newest positions of the objects it tracks itself."""
        graphs = [self.own_graph(agent) for agent in range(len(self.agents))]
        return [graph.position[1:, -1][graph.mask[1:, -1]] for graph in graphs]

    def arrival(self, sender: int, receiver: int) -> tuple[int, int]:
        """What becomes, in this step, of the message that a sender sent to a receiver (see radio.fate), and its bytes.

        Computed anew when asked, as `deliver` did: nothing is kept of it.
        """
        if self.sharing is not None:
            return self.sharing.arrival(sender, receiver)
        if self.graph_exchange is not None:
            return self.graph_exchange.arrival(sender, receiver)
        if receiver not in indices_on_map(self.world, self.agents):
            return NOT_SENT, 0
        air = self.fleet.air
        end = int(fate(air, self._link, self._keys[1], self.steps, sender, receiver))
        return end, int(air.length[(self.steps - self._link.delay) % len(air.step), sender])

    @property
    def clouds(self) -> list[OwnCloud] | None:
        """Of each connected vehicle, ego first, its thinned points and its pose now; None where graphs are shared."""
        return None if self.sharing is None else self.sharing.own_clouds()

    def own_graph(self, agent: int) -> Graph:
        """What connected vehicle `agent` knows by itself."""
        return as_graph(_at(self.fleet.window, agent), agent, self.time)

    def merged_graph(self, agent: int) -> Graph:
        """What receiver `agent` knows with what it was sent."""
        return as_graph(_at(self.fleet.merged, agent), agent, self.time)


def checked_hazard(hazard: Any) -> bool | None:
    """What forces the kind of an episode, or None to draw it; ValueError for anything else.

    >>> checked_hazard(np.bool_(True))
    True
    """
    if hazard is not None and not isinstance(hazard, bool | np.bool_):
        raise ValueError(f"hazard must be True, False or None, got {hazard!r}")
    return None if hazard is None else bool(hazard)


def outcome_of(struck: bool, arrived: bool, over: bool) -> str | None:
    """How it ended for a vehicle, or None while it goes on: struck or not, at its goal or not, its time up or not."""
    return OUTCOME_BY_CODE[verdict(struck, arrived, over)]


def _at(stack: Any, index: int) -> Any:
    return type(stack)(*(part[index] for part in stack))
