"""A junction without lights whose corners are blocked by parked lorries: several connected vehicles arrive at once."""

from dataclasses import dataclass

import numpy as np
from highway_env.road.lane import CircularLane, LineType, StraightLane
from highway_env.road.road import RoadNetwork

from cad_env.scenarios.junction import ARMS
from cad_env.scenarios.ranges import Range, StreamRanges, count, share, span
from cad_env.scenarios.routes import RoutePlan
from cad_env.scenarios.scenario import Groups, Map, Scenario
from cad_env.scenarios.scene import EGO, Actors, Placement
from cad_env.scenarios.vehicles import car_body, hidden_stream, rows_from, vehicles_in_row
from cad_env.types import TRUCK, Command
from cad_env.world.state import IDM, STANDING, YIELDING

_LANE = 3.5  # m wide, one each way
STOP = 9.0  # m from the centre to the line where whoever gives way waits
FAR = 560.0  # m from the far end of an arm to the centre: a stream of 13 m/s lasts 40 s
END = 120.0  # m from the centre to where the roads out end
LINE = FAR - STOP  # m along every route to its line
_HALF = 0.5 * _LANE
LEFT_RADIUS, RIGHT_RADIUS = STOP + _HALF, STOP - _HALF  # m
_COMMAND = {"left": Command.TURN_LEFT, "through": Command.GO_STRAIGHT, "right": Command.TURN_RIGHT}
_EXIT = {"left": -1, "through": 2, "right": 1}  # where a turn leads, counted in ARMS from where it comes from
_PACE = {"left": 0.7, "through": 1.0, "right": 0.55}  # of the speed that it wants: at most 6.6 m/s2 sideways


def small_junction_network() -> RoadNetwork:
    """Nodes `<arm>_far`, `<arm>_line`, `<arm>_out` and `<arm>_end` for each arm; the centre is the origin."""
    network = RoadNetwork()
    for quarter, arm in enumerate(ARMS):
        _add_arm(network, quarter, arm)
    return network


def _add_arm(network: RoadNetwork, quarter: int, arm: str) -> None:
    """The road in from an arm, the road out opposite, and the three ways over the junction."""
    none, solid, dashed = LineType.NONE, LineType.CONTINUOUS_LINE, LineType.STRIPED
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
    turn, angle = np.array([[cos, -sin], [sin, cos]]), 0.5 * np.pi * quarter
    across, left, right = (exit_of(arm, way) for way in ("through", "left", "right"))

    def straight(start: str, end: str, y: float, to: float, lines: list[int]) -> None:
        network.add_lane(start, end, StraightLane(turn @ [_HALF, y], turn @ [_HALF, to], _LANE, lines))

    # highway-env paints the side of its negative lateral axis first: in our axes that is the right.
    straight(f"{arm}_far", f"{arm}_line", -FAR, -STOP, [solid, dashed])
    straight(f"{arm}_line", f"{across}_out", -STOP, STOP, [none, none])
    straight(f"{across}_out", f"{across}_end", STOP, END, [solid, none])
    for corner, radius, start, sense, to in (
        (-STOP, LEFT_RADIUS, 0.0, 1.0, left),
        (STOP, RIGHT_RADIUS, np.pi, -1.0, right),
    ):
        lane = CircularLane(
            turn @ [corner, -STOP], radius, angle + start, angle + start + sense * 0.5 * np.pi,
            clockwise=sense > 0.0, width=_LANE, line_types=[none, none],
        )  # fmt: skip
        network.add_lane(f"{arm}_line", f"{to}_out", lane)


def exit_of(arm: str, way: str) -> str:
    """The arm by which a vehicle from `arm` leaves that goes left, through or right."""
    return ARMS[(ARMS.index(arm) + _EXIT[way]) % 4]


def _plan(arm: str, way: str) -> RoutePlan:
    out = exit_of(arm, way)
    lanes = ((f"{arm}_far", f"{arm}_line", 0), (f"{arm}_line", f"{out}_out", 0), (f"{out}_out", f"{out}_end", 0))
    commands = (Command.FOLLOW_LANE, _COMMAND[way], Command.FOLLOW_LANE)
    return RoutePlan(f"{arm}_{way}", lanes, commands, line=LINE)


@dataclass(frozen=True)
class UnsignalisedRanges(StreamRanges):
    """Every range the actors are drawn from; docs/scenarios.md says where each comes from."""

    ego_speed: Range = span(10.0, 12.0, within=(3.0, 15.0))  # m/s that the ego and its peers want to drive at
    ego_start: Range = span(48.0, 62.0, within=(15.0, 150.0))  # m before its line
    apart: Range = span(-1.5, 0.5, within=(-10.0, 10.0))  # s after the ego that a peer would be at its line
    empty_share: float = share(0.2)  # of episodes in which a fourth one comes in place of the stream
    stream_speed: Range = span(10.0, 13.0, within=(6.0, 13.0))  # m/s
    platoon: tuple[int, int] = count(1, 3, within=(1, 30))  # vehicles that come close behind each other
    headway: Range = span(1.2, 1.6, within=(1.1, 10.0))  # s from one to the next
    platoon_gap: Range = span(8.0, 11.5, within=(1.0, 60.0))  # s from a platoon to the next
    van_length: Range = span(9.0, 13.0, within=(4.0, 18.0))  # m, of vans and lorries alike
    van_front: Range = span(10.0, 11.5, within=(9.5, 20.0))  # m from the centre to the nearer end of a van


