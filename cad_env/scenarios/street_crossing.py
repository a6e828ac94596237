"""Street crossing on green: a queue waiting to turn left beside the ego hides a stream that runs its red light."""

from dataclasses import dataclass, replace

import numpy as np

from cad_env.scenarios.junction import ARM, STOP_LINE, junction_network, left_plan, through_plan
from cad_env.scenarios.ranges import Range, StreamRanges, count, share, span
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, OCCLUDER, Actors, Placement
from cad_env.scenarios.vehicles import (
    Body,
    car_body,
    hidden_stream,
    queue,
    queue_behind,
    rows_from,
    vehicles_in_row,
)
from cad_env.types import CAR, TRUCK
from cad_env.world.drivers import COMFORTABLE_BRAKING, MIN_GAP
from cad_env.world.state import STANDING

CROSSING_LINE = ARM - STOP_LINE  # m along every route to its stop line
_SLOW_START = 0.8  # of the wanted speed, the least the ego starts at
_BEYOND = 2.0 * STOP_LINE + 25.0  # m past its stop line, where the ego has arrived


@dataclass(frozen=True)
class StreetCrossingRanges(StreamRanges):
    """Every range the actors are drawn from; docs/scenarios.md says where each comes from."""

    ego_speed: Range = span(8.0, 10.0, within=(1.0, 20.0))  # m/s it wants to cross at
    ego_start: Range = span(40.0, 58.0, within=(5.0, 150.0))  # m before its stop line
    stream_speed: Range = span(14.0, 18.5, within=(8.0, 20.0))  # m/s of the vehicles on the hidden approach
    platoon: tuple[int, int] = count(4, 9, within=(1, 30))  # vehicles that come close behind each other
    headway: Range = span(0.95, 1.05, within=(0.9, 10.0))  # s from one to the next
    platoon_gap: Range = span(3.6, 5.0, within=(1.0, 60.0))  # s from a platoon to the next
    run_share: Range = span(0.9, 1.0, within=(0.0, 1.0))  # of them that run their red light, drawn per episode
    late_share: float = share(0.5)  # of those that stop at their red light, the share that brakes visibly late
    late_braking: Range = span(4.5, 6.5, within=(3.0, 8.0))  # m/s2 that stopping takes when such a one begins to
    truck_length: Range = span(8.0, 12.0, within=(4.0, 18.0))  # m, of all trucks in the queue
    truck_front: Range = span(7.0, 9.5, within=(5.0, 20.0))  # m from the junction's centre to the front of the first
    queue_length: tuple[int, int] = count(2, 4, within=(1, 6))  # vehicles waiting to turn left beside the ego


def actors(junction: Map, ranges: StreetCrossingRanges, rng: np.random.Generator) -> Actors:
    """The ego, the first of the queue, two with a view, the rest of the queue, the stream on the hidden approach."""
    target = rng.uniform(*ranges.ego_speed)
    start = CROSSING_LINE - rng.uniform(*ranges.ego_start)
    ego = Placement(junction.route("south_through"), start, target * rng.uniform(_SLOW_START, 1.0), target)
    first, *rest = _queue(junction, ranges, rng)
    waiting = [queue(rng, junction.route(name), CROSSING_LINE, 1)[0] for name in ("east_through", "north_left")]
    seen, route = (ego, first, *waiting, *rest), junction.route("west_through")
    stream = _until_one_stops(hidden_stream(rng, ranges, route, junction.crossing(ego.route, route)[1]), ranges, rng)
    return Actors((*seen, *stream), (OCCLUDER, 2), CROSSING_LINE + _BEYOND, rows_from(len(seen), stream))


def _until_one_stops(
    stream: list[Placement], ranges: StreetCrossingRanges, rng: np.random.Generator
) -> list[Placement]:
    """Each vehicle runs its red light until one stops at it, in good time or late, which closes the lane."""
    runs, chances = rng.uniform(*ranges.run_share), rng.random(len(stream))
    late, braking = rng.random() < ranges.late_share, rng.uniform(*ranges.late_braking)
    for k, vehicle in enumerate(stream):
        room = 0.5 * vehicle.speed**2 / COMFORTABLE_BRAKING + MIN_GAP + vehicle.length  # m, to stop in good time
        if chances[k] >= runs and vehicle.progress < CROSSING_LINE - room:
            stops = replace(vehicle, stop_at=CROSSING_LINE, late_braking=braking if late else 0.0)
            followers = [replace(each, stop_at=CROSSING_LINE) for each in stream[k + 1 :]]
            return [*stream[:k], stops, *followers]
    return stream


def _queue(junction: Map, ranges: StreetCrossingRanges, rng: np.random.Generator) -> list[Placement]:
    """Left-turners that wait for a gap inside the junction: a truck, then cars and trucks alike."""
    front, waiting = ARM - rng.uniform(*ranges.truck_front), []
    for k in range(int(rng.integers(*ranges.queue_length, endpoint=True))):
        lorry = Body(length=rng.uniform(*ranges.truck_length), width=rng.uniform(2.3, 2.6))
        kind, body = (TRUCK, lorry) if k == 0 or rng.random() < 0.5 else (CAR, car_body(rng))
        place, offset = front - 0.5 * body["length"], rng.uniform(-0.15, 0.15)
        route = junction.route("south_left")
        waiting.append(Placement(route, place, 0.0, 5.0, STANDING, kind, offset=offset, **body))
        front = waiting[-1].rear - rng.uniform(1.5, 3.0)
    return waiting


def background(junction: Map, actors: Actors, rng: np.random.Generator) -> Groups:
    """Queues at the red lights; who drives before and behind the ego, and who has come the other way."""
    ego = actors.vehicles[EGO]
    across, opposite = (queue_behind(rng, waiting, 3) for waiting in actors.vehicles[2:4])
    passed, beyond = ARM + rng.uniform(80.0, 110.0), CROSSING_LINE + 2.0 * STOP_LINE + rng.uniform(30.0, 50.0)
    slow, leaving = rng.uniform(9.0, 13.0), ego.target_speed + rng.uniform(1.0, 3.0)
    return [
        across,
        opposite,
        queue(rng, junction.route("east_left"), CROSSING_LINE, 2),
        queue(rng, junction.route("west_left"), CROSSING_LINE, 2),
        vehicles_in_row(rng, junction.route("north_through"), passed, slow, 3, (22.0, 28.0), bystander=True),
        # They wait at the line while there is a stream: nobody but the ego drives into it.
        vehicles_in_row(
            rng, ego.route, ego.progress - rng.uniform(14.0, 25.0), ego.target_speed, 3, (16.0, 25.0),
            stop_at=CROSSING_LINE,
        ),
        vehicles_in_row(rng, ego.route, beyond, leaving, 2, (22.0, 28.0), bystander=True),
    ]  # fmt: skip


STREET_CROSSING = Scenario(
    name="street_crossing",
    gym_id="CADStreetCrossing-v0",
    ranges=StreetCrossingRanges,
    network=junction_network,
    plans=(
        through_plan("south"),
        left_plan("south"),
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
