"""Overtaking on a two-way road: a truck that stands in the ego's lane hides the oncoming one."""

import math
from dataclasses import dataclass

import numpy as np
from highway_env.road.lane import LineType, SineLane, StraightLane
from highway_env.road.road import RoadNetwork

from cad_env.scenarios.ranges import Range, Ranges, check_road, span
from cad_env.scenarios.routes import RoutePlan
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, HIDDEN, OCCLUDER, Actors, Placement
from cad_env.scenarios.vehicles import car_body, stream, time_to
from cad_env.types import CAR, TRUCK, Command
from cad_env.world.state import OFF, SCRIPTED, STANDING

LANE = 3.5  # m wide; the ego drives east on y = -LANE / 2
WEST, EAST = -300.0, 520.0  # m, the ends of the road; the rear of the truck is at 0
SWING = 22.0  # m of road to change the lane on
LEAVE = -4.5 - SWING  # m, where the ego begins to swing out: it is in the other lane 2 m before it reaches the truck
RETURN = 18.5  # m, where it begins to swing back: 2 m past the longest truck
_SLOW_START = 0.8  # of the wanted speed, the least the ego starts at
ASKED = 35.0  # m before it swings out, from where on its command is to change the lane
# The body of a car is in the other lane from where its side crosses the middle of the road.
ACROSS = SWING * (0.5 - math.asin(0.95 / (LANE / 2)) / math.pi)  # m after a swing begins


def two_way_network() -> RoadNetwork:
    """One lane each way along x, and the swings between them."""
    network, here, there = RoadNetwork(), -LANE / 2, LANE / 2
    none, solid, dashed = LineType.NONE, LineType.CONTINUOUS_LINE, LineType.STRIPED

    def straight(start: str, end: str, x: float, to: float, y: float, lines: list[int]) -> None:
        network.add_lane(start, end, StraightLane([x, y], [to, y], LANE, lines))

    def swing(start: str, end: str, x: float, side: float) -> None:
        lane = SineLane([x, 0.0], [x + SWING, 0.0], side * LANE / 2, math.pi / SWING, -math.pi / 2, LANE, [none, none])
        network.add_lane(start, end, lane)

    # highway-env paints the side of its negative lateral axis first: in our axes that is the right.
    straight("west", "asked", WEST, LEAVE - ASKED, here, [solid, none])
    straight("asked", "leave", LEAVE - ASKED, LEAVE, here, [solid, none])
    straight("leave", "back", LEAVE, RETURN + SWING, here, [solid, none])
    straight("back", "east", RETURN + SWING, EAST, here, [solid, none])
    straight("oncoming", "gone", EAST, WEST, there, [solid, dashed])
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
class OvertakingRanges(Ranges):
    """Every range the actors are drawn from; docs/scenarios.md says where each comes from."""

    ego_speed: Range = span(8.5, 10.5, within=(3.0, 15.0))  # m/s it wants to drive at
    ego_start: Range = span(35.0, 50.0, within=(30.0, 150.0))  # m before it would swing out
    collider_speed: Range = span(13.0, 18.0, within=(1.0, 25.0))  # m/s of the oncoming vehicle
    hazard_timing: Range = span(-0.8, 0.8, within=(-2.0, 2.0))  # s it is beside the truck after an unbraked ego
    early: Range = span(7.0, 8.5, within=(0.0, 30.0))  # s before the ego, when it passes clearly before
    late: Range = span(6.0, 9.0, within=(0.0, 12.0))  # s after the ego, when it passes clearly after
    truck_length: Range = span(9.0, 14.0, within=(4.0, 14.0))  # m
    truck_width: Range = span(2.4, 2.6, within=(1.5, 2.7))  # m
    truck_offset: Range = span(0.1, 0.5, within=(-0.5, 0.5))  # m towards the middle of the road

    def __post_init__(self) -> None:
        super().__post_init__()
        check_road(self, self.ego_start[1] - LEAVE + 0.5 * self.truck_length[1], _SLOW_START, EAST)