def actors(junction: Map, ranges: UnsignalisedRanges, rng: np.random.Generator) -> Actors:
    """The ego, a van at its right, three peers, the other vans, the stream from the left or the right of the ego.

    Without a stream the third peer comes from that side; with one it drives behind one of the others.
    """
    side = "west" if rng.random() < 0.5 else "east"
    other = "east" if side == "west" else "west"
    route = junction.route(f"{side}_through")
    stream = hidden_stream(rng, ranges, route, FAR)
    closed = exit_of(side, "through") if stream else ""
    ego = _arriving(junction, ranges, rng, "south", closed, None)
    peers = [_arriving(junction, ranges, rng, arm, closed, ego) for arm in (other, "north")]
    if stream:
        peers.append(_following(junction, ranges, rng, (other, "north"), closed, peers))
    else:
        peers.append(_arriving(junction, ranges, rng, side, closed, ego))
    vans = [_van(junction, ranges, rng, arm, beyond) for arm in ARMS for beyond in (False, True)]
    seen = (ego, vans[0], *peers, *vans[1:])
    rows = rows_from(2, peers)
    return Actors((*seen, *stream), rows[:1], _goal(junction, ego), rows_from(len(seen), stream), rows)


def _goal(junction: Map, ego: Placement) -> float:
    """25 m past the junction."""
    return float(junction.routes.length[ego.route]) - (END - STOP) + 25.0


def _way(rng: np.random.Generator, arm: str, closed: str) -> str:
    """Left, through or right, but never onto the road by which the stream leaves."""
    return str(rng.choice([way for way in _EXIT if exit_of(arm, way) != closed]))


def _arriving(
    junction: Map, ranges: UnsignalisedRanges, rng: np.random.Generator, arm: str, closed: str, ego: Placement | None
) -> Placement:
    """A vehicle on its way to the junction, there at about the same time as the ego unless it is the ego."""
    way, wanted = _way(rng, arm, closed), rng.uniform(*ranges.ego_speed)
    speed = _PACE[way] * wanted
    away = rng.uniform(*ranges.ego_start)
    if ego is not None:
        away = speed * max((LINE - ego.progress) / ego.speed + rng.uniform(*ranges.apart), 1.5)
    driver = IDM if ego is None else YIELDING
    return Placement(junction.route(f"{arm}_{way}"), LINE - away, speed, speed, driver, **car_body(rng))


def _following(
    junction: Map, ranges: UnsignalisedRanges, rng: np.random.Generator, arms: tuple[str, str], closed: str,
    leaders: list[Placement],
) -> Placement:  # fmt: skip
    """A vehicle behind one of two others."""
    number = int(rng.integers(2))
    way, leader = _way(rng, arms[number], closed), leaders[number]
    speed = _PACE[way] * rng.uniform(*ranges.ego_speed)
    place = leader.progress - rng.uniform(14.0, 22.0)
    route = junction.route(f"{arms[number]}_{way}")
    return Placement(route, place, min(speed, leader.speed), speed, YIELDING, **car_body(rng))


def _van(junction: Map, ranges: UnsignalisedRanges, rng: np.random.Generator, arm: str, beyond: bool) -> Placement:
    """A van parked at the kerb of an arm, on the right of whoever comes in by it or, `beyond`, on the left."""
    length, width = rng.uniform(*ranges.van_length), rng.uniform(2.2, 2.5)
    away, offset = rng.uniform(*ranges.van_front) + 0.5 * length, -(_HALF + rng.uniform(0.15, 0.35) + 0.5 * width)
    route = junction.route(f"{exit_of(arm, 'through') if beyond else arm}_through")
    return Placement(
        route, FAR + away if beyond else FAR - away, 0.0, 5.0, STANDING, TRUCK, length, width, offset
    )  # fmt: skip


def background(junction: Map, actors: Actors, rng: np.random.Generator) -> Groups:
    """Who comes behind the ego and its peers, and who has left the junction already."""
    arriving = [actors.vehicles[row] for row in (EGO, *actors.peers)]
    arms = {junction.plans[vehicle.route].name.partition("_")[0]: vehicle for vehicle in arriving}
    stream = [junction.plans[actors.vehicles[row].route].lanes[-1][0] for row in actors.hidden[:1]]
    closed = stream[0].partition("_")[0] if stream else ""
    groups = [_behind(junction, rng, arm, last, closed) for arm, last in arms.items()]
    for arm in (arm for arm in ARMS if exit_of(arm, "through") != closed):
        route, pace = junction.route(f"{arm}_through"), rng.uniform(9.0, 12.0)
        groups.append(vehicles_in_row(rng, route, FAR + rng.uniform(65.0, 80.0), pace, 3, (20.0, 25.0), bystander=True))
    return groups


def _behind(junction: Map, rng: np.random.Generator, arm: str, last: Placement, closed: str) -> list[Placement]:
    """Three who give way too, behind the last one on an arm."""
    place, cars = last.progress, []
    for _ in range(3):
        way = _way(rng, arm, closed)
        place -= rng.uniform(25.0, 35.0)
        speed = _PACE[way] * last.target_speed
        route = junction.route(f"{arm}_{way}")
        cars.append(Placement(route, place, min(speed, last.speed), speed, YIELDING, **car_body(rng)))
    return cars


UNSIGNALISED = Scenario(
    name="unsignalised",
    gym_id="CADUnsignalised-v0",
    ranges=UnsignalisedRanges,
    network=small_junction_network,
    plans=tuple(_plan(arm, way) for arm in ARMS for way in _EXIT),
    actors=actors,
    background=background,
)
