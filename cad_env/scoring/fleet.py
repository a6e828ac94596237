"""The one closed loop for a fleet: a multi-agent environment + policies -> FleetEpisode."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cad_env.checks import check_seed
from cad_env.envs.parallel import CADParallelEnv
from cad_env.scoring.interval import Share, clustered, share_of
from cad_env.scoring.rollout import BatchPolicy
from cad_env.scoring.scorecard import KINDS
from cad_env.scoring.table import percent, text_table
from cad_env.types import BRAKE, STEP, Ints, Observation, Policy

DEADLOCK = 8.0  # s for which all agents that drive must stand
_STANDS = 0.3  # m/s


@dataclass(frozen=True)
class AgentEpisode:
    """What happened to one agent."""

    name: str
    outcome: str  # success, collision, timeout or waited
    waits: bool  # True: it could not get through, and was only to stand
    action: Ints  # (n,) int8, its decisions, one every 0.1 s until its outcome
    bytes_sent: int  # until its outcome
    bytes_received: int
    messages_lost: int  # on their way to it

    @property
    def time(self) -> float:
        """s until the outcome."""
        return len(self.action) * STEP

    @property
    def brakes(self) -> int:
        """Decisions to brake."""
        return int((self.action == BRAKE).sum())


@dataclass(frozen=True)
class FleetEpisode:
    """What happened to all agents of a scene: the unit of evaluation."""

    scenario: str
    method: str
    seed: int
    hazard: bool
    agents: tuple[AgentEpisode, ...]
    deadlock: float = math.inf  # s after the start, from when at least two have stood and waited for each other

    @property
    def collisions(self) -> int:
        """Agents that collided."""
        return sum(agent.outcome == "collision" for agent in self.agents)

    @property
    def time(self) -> float:
        """s until the last agent was done."""
        return max(agent.time for agent in self.agents)


# Called before every decision with the environment, what the agents see, and what they chose, by name.
FleetWatch = Callable[[CADParallelEnv, Mapping[str, Observation], Mapping[str, int]], None]


def rollout_fleet(
    env: CADParallelEnv,
    policies: Policy | Mapping[str, Policy],
    seed: int,
    method: str = "",
    hazard: bool | None = None,
    watch: FleetWatch | None = None,
) -> FleetEpisode:
    """Drive every agent of an episode to its end.

    policies: one for all agents, or agent name -> Policy, with one for every agent of the scene. A policy that several
    agents share must keep no memory of what it saw; it decides for all of them at once if it can (`act_batch`). Every
    policy is reset once, with the seed of the episode. Privileged ones are given `env.truth(agent)`.

    The episode is a deadlock if at least two agents that drive are left and all of them stand for DEADLOCK seconds.
    """
    seed = check_seed("seed", seed)
    observations, infos = env.reset(seed=seed, options={"hazard": hazard})
    drivers = _drivers(policies, env.agents, env.possible_agents)
    for policy in {id(policy): policy for policy in drivers.values()}.values():
        policy.reset(seed)
    records = {agent: _Record(info["waits"]) for agent, info in infos.items()}
    standing, deadlock = 0, math.inf  # decisions; s
    while env.agents:
        actions = _decisions(env, drivers, observations)
        if watch is not None:
            watch(env, observations, actions)
        observations, _, _, _, infos = env.step(actions)
        for agent, info in infos.items():
            records[agent].add(actions[agent], info)
        standing = standing + 1 if _all_stand([infos[agent] for agent in env.agents]) else 0
        if standing * STEP >= DEADLOCK:
            deadlock = min(deadlock, (env.simulation.steps - standing) * STEP)
    agents = tuple(records[agent].episode(agent, env.outcomes[agent]) for agent in records)
    simulation = env.simulation
    return FleetEpisode(simulation.scenario.name, method, seed, simulation.scene.hazard, agents, deadlock)


def _all_stand(infos: Sequence[Mapping[str, Any]]) -> bool:
    """True if at least two agents are left that drive, and all of them stand."""
    speeds = [info["speed"] for info in infos if not info["waits"]]
    return len(speeds) > 1 and max(speeds) < _STANDS


def _drivers(policies: Any, agents: list[str], possible: list[str]) -> dict[str, Policy]:
    """Who drives each agent; ValueError for names that no agent has, and for agents without a policy."""
    if not isinstance(policies, Mapping):
        return dict.fromkeys(agents, policies)
    unknown = [name for name in policies if name not in possible]
    missing = [name for name in agents if name not in policies]
    if unknown or missing:
        raise ValueError(f"policies must name {', '.join(agents)}; unknown: {unknown}, missing: {missing}")
    return {agent: policies[agent] for agent in agents}


def _decisions(
    env: CADParallelEnv, drivers: Mapping[str, Policy], observations: Mapping[str, Observation]
) -> dict[str, int]:
    """What everybody decides on what is now; agents of one policy together if it decides in batches."""
    together: dict[int, list[str]] = {}
    for agent in env.agents:
        together.setdefault(id(drivers[agent]), []).append(agent)
    actions: dict[str, int] = {}
    for agents in together.values():
        policy = drivers[agents[0]]
        if policy.privileged:
            chosen: Any = [policy.act(env.truth(agent)) for agent in agents]
        elif isinstance(policy, BatchPolicy):
            keys = observations[agents[0]]
            chosen = policy.act_batch({key: np.stack([observations[agent][key] for agent in agents]) for key in keys})
        else:
            chosen = [policy.act(observations[agent]) for agent in agents]
        actions.update(zip(agents, map(int, chosen), strict=True))
    return actions


class _Record:
    """An agent's episode under way."""

    def __init__(self, waits: bool) -> None:
        self.waits = waits
        self.action: list[int] = []
        self.sent = self.received = self.lost = 0

    def add(self, action: int, info: Mapping[str, Any]) -> None:
        self.action.append(action)
        self.sent += info["bytes_sent"]
        self.received += info["bytes_received"]
        self.lost += info["messages_lost"]

    def episode(self, name: str, outcome: str) -> AgentEpisode:
        action = np.array(self.action, np.int8)
        return AgentEpisode(name, outcome, self.waits, action, self.sent, self.received, self.lost)