def actors(road: Map, ranges: OvertakingRanges, rng: np.random.Generator, hazard: bool) -> Actors:
    """The ego, the truck, the oncoming vehicle, and two that see past the truck: one parked, one coming by."""
    target = rng.uniform(*ranges.ego_speed)
    start = LEAVE - WEST - rng.uniform(*ranges.ego_start)
    ego = Placement(road.route("overtake"), start, target * rng.uniform(_SLOW_START, 1.0), target)
    length, width = rng.uniform(*ranges.truck_length), rng.uniform(*ranges.truck_width)
    truck = Placement(
        road.route("east"), 0.5 * length - WEST, 0.0, 5.0, STANDING, TRUCK, length, width,
        rng.uniform(*ranges.truck_offset),
    )  # fmt: skip
    hidden, first, timing = _hidden(road, ranges, rng, hazard, ego, 0.5 * length)
    parked = Placement(
        road.route("east"), rng.uniform(50.0, 75.0) - WEST, 0.0, 5.0, STANDING, offset=-rng.uniform(2.9, 3.2),
        **car_body(rng),
    )  # fmt: skip
    pace = hidden.target_speed + rng.uniform(0.5, 2.0)
    by_now = max(EAST + rng.uniform(5.0, 20.0), first + rng.uniform(15.0, 25.0))
    passing = Placement(road.route("oncoming"), by_now, pace, pace, **car_body(rng))
    goal = float(road.routes.length[ego.route]) - (EAST - RETURN - SWING) + 25.0
    return Actors((ego, truck, hidden, parked, passing), (OCCLUDER, 3), goal, timing)


def _hidden(
    road: Map, ranges: OvertakingRanges, rng: np.random.Generator, hazard: bool, ego: Placement, beside: float
) -> tuple[Placement, float, float | None]:
    """The oncoming vehicle: meets an unbraked ego beside the truck, is long past or far away then, or is absent.

    Also the farthest it could be along its route, whatever its story, and its timing.
    """
    route, speed, story = road.route("oncoming"), rng.uniform(*ranges.collider_speed), int(rng.integers(3))
    timings = rng.uniform(*ranges.hazard_timing), -rng.uniform(*ranges.early), rng.uniform(*ranges.late)
    timing = timings[0] if hazard else timings[story]
    absent = not hazard and story == 0
    meet = time_to(ego, beside - WEST)
    start, first = (EAST - beside - speed * (meet + after) for after in (timing, timings[1]))
    end = float(road.routes.length[route]) - 1.0
    progress = min(max(start, 1.0), end)  # long gone is at the end, and leaves
    hidden = Placement(route, progress, speed, speed, OFF if absent else SCRIPTED, CAR, **car_body(rng))
    return hidden, first, None if absent else timing


def background(road: Map, actors: Actors, rng: np.random.Generator) -> Groups:
    """Who drives behind the ego and far ahead of it, who has come by already, and who is a long way off."""
    ego, hidden, passing = (actors.vehicles[row] for row in (EGO, HIDDEN, 4))
    leaving, passed = ego.target_speed + rng.uniform(1.0, 3.0), 1.05 * passing.target_speed + 1.0
    east, oncoming = road.route("east"), road.route("oncoming")
    return [
        stream(rng, east, ego.progress - rng.uniform(14.0, 25.0), ego.target_speed, 5, (14.0, 25.0)),
        stream(rng, east, -WEST + rng.uniform(130.0, 150.0), leaving, 4, (25.0, 32.0), bystander=True),
        stream(rng, oncoming, passing.progress + 190.0, passed, 4, (40.0, 45.0), bystander=True),
        stream(rng, oncoming, rng.uniform(60.0, 80.0), min(hidden.target_speed, 13.0), 3, (20.0, 28.0), bystander=True),
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
