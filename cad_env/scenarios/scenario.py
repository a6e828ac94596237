"""A scenario is a map, its routes, its actors and the traffic around them, each drawn from its own random stream."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.road import RoadNetwork

from cad_env.config import check_names
from cad_env.numerics.philox import generator
from cad_env.scenarios.lanes import lanes_of
from cad_env.scenarios.priority import with_priority
from cad_env.scenarios.ranges import DENSITIES, Traffic
from cad_env.scenarios.routes import RoutePlan, crossing_of, sample_routes
from cad_env.scenarios.scene import OCCLUDER, Actors, Placement, Scene, connected_rows, place, rows_at_penetration
from cad_env.types import COMMANDS, MAX_STEPS, MOST_COMMANDS, Command, Policy
from cad_env.world.lanes import Lanes
from cad_env.world.state import Routes
from cad_env.world.unbraked import who_is_met

MOST_DRAWS = 1000  # of the actors of an episode, until they are of the kind that was asked for
_TRIED = 100  # seeds by which the number of actors is known


@dataclass(frozen=True, eq=False)  # compared and hashed as the one object it is
class Map:
    """A road network and its routes; built once and shared, never changed."""

    network: RoadNetwork
    routes: Routes
    plans: tuple[RoutePlan, ...]

    @property
    def lanes(self) -> Lanes:
        """Its routes in places, and where they conflict."""
        return _lanes(self)

    def route(self, name: str) -> int:
        """The row of the route called `name`."""
        return next(r for r, plan in enumerate(self.plans) if plan.name == name)

    def crossing(self, a: int, b: int) -> tuple[float, float]:
        """(m along route a, m along route b) to where the two cross."""
        return _crossing(self, a, b)


@cache
def _lanes(built: Map) -> Lanes:
    limits = [max(built.network.get_lane(lane).speed_limit for lane in plan.lanes) for plan in built.plans]
    return lanes_of(built.routes, np.array(limits, np.float64))


@cache
def _crossing(built: Map, a: int, b: int) -> tuple[float, float]:
    return crossing_of(built.routes, a, b)


Groups = list[list[Placement]]  # who may be there; of each group the first ones come first


@dataclass(frozen=True)
class Scenario:
    """One occlusion story. `actors` and `background` turn chance into vehicles; nothing else about it is random."""

    name: str
    gym_id: str
    ranges: type[Any]  # a Ranges record
    network: Callable[[], RoadNetwork]
    plans: tuple[RoutePlan, ...]
    actors: Callable[[Map, Any, np.random.Generator], Actors] = field(repr=False)
    background: Callable[[Map, Actors, np.random.Generator], Groups] = field(repr=False)
    # Who knows the truth and shows how to drive: privileged and without memory. None: cad_env.rules.expert.Expert.
    expert: Callable[[], Policy] | None = field(default=None, repr=False)
    commands: tuple[str, ...] = ()  # names of what routes ask beyond the six of `Command`; the numbers go on from there

    def __post_init__(self) -> None:
        _check_name(self.name)
        object.__setattr__(self, "plans", tuple(self.plans))
        object.__setattr__(self, "commands", tuple(self.commands))
        _check_commands(self)

    def __deepcopy__(self, memo: dict[int, Any]) -> "Scenario":
        """Itself: nothing in it ever changes. Gymnasium copies the arguments of its environments."""
        return self

    @property
    def command_names(self) -> tuple[str, ...]:
        """Of all that its routes may ask, by number, as the one-hot of an observation has them."""
        return (*(command.name.lower() for command in Command), *self.commands)

    @property
    def command_count(self) -> int:
        """C, how many these are."""
        return COMMANDS + len(self.commands)

    @property
    def map(self) -> Map:
        """The map of this scenario."""
        return _build_map(self)

    def configured(self, overrides: dict[str, Any]) -> Any:
        """This scenario's ranges with some replaced; ValueError names what is wrong and what is allowed."""
        check_names(f"{self.name} range", overrides, [each.name for each in fields(self.ranges)])
        return self.ranges(**overrides)

    def scene(self, ranges: Any, traffic: Traffic, seed: int, hazard: bool | None = None) -> Scene:
        """The scene of an episode seed; `hazard` draws the actors again until they are of that kind.

        Whether an episode is a hazard is not drawn: it is one if an ego that never brakes, alone with the actors,
        touches anybody. Another density or penetration leaves the actors alone: they have random streams of their own.
        """
        drawn = self._drawn(ranges, generator(seed, "traffic"), hazard)
        actors, further = drawn.actors, generator(seed, "background")
        count = int(further.integers(*DENSITIES[traffic.density], endpoint=True))
        placements = (*actors.vehicles, *_taken(self.background(self.map, actors, further), count, further))
        if traffic.penetration is None:
            connected = connected_rows(placements, actors, ranges.collaborators, generator(seed, "connection"))
        else:
            chance = generator(seed, "penetration")
            connected = rows_at_penetration(len(placements), actors, traffic.penetration, chance)
        return Scene(
            placements=placements,
            connected=connected,
            hazard=drawn.row >= 0,
            hazard_row=drawn.row,
            hazard_time=drawn.time,
            occluder_row=OCCLUDER,
            goal=actors.goal,
            hidden=actors.hidden,
            draws=drawn.draws,
        )

    def _drawn(self, ranges: Any, rng: np.random.Generator, hazard: bool | None) -> "_Drawn":
        for draw in range(1, MOST_DRAWS + 1):
            actors = self.actors(self.map, ranges, rng)
            world = place(actors.vehicles, self.map.routes)
            row, time = who_is_met(world, self.map.routes, actors.goal, MAX_STEPS)
            if hazard is None or (row >= 0) == hazard:
                return _Drawn(actors, row, time, draw)
        raise ValueError(
            f"no episode of {self.name} with hazard={hazard} in {MOST_DRAWS} draws: choose other ranges than {ranges!r}"
        )

    def most_connected(self, ranges: Any, traffic: Traffic) -> int:
        """How many vehicles are connected at the most, the ego included."""
        if traffic.penetration is None:
            return 1 + int(ranges.collaborators[1])
        drawn = (self.actors(self.map, ranges, generator(seed, "traffic")) for seed in range(_TRIED))
        return max(len(actors.vehicles) - len(actors.hidden) for actors in drawn) + DENSITIES[traffic.density][1]


