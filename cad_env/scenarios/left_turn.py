"""Left turn on a yield light: trucks waiting in the opposing left-turn lane hide a stream in the lane beside them."""

import math
from dataclasses import dataclass

import numpy as np

from cad_env.scenarios.junction import ARM, STOP_LINE, TURN_RADIUS, junction_network, left_plan, through_plan
from cad_env.scenarios.ranges import Range, StreamRanges, count, span
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, Actors, Placement
from cad_env.scenarios.vehicles import hidden_stream, queue, queue_behind, rows_from, vehicles_in_row
from cad_env.types import TRUCK
from cad_env.world.state import STANDING

ARC = 0.5 * math.pi * TURN_RADIUS  # m of the ego's turn
LEFT_TURN_LINE = ARM - STOP_LINE  # m along every route to its stop line
_SLOW_START = 0.8  # of the wanted speed, the least the ego starts at


@dataclass(frozen=True)
class LeftTurnRanges(StreamRanges):
    """Every range the actors are drawn from; docs/scenarios.md says where each comes from."""

    ego_speed: Range = span(8.5, 10.0, within=(1.0, 20.0))  # m/s it wants to turn at
    ego_start: Range = span(26.0, 40.0, within=(5.0, 150.0))  # m before its stop line
    stream_speed: Range = span(17.0, 20.0, within=(8.0, 20.0))  # m/s of the hidden stream
    platoon: tuple[int, int] = count(1, 4, within=(1, 30))  # vehicles that come close behind each other
    headway: Range = span(0.95, 1.1, within=(0.9, 10.0))  # s from one to the next
    platoon_gap: Range = span(3.1, 4.3, within=(1.0, 60.0))  # s from a platoon to the next
    truck_length: Range = span(8.0, 14.0, within=(4.0, 18.0))  # m
    truck_width: Range = span(2.3, 2.6, within=(1.5, 2.7))  # m
    truck_front: Range = span(5.0, 6.5, within=(5.0, 20.0))  # m from the junction's centre to its front
    truck_yaw: Range = span(0.0, 0.15, within=(0.0, 0.2))  # rad, its nose already turned to its left


def actors(junction: Map, ranges: LeftTurnRanges, rng: np.random.Generator) -> Actors:
    """The ego, the truck, two that wait in the west, the first of which sees past it; a truck behind; the stream."""
    target = rng.uniform(*ranges.ego_speed)
    start = LEFT_TURN_LINE - rng.uniform(*ranges.ego_start)
    ego = Placement(junction.route("south_left"), start, target * rng.uniform(_SLOW_START, 1.0), target)
    truck = _truck(junction, ranges, rng)
    waiting = [queue(rng, junction.route(name), LEFT_TURN_LINE, 1)[0] for name in ("west_left", "west_through")]
    seen = (ego, truck, *waiting, _truck_behind(junction, ranges, rng, truck))
    route = junction.route("north_through")
    stream = hidden_stream(rng, ranges, route, junction.crossing(ego.route, route)[1])
    goal = LEFT_TURN_LINE + ARC + 25.0
    return Actors((*seen, *stream), (2,), goal, rows_from(len(seen), stream))


def _truck(junction: Map, ranges: LeftTurnRanges, rng: np.random.Generator) -> Placement:
    length, width = rng.uniform(*ranges.truck_length), rng.uniform(*ranges.truck_width)
    centre = rng.uniform(*ranges.truck_front) + 0.5 * length
    yaw = rng.uniform(*ranges.truck_yaw)
    # It turns about its rear axle: the nose swings out to the left, the tail stays in the lane.
    offset = rng.uniform(-0.15, 0.15) + 0.35 * length * math.sin(yaw)
    return Placement(
        junction.route("north_left"), ARM - centre, 0.0, 5.0, STANDING, TRUCK, length, width, offset, yaw
    )  # fmt: skip


def _truck_behind(junction: Map, ranges: LeftTurnRanges, rng: np.random.Generator, first: Placement) -> Placement:
    length, width = rng.uniform(*ranges.truck_length), rng.uniform(*ranges.truck_width)
    centre = first.rear - rng.uniform(2.0, 3.5) - 0.5 * length
    return Placement(junction.route("north_left"), centre, 0.0, 5.0, STANDING, TRUCK, length, width)


def background(junction: Map, actors: Actors, rng: np.random.Generator) -> Groups:
    """Queues at the red lights and behind the trucks; who drives beside the ego, before it and behind it."""
    ego, truck = actors.vehicles[EGO], actors.vehicles[4]
    leaving = ego.target_speed + rng.uniform(2.0, 4.0)
    return [
        *(queue_behind(rng, waiting, 2) for waiting in actors.vehicles[2:4]),
        queue(rng, junction.route("east_left"), LEFT_TURN_LINE, 2),
        queue(rng, junction.route("east_through"), LEFT_TURN_LINE, 3),
        queue_behind(rng, truck, 2),
        vehicles_in_row(
            rng, junction.route("south_through"), ego.progress + rng.uniform(-10.0, 50.0), rng.uniform(8.0, 12.0), 3
        ),
        # They wait at the line while there is a stream: nobody but the ego turns into it.
        vehicles_in_row(
            rng, ego.route, ego.progress - rng.uniform(12.0, 25.0), ego.target_speed, 2, (14.0, 25.0),
            stop_at=LEFT_TURN_LINE,
        ),
        vehicles_in_row(
            rng, ego.route, LEFT_TURN_LINE + ARC + rng.uniform(30.0, 50.0), leaving, 2, (20.0, 25.0), bystander=True
        ),
    ]  # fmt: skip


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
