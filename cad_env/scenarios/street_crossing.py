"""Street crossing on green: a queue waiting to turn left beside the ego hides a vehicle that runs its red light."""

from dataclasses import dataclass

import numpy as np

from cad_env.scenarios.junction import ARM, STOP_LINE, junction_network, left_plan, through_plan
from cad_env.scenarios.ranges import Range, Ranges, check_road, count, share, span
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, OCCLUDER, Actors, Placement
from cad_env.scenarios.vehicles import Body, car_body, queue, queue_behind, stream, time_to
from cad_env.types import CAR, TRUCK
from cad_env.world.drivers import COMFORTABLE_BRAKING, MIN_GAP
from cad_env.world.state import IDM, OFF, SCRIPTED, STANDING

CROSSING_LINE = ARM - STOP_LINE  # m along every route to its stop line
_SLOW_START = 0.8  # of the wanted speed, the least the ego starts at
_BEYOND = 2.0 * STOP_LINE + 25.0  # m past its stop line, where the ego has arrived


@dataclass(frozen=True)
class StreetCrossingRanges(Ranges):
    """Every range the actors are drawn from; docs/scenarios.md says where each comes from."""

    ego_speed: Range = span(9.5, 12.0, within=(1.0, 20.0))  # m/s it wants to cross at
    ego_start: Range = span(40.0, 58.0, within=(5.0, 150.0))  # m before its stop line
    collider_speed: Range = span(14.0, 18.5, within=(1.0, 25.0))  # m/s of the vehicle on the hidden approach
    hazard_timing: Range = span(-0.3, 0.3, within=(-2.0, 2.0))  # s it is at the conflict point after an unbraked ego
    stop_timing: Range = span(-2.0, 0.3, within=(-5.0, 2.0))  # the same of one that stops, if it did not
    late_share: float = share(0.5)  # of those that stop at their red light, the share that brakes visibly late
    late_braking: Range = span(4.5, 6.5, within=(3.0, 8.0))  # m/s2 that stopping takes when such a one begins to
    truck_length: Range = span(8.0, 12.0, within=(4.0, 18.0))  # m, of all trucks in the queue
    truck_front: Range = span(7.0, 9.5, within=(5.0, 20.0))  # m from the junction's centre to the front of the first
    queue_length: tuple[int, int] = count(2, 4, within=(1, 6))  # vehicles waiting to turn left beside the ego

    def __post_init__(self) -> None:
        super().__post_init__()
        check_road(self, self.ego_start[1] + STOP_LINE, _SLOW_START, ARM)


def actors(junction: Map, ranges: StreetCrossingRanges, rng: np.random.Generator, hazard: bool) -> Actors:
    """The ego, the first of the queue, the vehicle on the hidden approach, two with a view, the rest of the queue."""
    target = rng.uniform(*ranges.ego_speed)
    start = CROSSING_LINE - rng.uniform(*ranges.ego_start)
    ego = Placement(junction.route("south_through"), start, target * rng.uniform(_SLOW_START, 1.0), target)
    first, *rest = _queue(junction, ranges, rng)
    hidden, timing = _hidden(junction, ranges, rng, hazard, ego)
    waiting = [queue(rng, junction.route(name), CROSSING_LINE, 1)[0] for name in ("east_through", "north_left")]
    return Actors((ego, first, hidden, *waiting, *rest), (OCCLUDER, 3), CROSSING_LINE + _BEYOND, timing)


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


def _hidden(
    junction: Map, ranges: StreetCrossingRanges, rng: np.random.Generator, hazard: bool, ego: Placement
) -> tuple[Placement, float | None]:
    """The vehicle on the hidden approach: runs its red light into an unbraked ego, stops at it, or is absent."""
    route, speed = junction.route("west_through"), rng.uniform(*ranges.collider_speed)
    timing, stopping = rng.uniform(*ranges.hazard_timing), rng.uniform(*ranges.stop_timing)
    late = rng.uniform(*ranges.late_braking)
    absent, brakes_late = rng.random() < 0.25, rng.random() < ranges.late_share
    ego_place, hidden_place = junction.crossing(ego.route, route)
    arrival = time_to(ego, ego_place) + (timing if hazard else stopping)
    start = max(hidden_place - speed * arrival, 1.0)
    body = car_body(rng)
    if hazard:
        return Placement(route, start, speed, speed, SCRIPTED, CAR, **body), timing
    room = 0.5 * speed * speed / COMFORTABLE_BRAKING + MIN_GAP + body["length"]  # m to the line, to stop in good time
    stops = Placement(
        route, min(start, CROSSING_LINE - room), speed, speed, OFF if absent else IDM, CAR, stop_at=CROSSING_LINE,
        late_braking=late if brakes_late else 0.0, **body,
    )  # fmt: skip
    return stops, None


def background(junction: Map, actors: Actors, rng: np.random.Generator) -> Groups:
    """Queues at the red lights; who drives before and behind the ego, and who has come the other way."""
    ego = actors.vehicles[EGO]
    across, opposite = (queue_behind(rng, waiting, 3) for waiting in actors.vehicles[3:5])
    passed, beyond = ARM + rng.uniform(80.0, 110.0), CROSSING_LINE + 2.0 * STOP_LINE + rng.uniform(30.0, 50.0)
    slow, leaving = rng.uniform(9.0, 13.0), ego.target_speed + rng.uniform(1.0, 3.0)
    return [
        across,
        opposite,
        queue(rng, junction.route("east_left"), CROSSING_LINE, 2),
        queue(rng, junction.route("west_left"), CROSSING_LINE, 2),
        stream(rng, junction.route("north_through"), passed, slow, 3, (22.0, 28.0), bystander=True),
        stream(rng, ego.route, ego.progress - rng.uniform(14.0, 25.0), ego.target_speed, 3, (16.0, 25.0)),
        stream(rng, ego.route, beyond, leaving, 2, (22.0, 28.0), bystander=True),
    ]


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