class _Drawn(NamedTuple):
    """The actors of an episode, whom an ego that never brakes would meet (-1: nobody) and when, and the draws."""

    actors: Actors
    row: int
    time: float  # s
    draws: int


def _check_name(name: Any) -> None:
    """A name is part of folders, of command lines and of Python."""
    if not isinstance(name, str) or not name.isidentifier() or name == "all":
        raise ValueError(f"the name of a scenario must be an identifier like highway_merge, got {name!r}")


def _check_commands(scenario: Scenario) -> None:
    """Refuse what an observation has no place for: compiled code would write beyond it."""
    names = scenario.command_names
    if any(not isinstance(name, str) or not name.isidentifier() for name in names) or len(set(names)) < len(names):
        raise ValueError(f"commands of {scenario.name!r} must be identifiers, each once, got {scenario.commands!r}")
    if len(names) > MOST_COMMANDS:
        raise ValueError(f"{scenario.name!r} must have at most {MOST_COMMANDS} commands in all, got {len(names)}")
    for plan in scenario.plans:
        if len(plan.commands) != len(plan.lanes):
            raise ValueError(f"route {plan.name!r} must have a command for each of its lanes, got {plan.commands!r}")
        for command in plan.commands:
            if isinstance(command, bool) or not isinstance(command, int) or not 0 <= command < len(names):
                raise ValueError(
                    f"route {plan.name!r} of {scenario.name} has command {command!r}, "
                    f"but there are {len(names)} ({', '.join(names)})"
                )


@cache
def _build_map(scenario: Scenario) -> Map:
    network = scenario.network()
    return Map(network, with_priority(sample_routes(network, scenario.plans)), scenario.plans)


def _taken(groups: Groups, count: int, rng: np.random.Generator) -> list[Placement]:
    """`count` vehicles, each the next one of a group drawn among those that have any left."""
    left = [list(group) for group in groups if group]
    chosen: list[Placement] = []
    while len(chosen) < count:
        if not left:
            raise ValueError(
                f"the background of a scenario must offer more vehicles: {count} are wanted, {len(chosen)} there"
            )
        group = left[int(rng.integers(len(left)))]
        chosen.append(group.pop(0))
        left = [group for group in left if group]
    return chosen
