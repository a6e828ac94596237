"""Left turn on a yield light: a truck waiting in the opposing left-turn lane hides the through lane behind it."""

import math
from dataclasses import dataclass

import numpy as np

from cad_env.scenarios.junction import ARM, STOP_LINE, TURN_RADIUS, junction_network, left_plan, through_plan
from cad_env.scenarios.ranges import Range, Ranges, check_road, span
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, HIDDEN, OCCLUDER, Actors, Placement
from cad_env.scenarios.vehicles import car_body, queue, queue_behind, stream, time_to
from cad_env.types import CAR, TRUCK
from cad_env.world.state import OFF, SCRIPTED, STANDING

ARC = 0.5 * math.pi * TURN_RADIUS  # m of the ego's turn
LEFT_TURN_LINE = ARM - STOP_LINE  # m along every route to its stop line
_SLOW_START = 0.8  # of the wanted speed, the least the ego starts at


@dataclass(frozen=True)
class LeftTurnRanges(Ranges):
    """Every range the actors are drawn from; docs/scenarios.md says where each comes from."""

    ego_speed: Range = span(7.0, 9.0, within=(1.0, 20.0))  # m/s it wants to turn at
    ego_start: Range = span(26.0, 40.0, within=(5.0, 150.0))  # m before its stop line
    collider_speed: Range = span(14.0, 19.5, within=(1.0, 30.0))  # m/s of the vehicle in the hidden lane
    hazard_timing: Range = span(-0.3, 0.3, within=(-2.0, 2.0))  # s it is at the conflict point after an unbraked ego
    early: Range = span(4.0, 7.0, within=(0.0, 30.0))  # s before the ego, when it passes clearly before
    late: Range = span(3.0, 6.0, within=(0.0, 12.0))  # s after the ego, when it passes clearly after
    truck_length: Range = span(8.0, 14.0, within=(4.0, 18.0))  # m
    truck_width: Range = span(2.3, 2.6, within=(1.5, 2.7))  # m
    truck_front: Range = span(7.0, 9.5, within=(5.0, 20.0))  # m from the junction's centre to its front
    truck_yaw: Range = span(0.0, 0.15, within=(0.0, 0.2))  # rad, its nose already turned to its left

    def __post_init__(self) -> None:
        super().__post_init__()
        check_road(self, self.ego_start[1] + 0.5 * ARC, _SLOW_START, ARM)


def actors(junction: Map, ranges: LeftTurnRanges, rng: np.random.Generator, hazard: bool) -> Actors:
    """The ego, the truck, the vehicle in the hidden lane, and two that wait in the west and see past the truck."""
    target = rng.uniform(*ranges.ego_speed)
    start = LEFT_TURN_LINE - rng.uniform(*ranges.ego_start)
    ego = Placement(junction.route("south_left"), start, target * rng.uniform(_SLOW_START, 1.0), target)
    truck = _truck(junction, ranges, rng)
    hidden, timing = _hidden(junction, ranges, rng, hazard, ego)
    waiting = [queue(rng, junction.route(name), LEFT_TURN_LINE, 1)[0] for name in ("west_left", "west_through")]
    return Actors((ego, truck, hidden, *waiting), (OCCLUDER, 3, 4), LEFT_TURN_LINE + ARC + 25.0, timing)


def _truck(junction: Map, ranges: LeftTurnRanges, rng: np.random.Generator) -> Placement:
    length, width = rng.uniform(*ranges.truck_length), rng.uniform(*ranges.truck_width)
    centre = rng.uniform(*ranges.truck_front) + 0.5 * length
    yaw = rng.uniform(*ranges.truck_yaw)
    # It turns about its rear axle: the nose swings out to the left, the tail stays in the lane.
    offset = rng.uniform(-0.15, 0.15) + 0.35 * length * math.sin(yaw)
    return Placement(
        junction.route("north_left"), ARM - centre, 0.0, 5.0, STANDING, TRUCK, length, width, offset, yaw
    )  # fmt: skip


def _hidden(
    junction: Map, ranges: LeftTurnRanges, rng: np.random.Generator, hazard: bool, ego: Placement
) -> tuple[Placement, float | None]:
    """The vehicle in the hidden lane: meets an unbraked ego, passes clearly before or after it, or is absent."""
    route, speed, story = junction.route("north_through"), rng.uniform(*ranges.collider_speed), int(rng.integers(3))
    timings = rng.uniform(*ranges.hazard_timing), -rng.uniform(*ranges.early), rng.uniform(*ranges.late)
    timing = timings[0] if hazard else timings[story]
    absent = not hazard and story == 0
    ego_place, hidden_place = junction.crossing(ego.route, route)
    start = hidden_place - speed * (time_to(ego, ego_place) + timing)
    end = float(junction.routes.length[route]) - 1.0
    progress = min(max(start, 1.0), end)  # long gone is at the end, and leaves
    driver = OFF if absent else SCRIPTED
    return Placement(route, progress, speed, speed, driver, CAR, **car_body(rng)), None if absent else timing


def background(junction: Map, actors: Actors, rng: np.random.Generator) -> Groups:
    """Queues at the red lights and behind the truck; a platoon beside the ego, and who drives before and behind it."""
    ego, truck, hidden = actors.vehicles[EGO], actors.vehicles[OCCLUDER], actors.vehicles[HIDDEN]
    leaving = ego.target_speed + rng.uniform(2.0, 4.0)
    gone = hidden.target_speed + rng.uniform(0.5, 3.0)
    return [
        *(queue_behind(rng, waiting, 2) for waiting in actors.vehicles[3:]),
        queue(rng, junction.route("east_left"), LEFT_TURN_LINE, 2),
        queue(rng, junction.route("east_through"), LEFT_TURN_LINE, 3),
        queue_behind(rng, truck, 2),
        stream(
            rng, junction.route("south_through"), ego.progress + rng.uniform(-10.0, 50.0), rng.uniform(8.0, 12.0), 3
        ),
        stream(rng, ego.route, ego.progress - rng.uniform(12.0, 25.0), ego.target_speed, 2, (14.0, 25.0)),
        stream(
            rng, ego.route, LEFT_TURN_LINE + ARC + rng.uniform(30.0, 50.0), leaving, 2, (20.0, 25.0), bystander=True
        ),
        stream(rng, junction.route("north_through"), ARM + rng.uniform(60.0, 90.0), gone, 2, (18.0, 20.0), True),
    ]


LEFT_TURN = Scenario(
    name="left_turn",
    gym_id="CADLeftTurn-v0",
    ranges=LeftTurnRanges,
    network=junction_network,
    plans=(
        left_plan("south"),
        through_plan("south"),
        through_plan("north"),
        left_plan("north"),
        left_plan("west"),
        through_plan("west"),
        left_plan("east"),
        through_plan("east"),
    ),
    actors=actors,
    background=background,
)
