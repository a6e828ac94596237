"""Overtaking on a two-way road: a truck that stands in the ego's lane hides the oncoming stream."""

import math
from dataclasses import dataclass

import numpy as np
from highway_env.road.lane import LineType, SineLane, StraightLane
from highway_env.road.road import RoadNetwork

from cad_env.scenarios.ranges import Range, StreamRanges, count, span
from cad_env.scenarios.routes import RoutePlan
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, Actors, Placement
from cad_env.scenarios.vehicles import car_body, hidden_stream, rows_from, vehicles_in_row
from cad_env.types import TRUCK, Command
from cad_env.world.state import STANDING

LANE = 3.5  # m wide; the ego drives east on y = -LANE / 2
WEST, EAST = -300.0, 660.0  # m, the ends of the road; the rear of the truck is at 0
SWING = 22.0  # m of road to change the lane on
LEAVE = -4.5 - SWING  # m, where the ego begins to swing out: it is in the other lane 2 m before it reaches the truck
RETURN = 18.5  # m, where it begins to swing back: 2 m past the longest truck
_SLOW_START = 0.8  # of the wanted speed, the least the ego starts at
ONCOMING_LIMIT = 15.0  # m/s, the most that `stream_speed` allows
ASKED = 35.0  # m before it swings out, from where on its command is to change the lane
# The body of a car is in the other lane from where its side crosses the middle of the road.
ACROSS = SWING * (0.5 - math.asin(0.95 / (LANE / 2)) / math.pi)  # m after a swing begins


def two_way_network() -> RoadNetwork:
    """One lane each way along x, and the swings between them."""
    network, here, there = RoadNetwork(), -LANE / 2, LANE / 2
    none, solid, dashed = LineType.NONE, LineType.CONTINUOUS_LINE, LineType.STRIPED

    def straight(start: str, end: str, x: float, to: float, y: float, lines: list[int], limit: float = 20.0) -> None:
        network.add_lane(start, end, StraightLane([x, y], [to, y], LANE, lines, speed_limit=limit))

    def swing(start: str, end: str, x: float, side: float) -> None:
        lane = SineLane([x, 0.0], [x + SWING, 0.0], side * LANE / 2, math.pi / SWING, -math.pi / 2, LANE, [none, none])
        network.add_lane(start, end, lane)

    # highway-env paints the side of its negative lateral axis first: in our axes that is the right.
    straight("west", "asked", WEST, LEAVE - ASKED, here, [solid, none])
    straight("asked", "leave", LEAVE - ASKED, LEAVE, here, [solid, none])
    straight("leave", "back", LEAVE, RETURN + SWING, here, [solid, none])
    straight("back", "east", RETURN + SWING, EAST, here, [solid, none])
    straight("oncoming", "gone", EAST, WEST, there, [solid, dashed], ONCOMING_LIMIT)
    swing("leave", "beside", LEAVE, 1.0)
    straight("beside", "return", LEAVE + SWING, RETURN, there, [none, none])
    swing("return", "back", RETURN, -1.0)
    return network


_LANE_OF = {
    "overtake": (("west", "asked"), ("asked", "leave"), ("leave", "beside"), ("beside", "return"), ("return", "back"),
                 ("back", "east")),
    "east": (("west", "asked"), ("asked", "leave"), ("leave", "back"), ("back", "east")),
    "oncoming": (("oncoming", "gone"),),
}  # fmt: skip
_FOLLOW, _OUT, _IN = Command.FOLLOW_LANE, Command.CHANGE_LEFT, Command.CHANGE_RIGHT


def _plan(name: str, commands: tuple[Command, ...], oncoming: tuple[float, float] | None = None) -> RoutePlan:
    return RoutePlan(name, tuple((start, end, 0) for start, end in _LANE_OF[name]), commands, oncoming)


@dataclass(frozen=True)
class OvertakingRanges(StreamRanges):
    """Every range the actors are drawn from; docs/scenarios.md says where each comes from."""

    ego_speed: Range = span(8.5, 10.5, within=(3.0, 15.0))  # m/s it wants to drive at
    ego_start: Range = span(35.0, 50.0, within=(30.0, 150.0))  # m before it would swing out
    stream_speed: Range = span(10.0, 13.5, within=(8.0, ONCOMING_LIMIT))  # m/s of the oncoming stream
    platoon: tuple[int, int] = count(2, 4, within=(1, 30))  # vehicles that come close behind each other
    headway: Range = span(1.4, 2.0, within=(1.0, 10.0))  # s from one to the next
    platoon_gap: Range = span(17.25, 20.5, within=(1.0, 60.0))  # s from a platoon to the next
    truck_length: Range = span(9.0, 14.0, within=(4.0, 14.0))  # m
    truck_width: Range = span(2.4, 2.6, within=(1.5, 2.7))  # m
    truck_offset: Range = span(0.1, 0.5, within=(-0.5, 0.5))  # m towards the middle of the road


def actors(road: Map, ranges: OvertakingRanges, rng: np.random.Generator) -> Actors:
    """The ego, the truck, two cars parked beyond it that see past it, the farther one a long way, the hidden stream."""
    target = rng.uniform(*ranges.ego_speed)
    start = LEAVE - WEST - rng.uniform(*ranges.ego_start)
    ego = Placement(road.route("overtake"), start, target * rng.uniform(_SLOW_START, 1.0), target)
    length, width = rng.uniform(*ranges.truck_length), rng.uniform(*ranges.truck_width)
    truck = Placement(
        road.route("east"), 0.5 * length - WEST, 0.0, 5.0, STANDING, TRUCK, length, width,
        rng.uniform(*ranges.truck_offset),
    )  # fmt: skip
    near, far = (_parked(road, rng, rng.uniform(*where)) for where in ((45.0, 60.0), (88.0, 98.0)))
    seen, route = (ego, truck, near, far), road.route("oncoming")
    stream = hidden_stream(rng, ranges, route, EAST - 0.5 * length)
    goal = float(road.routes.length[ego.route]) - (EAST - RETURN - SWING) + 25.0
    return Actors((*seen, *stream), (3,), goal, rows_from(len(seen), stream))


def _parked(road: Map, rng: np.random.Generator, x: float) -> Placement:
    """A car at the right roadside, x m past the rear of the truck."""
    offset = -rng.uniform(2.9, 3.2)
    return Placement(road.route("east"), x - WEST, 0.0, 5.0, STANDING, offset=offset, **car_body(rng))


def background(road: Map, actors: Actors, rng: np.random.Generator) -> Groups:
    """Who drives behind the ego and far ahead of it."""
    ego, east = actors.vehicles[EGO], road.route("east")
    leaving = ego.target_speed + rng.uniform(1.0, 3.0)
    return [
        vehicles_in_row(rng, east, ego.progress - rng.uniform(14.0, 25.0), ego.target_speed, 8, (14.0, 25.0)),
        vehicles_in_row(rng, east, -WEST + rng.uniform(360.0, 380.0), leaving, 8, (25.0, 32.0), bystander=True),
    ]


OVERTAKING = Scenario(
    name="overtaking",
    gym_id="CADOvertaking-v0",
    ranges=OvertakingRanges,
    network=two_way_network,
    plans=(
        _plan(
            "overtake",
            (_FOLLOW, _OUT, _OUT, _FOLLOW, _IN, _FOLLOW),
            (LEAVE + ACROSS - WEST, RETURN + SWING - ACROSS - WEST),
        ),
        _plan("east", (_FOLLOW,) * 4),
        _plan("oncoming", (_FOLLOW,)),
    ),
    actors=actors,
    background=background,
)
