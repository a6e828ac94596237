"""A highway merge: lorries parked along the shoulder hide the right lane from whoever comes up the ramp."""

from dataclasses import dataclass, replace

import numpy as np

from cad_env.scenarios.ranges import Range, StreamRanges, count, span
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, Actors, Placement
from cad_env.scenarios.vehicles import hidden_stream, queue, rows_from, vehicles_in_row
from cad_env.types import TRUCK
from cad_env.world.state import STANDING
from cad_highway_merge.expert import MergeExpert
from cad_highway_merge.road import COMMANDS, ENTER, GOAL, LANE, PLANS, WEST, highway_network

SLOW_START = 0.8  # of the wanted speed, the least the ego starts at
BESIDE = 0.5 * LANE + 0.25  # m from the middle of the right lane to the parked lorries


@dataclass(frozen=True)
class HighwayMergeRanges(StreamRanges):
    """Every range the actors are drawn from; README.md says where each comes from."""

    ego_speed: Range = span(13.0, 16.0, within=(5.0, 20.0))  # m/s it wants to merge at
    ego_start: Range = span(60.0, 80.0, within=(30.0, 150.0))  # m before it would enter the lane
    stream_speed: Range = span(22.0, 28.0, within=(10.0, 30.0))  # m/s of the vehicles in the right lane
    platoon: tuple[int, int] = count(2, 5, within=(1, 30))  # vehicles that come close behind each other
    headway: Range = span(1.4, 2.2, within=(1.0, 10.0))  # s from one to the next
    platoon_gap: Range = span(9.0, 13.0, within=(1.0, 60.0))  # s from a platoon to the next
    truck_length: Range = span(12.0, 16.5, within=(6.0, 18.0))  # m, of every lorry of the row
    truck_width: Range = span(2.4, 2.6, within=(1.5, 2.6))  # m
    truck_front: Range = span(18.0, 21.0, within=(17.5, 40.0))  # m before the bend to the front of the first lorry
    row_length: tuple[int, int] = count(8, 10, within=(8, 12))  # lorries


def actors(road: Map, ranges: HighwayMergeRanges, rng: np.random.Generator) -> Actors:
    """The ego, the lorries from the first on, two of which, far back in the row, are the witnesses; the stream."""
    target = rng.uniform(*ranges.ego_speed)
    start = ENTER - rng.uniform(*ranges.ego_start)
    ego = Placement(road.route("ramp"), start, target * rng.uniform(SLOW_START, 1.0), target)
    seen = (ego, *_row(road, ranges, rng))
    stream = hidden_stream(rng, ranges, road.route("right"), -WEST)
    return Actors((*seen, *stream), (6, 7), GOAL, rows_from(len(seen), stream))


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


def background(road: Map, actors: Actors, rng: np.random.Generator) -> Groups:
    """Who drives in the left lane, and who waits at the ramp's meter."""
    ego, left = actors.vehicles[EGO], road.route("left")
    pace = actors.vehicles[actors.hidden[0]].speed if actors.hidden else 25.0
    meter = ego.rear - rng.uniform(8.0, 15.0)  # it lets one vehicle at a time go down the ramp
    return [
        vehicles_in_row(rng, left, rng.uniform(-150.0, -30.0) - WEST, 0.95 * pace, 8, (28.0, 38.0)),
        vehicles_in_row(rng, left, rng.uniform(170.0, 190.0) - WEST, pace, 4, (35.0, 40.0)),
        [replace(car, bystander=True) for car in queue(rng, ego.route, meter, 5)],
    ]


HIGHWAY_MERGE = Scenario(
    name="highway_merge",
    gym_id="CADHighwayMerge-v0",
    ranges=HighwayMergeRanges,
    network=highway_network,
    plans=PLANS,
    actors=actors,
    background=background,
    expert=MergeExpert,
    commands=COMMANDS,
)