@dataclass(frozen=True)
class FleetScore:
    """How a method's fleets did in a scenario: one row of the table."""

    scenario: str
    method: str
    hazard: str  # which episodes count: all, those with a hazard (yes), those without (no)
    episodes: int
    crashed_episodes: Share  # of the episodes, those in which any agent collided; Wilson's interval
    collisions: Share  # of all agents; effective sample size
    successes: Share  # of the agents that do not wait; effective sample size
    timeouts: Share  # of the agents that do not wait; effective sample size
    deadlocks: Share  # of the episodes; Wilson's interval
    waits: int  # agents that could only wait
    mean_time_success: float | None  # s, over the agents that arrived
    needless_brakes: Share | None  # of agents that do not wait, those that braked at all; only where there is no hazard
    bytes_per_second: float  # that an agent sends, mean over their time


def fleet_scores(episodes: Iterable[FleetEpisode]) -> list[FleetScore]:
    """Rows for all episodes, those with a hazard and those without, as far as there are any.

    Scenarios and methods come in the order of their first episode.
    """
    groups: dict[tuple[str, str], list[FleetEpisode]] = {}
    for episode in episodes:
        groups.setdefault((episode.scenario, episode.method), []).append(episode)
    return [
        fleet_score(kind, chosen)
        for group in groups.values()
        for kind in KINDS
        if (chosen := [episode for episode in group if kind == "all" or episode.hazard == (kind == "yes")])
    ]


def fleet_score(kind: str, episodes: Sequence[FleetEpisode]) -> FleetScore:
    """The row of at least one episode, all of one scenario and method."""
    everyone = [episode.agents for episode in episodes]
    drivers = [[agent for agent in agents if not agent.waits] for agents in everyone]
    sizes = [len(agents) for agents in drivers]
    flat = [agent for agents in everyone for agent in agents]
    crashed = sum(episode.collisions > 0 for episode in episodes)
    arrived = [agent.time for agent in flat if agent.outcome == "success"]
    braked = [sum(agent.brakes > 0 for agent in agents) for agents in drivers]

    def drivers_with(outcome: str) -> list[int]:
        return [sum(agent.outcome == outcome for agent in agents) for agents in drivers]

    return FleetScore(
        episodes[0].scenario, episodes[0].method, kind, len(episodes),
        share_of(crashed, len(episodes)),
        clustered([episode.collisions for episode in episodes], [len(agents) for agents in everyone]),
        clustered(drivers_with("success"), sizes), clustered(drivers_with("timeout"), sizes),
        share_of(sum(episode.deadlock < math.inf for episode in episodes), len(episodes)),
        len(flat) - sum(sizes), math.fsum(arrived) / len(arrived) if arrived else None,
        clustered(braked, sizes) if kind == "no" else None,
        sum(agent.bytes_sent for agent in flat) / math.fsum(agent.time for agent in flat),
    )  # fmt: skip


_TITLES = ("scenario", "method", "hazard", "episodes", "any collision % [95 %]", "agents", "collided % [95 %]",
           "drive", "arrived % [95 %]", "late %", "deadlock %", "time s", "needless brakes %", "bytes/s")  # fmt: skip


def fleet_table(rows: Sequence[FleetScore]) -> str:
    """The rows as text: rates in per cent with their interval, a dash where there is nothing to say.

    "any collision" counts episodes, "collided" agents, "arrived" and "late" the agents that drive, "deadlock"
    episodes.
    """
    return text_table(_TITLES, [_cells(row) for row in rows])


def _cells(row: FleetScore) -> tuple[str, ...]:
    return (
        row.scenario, row.method, row.hazard, str(row.episodes), _percent(row.crashed_episodes),
        str(row.collisions.of), _percent(row.collisions), str(row.successes.of), _percent(row.successes),
        f"{100 * row.timeouts.rate:.1f}", f"{100 * row.deadlocks.rate:.1f}",
        "-" if row.mean_time_success is None else f"{row.mean_time_success:.1f}",
        _percent(row.needless_brakes), f"{row.bytes_per_second:.0f}",
    )  # fmt: skip


def _percent(part: Share | None) -> str:
    return "-" if part is None else percent(part.rate, part.low, part.high)
