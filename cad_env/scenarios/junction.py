"""A signalised four-way junction with a left-turn and a through lane on every approach (highway-env lanes)."""

import numpy as np
from highway_env.road.lane import CircularLane, LineType, StraightLane
from highway_env.road.road import RoadNetwork

from cad_env.scenarios.routes import RoutePlan
from cad_env.types import Command, Floats

_LANE = 3.5  # m wide
STOP_LINE = 12.0  # m from the centre: two lanes, a kerb and a crosswalk
ARM = 850.0  # m from the far end of an arm to the centre: a stream of 20 m/s lasts 40 s
OUT = 250.0  # m from the centre to where the roads out end
LEFT, THROUGH = 0, 1  # lanes of an approach, from the middle of the road outwards
TURN_RADIUS = STOP_LINE + _LANE / 2

ARMS = ("south", "east", "north", "west")  # where a vehicle comes from, counter-clockwise


def junction_network() -> RoadNetwork:
    """Nodes `<arm>_far`, `<arm>_line`, `<arm>_out` and `<arm>_end` for each arm; the centre is the origin."""
    network = RoadNetwork()
    none, solid, dashed = LineType.NONE, LineType.CONTINUOUS_LINE, LineType.STRIPED
    for quarter, arm in enumerate(ARMS):
        turn = _quarter_turn(quarter)
        across, leftward = ARMS[(quarter + 2) % 4], ARMS[(quarter - 1) % 4]
        for lane in (LEFT, THROUGH):
            x = _LANE * (lane + 0.5)
            # highway-env paints the side of its negative lateral axis first: in our axes that is the right.
            lines = [dashed, solid] if lane == LEFT else [solid, none]
            network.add_lane(
                f"{arm}_far", f"{arm}_line", StraightLane(turn @ [x, -ARM], turn @ [x, -STOP_LINE], _LANE, lines)
            )
            network.add_lane(
                f"{across}_out", f"{across}_end", StraightLane(turn @ [x, STOP_LINE], turn @ [x, OUT], _LANE, lines)
            )
            network.add_lane(
                f"{arm}_line",
                f"{across}_out",
                StraightLane(turn @ [x, -STOP_LINE], turn @ [x, STOP_LINE], _LANE, [none, none]),
            )
        angle = quarter * np.pi / 2
        network.add_lane(
            f"{arm}_line",
            f"{leftward}_out",
            # highway-env's "clockwise" is on its screen, whose y axis points down; in our axes the arc turns left.
            CircularLane(
                turn @ [-STOP_LINE, -STOP_LINE], TURN_RADIUS, angle, angle + np.pi / 2,
                clockwise=True, width=_LANE, line_types=[none, none],
            ),
        )  # fmt: skip
    return network


def _quarter_turn(quarter: int) -> Floats:
    cos, sin = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter]
    return np.array([[cos, -sin], [sin, cos]])


def left_plan(arm: str) -> RoutePlan:
    """From the left-turn lane of an arm into the inner lane of the road to its left."""
    leftward = ARMS[(ARMS.index(arm) - 1) % 4]
    return _plan(f"{arm}_left", arm, leftward, LEFT, 0, Command.TURN_LEFT)


def through_plan(arm: str) -> RoutePlan:
    """From the through lane of an arm straight across."""
    across = ARMS[(ARMS.index(arm) + 2) % 4]
    return _plan(f"{arm}_through", arm, across, THROUGH, THROUGH, Command.GO_STRAIGHT)


def _plan(name: str, arm: str, exit_arm: str, lane: int, crossing: int, command: Command) -> RoutePlan:
    """In on `lane`, over the junction on its lane number `crossing`, and out on `lane` again."""
    lanes = (
        (f"{arm}_far", f"{arm}_line", lane),
        (f"{arm}_line", f"{exit_arm}_out", crossing),
        (f"{exit_arm}_out", f"{exit_arm}_end", lane),
    )
    return RoutePlan(name, lanes, (Command.FOLLOW_LANE, command, Command.FOLLOW_LANE))
