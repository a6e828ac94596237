"""The map: two lanes of a highway along x, and a ramp that bends into the right one without a lane to accelerate on."""

import math
from itertools import pairwise

from highway_env.road.lane import CircularLane, LineType, StraightLane
from highway_env.road.road import RoadNetwork

from cad_env.scenarios.routes import RoutePlan
from cad_env.types import Command

COMMANDS = ("merge",)  # beyond the six of every scenario
MERGE = len(Command)  # the first number after theirs

LANE = 3.5  # m wide; the right lane is y = 0, the left one y = LANE
WEST, EAST = -1210.0, 300.0  # m, the ends of the highway: a stream of 30 m/s lasts 40 s
ANGLE = math.radians(12.0)  # between the ramp and the highway
RADIUS = 100.0  # m of the bend at its end: 2.6 m/s2 sideways at 16 m/s
RAMP = 240.0  # m of ramp before the bend, which begins at x = 0
ASKED = 60.0  # m before the bend, from where on the command is to merge
BEND = RADIUS * ANGLE  # m along the bend ...
JOIN = RADIUS * math.sin(ANGLE)  # ... which ends here, m, in the middle of the right lane
NOSE = -RADIUS * (1.0 - math.cos(ANGLE))  # m, y where it begins

# A car of 4.8 m on the ramp stays 0.5 m clear of the widest car in the right lane up to here, m along its route.
_CORNER = 2.4 * math.sin(ANGLE) + 0.95 * math.cos(ANGLE)  # m to the left of its centre
ENTER = RAMP - (1.5 + _CORNER + NOSE) / math.sin(ANGLE)
GOAL = RAMP + BEND + 25.0  # m along the ramp's route

ROUTES = ("ramp", "right", "left")  # in the order of the map's rows


def highway_network() -> RoadNetwork:
    """The highway from `west` to `east`, and the ramp from `start` to `join`, where it is one with the right lane."""
    network = RoadNetwork()
    none, solid, dashed = LineType.NONE, LineType.CONTINUOUS_LINE, LineType.STRIPED
    cos, sin = math.cos(ANGLE), math.sin(ANGLE)

    def along(start: str, end: str, x: float, to: float, y: float, lines: list[int]) -> None:
        network.add_lane(start, end, StraightLane([x, y], [to, y], LANE, lines))

    def ramp(start: str, end: str, before: float, to: float) -> None:
        ends = [[-left * cos, NOSE - left * sin] for left in (before, to)]
        network.add_lane(start, end, StraightLane(*ends, LANE, [solid, solid]))

    # highway-env paints the side of its negative lateral axis first: in our axes that is the right.
    along("west", "open", WEST, -0.5 * LANE / sin, 0.0, [solid, dashed])
    along("open", "join", -0.5 * LANE / sin, JOIN, 0.0, [none, dashed])
    along("join", "east", JOIN, EAST, 0.0, [solid, dashed])
    along("west_left", "east_left", WEST, EAST, LANE, [none, solid])
    ramp("start", "asked", RAMP, ASKED)
    ramp("asked", "bend", ASKED, 0.0)
    # Not "clockwise" on highway-env's screen, whose y axis points down, is a bend to the right in our axes.
    bend = CircularLane([JOIN, -RADIUS], RADIUS, math.pi / 2 + ANGLE, math.pi / 2, False, LANE, [solid, none])
    network.add_lane("bend", "join", bend)
    return network


def _plan(name: str, nodes: tuple[str, ...], commands: tuple[int, ...]) -> RoutePlan:
    return RoutePlan(name, tuple((start, end, 0) for start, end in pairwise(nodes)), commands)


_FOLLOW = Command.FOLLOW_LANE
PLANS = (
    _plan("ramp", ("start", "asked", "bend", "join", "east"), (_FOLLOW, MERGE, MERGE, _FOLLOW)),
    _plan("right", ("west", "open", "join", "east"), (_FOLLOW,) * 3),
    _plan("left", ("west_left", "east_left"), (_FOLLOW,)),
)
