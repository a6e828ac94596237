"""A highway merge: lorries parked along the shoulder hide the right lane from whoever comes up the ramp."""

from dataclasses import dataclass, replace

import numpy as np

from cad_env.scenarios.ranges import Range, Ranges, check_road, count, span
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, HIDDEN, Actors, Placement
from cad_env.scenarios.vehicles import car_body, queue, stream, time_to
from cad_env.types import CAR, TRUCK
from cad_env.world.state import OFF, SCRIPTED, STANDING
from cad_highway_merge.expert import MergeExpert
from cad_highway_merge.road import COMMANDS, ENTER, GOAL, LANE, PLANS, RAMP, WEST, highway_network

MEET = RAMP  # m along the ramp, and x = 0 on the highway: the ego's side is in the right lane
SLOW_START = 0.8  # of the wanted speed, the least the ego starts at
BESIDE = 0.5 * LANE + 0.25  # m from the middle of the right lane to the parked lorries
FOLLOWERS = 210.0  # m of the left lane behind a collider, which the traffic there may need


@dataclass(frozen=True)
class HighwayMergeRanges(Ranges):
    """Every range the cast is drawn from; README.md says where each comes from."""

    ego_speed: Range = span(13.0, 16.0, within=(5.0, 20.0))  # m/s it wants to merge at
    ego_start: Range = span(60.0, 80.0, within=(30.0, 150.0))  # m before it would enter the lane
    collider_speed: Range = span(22.0, 28.0, within=(10.0, 32.0))  # m/s of the vehicle in the hidden lane
    hazard_timing: Range = span(0.1, 0.9, within=(-0.5, 1.5))  # s it is where they meet after an unbraked ego
    early: Range = span(2.5, 4.5, within=(0.0, 30.0))  # s before the ego, when it passes clearly before
    late: Range = span(2.8, 5.6, within=(0.0, 12.0))  # s after the ego, when it passes clearly after
    truck_length: Range = span(12.0, 16.5, within=(6.0, 18.0))  # m, of every lorry of the row
    truck_width: Range = span(2.4, 2.6, within=(1.5, 2.6))  # m
    truck_front: Range = span(18.0, 21.0, within=(17.5, 40.0))  # m before the bend to the front of the first lorry
    row_length: tuple[int, int] = count(8, 10, within=(1, 12))  # lorries

    def __post_init__(self) -> None:
        super().__post_init__()
        check_road(self, self.ego_start[1] + MEET - ENTER, SLOW_START, -WEST - FOLLOWERS)


def cast(road: Map, ranges: HighwayMergeRanges, rng: np.random.Generator, hazard: bool) -> Actors:
    """The ego, the first lorry, the vehicle in the right lane, two in the left one that see it, the other lorries."""
    target = rng.uniform(*ranges.ego_speed)
    start = ENTER - rng.uniform(*ranges.ego_start)
    ego = Placement(road.route("ramp"), start, target * rng.uniform(SLOW_START, 1.0), target)
    first, *rest = _row(road, ranges, rng)
    hidden, beside, timing = _hidden(road, ranges, rng, hazard, ego)
    near, ahead = _witnesses(road, rng, beside, hidden.target_speed)
    return Actors((ego, first, hidden, near, ahead, *rest), (3, 4), GOAL, timing)


def _row(road: Map, ranges: HighwayMergeRanges, rng: np.random.Generator) -> list[Placement]:
    """Lorries that found no place in the rest area, one behind the other on the shoulder."""
    front, row = -WEST - rng.uniform(*ranges.truck_front), []
    for _ in range(int(rng.integers(*ranges.row_length, endpoint=True))):
        length, width = rng.uniform(*ranges.truck_length), rng.uniform(*ranges.truck_width)
        side = -(BESIDE + 0.5 * width + rng.uniform(0.0, 0.1))
        row.append(
            Placement(road.route("right"), front - 0.5 * length, 0.0, 5.0, STANDING, TRUCK, length, width, side)
        )  # fmt: skip
        front = row[-1].rear - rng.uniform(1.5, 2.5)
    return row


def _hidden(
    road: Map, ranges: HighwayMergeRanges, rng: np.random.Generator, hazard: bool, ego: Placement
) -> tuple[Placement, float, float | None]:
    """The vehicle in the right lane: meets an unbraked ego, passes clearly before or after it, or is absent.

    Also where it would be in a hazard, m along its route, and its timing.
    """
    route, speed, story = road.route("right"), rng.uniform(*ranges.collider_speed), int(rng.integers(3))
    timings = rng.uniform(*ranges.hazard_timing), -rng.uniform(*ranges.early), rng.uniform(*ranges.late)
    timing = timings[0] if hazard else timings[story]
    absent = not hazard and story == 0
    meet = time_to(ego, MEET)
    start, beside = (-WEST - speed * (meet + after) for after in (timing, timings[0]))
    progress = min(max(start, 1.0), float(road.routes.length[route]) - 1.0)
    hidden = Placement(route, progress, speed, speed, OFF if absent else SCRIPTED, CAR, **car_body(rng))
    return hidden, beside, None if absent else timing


def _witnesses(road: Map, rng: np.random.Generator, beside: float, speed: float) -> tuple[Placement, Placement]:
    """Two in the left lane: one beside where a collider would be, and a slower one ahead of it."""
    left, near = road.route("left"), beside + rng.uniform(-10.0, 15.0)
    pace, slower = speed * rng.uniform(0.92, 1.0), speed * rng.uniform(0.82, 0.9)
    one = Placement(left, near, pace, pace, **car_body(rng))
    other = Placement(left, near + rng.uniform(40.0, 55.0), slower, slower, **car_body(rng))
    return one, other


def background(road: Map, cast: Actors, rng: np.random.Generator) -> Groups:
    """Who drives in the left lane behind and ahead, who has passed in the right one, who waits at the ramp's meter."""
    ego, hidden, near, ahead = (cast.vehicles[row] for row in (EGO, HIDDEN, 3, 4))
    left, pace = road.route("left"), hidden.target_speed
    meter = ego.rear - rng.uniform(8.0, 15.0)  # it lets one vehicle at a time go down the ramp
    return [
        stream(rng, left, near.progress - rng.uniform(30.0, 40.0), 0.95 * near.speed, 5, (28.0, 38.0)),
        stream(rng, left, ahead.progress + rng.uniform(150.0, 170.0), pace, 3, (35.0, 40.0)),
        stream(rng, road.route("right"), 190.0 - WEST, 1.03 * pace + rng.uniform(0.5, 2.0), 3, (28.0, 35.0), True),
        [replace(car, bystander=True) for car in queue(rng, ego.route, meter, 5)],
    ]


HIGHWAY_MERGE = Scenario(
    name="highway_merge",
    gym_id="CADHighwayMerge-v0",
    ranges=HighwayMergeRanges,
    network=highway_network,
    plans=PLANS,
    actors=cast,
    background=background,
    expert=MergeExpert,
    commands=COMMANDS,
)
