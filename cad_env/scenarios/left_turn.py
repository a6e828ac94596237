"""Left turn on a yield light: a truck waiting in the opposing left-turn lane hides the through lane behind it."""

import math
from dataclasses import dataclass
from functools import cache
from typing import TypedDict

import numpy as np

from cad_env.compiled import compiled
from cad_env.config import check_range
from cad_env.scenarios.junction import ARM, STOP_LINE, TURN_RADIUS, junction_network, left_plan, through_plan
from cad_env.scenarios.scene import Map, Placement, Range, Scenario, Scene, check_span
from cad_env.types import CAR, STEP, TRUCK
from cad_env.world.drivers import idm_acceleration
from cad_env.world.state import SCRIPTED, STANDING

ARC = 0.5 * math.pi * TURN_RADIUS  # m of the ego's turn
LINE = ARM - STOP_LINE  # m along every route to its stop line
SLOW_START = 0.8  # of the wanted speed, the least the ego starts at


@dataclass(frozen=True)
class LeftTurnConfig:
    """Every range the traffic is drawn from; docs/scenarios.md says where each comes from."""

    hazard_share: float = 0.5  # share of episodes with a hazard
    ego_speed: Range = (7.0, 9.0)  # m/s it wants to turn at
    ego_start: Range = (26.0, 40.0)  # m before its stop line
    collider_speed: Range = (14.0, 19.5)  # m/s of the vehicle in the hidden lane
    hazard_timing: Range = (-0.3, 0.3)  # s it reaches the conflict point after an ego that does not brake
    early: Range = (4.0, 7.0)  # s before the ego, when it passes clearly before
    late: Range = (3.0, 6.0)  # s after the ego, when it passes clearly after
    truck_length: Range = (8.0, 14.0)  # m
    truck_width: Range = (2.3, 2.6)  # m
    truck_front: Range = (7.0, 9.5)  # m from the junction's centre to its front
    truck_yaw: Range = (0.0, 0.15)  # rad, its nose already turned to its left
    others: tuple[int, int] = (4, 10)  # further vehicles, driving by IDM
    collaborators: tuple[int, int] = (2, 4)  # connected vehicles besides the ego

    def __post_init__(self) -> None:
        check_range("hazard_share", self.hazard_share, 0.0, 1.0)
        limits = {
            "ego_speed": (1.0, 20.0), "ego_start": (5.0, 150.0), "collider_speed": (1.0, 30.0),
            "hazard_timing": (-2.0, 2.0), "early": (0.0, 30.0), "late": (0.0, 12.0),
            "truck_length": (4.0, 18.0), "truck_width": (1.5, 2.7), "truck_front": (5.0, 20.0),
            "truck_yaw": (0.0, 0.2), "others": (4, 10), "collaborators": (2, 4),
        }  # fmt: skip
        for name, (low, high) in limits.items():
            check_span(name, getattr(self, name), low, high)
        for name in ("others", "collaborators"):
            if any(int(end) != end for end in getattr(self, name)):
                raise ValueError(f"{name} must be a pair of whole numbers, got {getattr(self, name)!r}")
        slowest = (self.ego_start[1] + 0.5 * ARC) / (SLOW_START * self.ego_speed[0])
        if (slowest + max(self.hazard_timing[1], self.late[0])) * self.collider_speed[1] > ARM:
            raise ValueError(
                f"ego_speed={self.ego_speed!r}, ego_start={self.ego_start!r}, collider_speed={self.collider_speed!r} "
                f"ask for a vehicle that starts more than {ARM:g} m away: let the ego start nearer or faster"
            )


@cache
def _conflict() -> tuple[float, float]:
    """(m along the ego's route, m along the hidden lane) to the point where the two cross."""
    routes, (ego, hidden) = LEFT_TURN.map.routes, (0, LEFT_TURN.map.route("north_through"))
    inside = slice(int(LINE / routes.spacing), int((LINE + ARC) / routes.spacing))
    gap = np.abs(routes.point[ego, inside, 0] - routes.point[hidden, 0, 0])
    sample = inside.start + int(np.argmin(gap))
    return sample * routes.spacing, ARM - float(routes.point[ego, sample, 1])


@compiled
def unbraked_time(speed: float, target_speed: float, distance: float) -> float:
    """Seconds an undisturbed IDM driver takes for a distance."""
    time, travelled, dt = 0.0, 0.0, STEP / 2
    while travelled < distance:
        travelled += speed * dt
        speed += idm_acceleration(speed, target_speed, math.inf, 0.0) * dt
        time += dt
    return time


def draw(junction: Map, config: LeftTurnConfig, rng: np.random.Generator, hazard: bool) -> Scene:
    """The vehicles of one episode: the ego, the truck, the hidden lane, and the rest of the traffic."""
    ego = _ego(config, rng)
    truck = _truck(junction, config, rng)
    collider_speed = rng.uniform(*config.collider_speed)
    collider = _collider(junction, config, rng, hazard, ego, collider_speed)
    fixed = [ego, truck] + ([collider] if collider is not None else [])
    count = int(rng.integers(config.others[0], config.others[1] + 1))
    others, witnesses = _others(junction, rng, count, ego, truck, collider_speed)
    first_other = len(fixed)
    # One of the connected always has a view past the truck: the truck itself or a vehicle waiting in the west.
    sharing = [1] + [first_other + k for k in range(len(others)) if others[k].progress < LINE + 30.0]
    seeing = [1] + [first_other + k for k in witnesses]
    wanted = int(rng.integers(config.collaborators[0], config.collaborators[1] + 1))
    witness = int(rng.choice(seeing))
    rest = [row for row in rng.permutation(sharing).tolist() if row != witness]
    connected = (0, *sorted([witness, *rest[: wanted - 1]]))
    hazard_row = None if collider is None else 2
    return Scene((*fixed, *others), connected, hazard, hazard_row, 1, goal=LINE + ARC + 25.0)


def _ego(config: LeftTurnConfig, rng: np.random.Generator) -> Placement:
    target = rng.uniform(*config.ego_speed)
    return Placement(0, LINE - rng.uniform(*config.ego_start), target * rng.uniform(SLOW_START, 1.0), target)


def _truck(junction: Map, config: LeftTurnConfig, rng: np.random.Generator) -> Placement:
    length, width = rng.uniform(*config.truck_length), rng.uniform(*config.truck_width)
    centre = rng.uniform(*config.truck_front) + 0.5 * length
    yaw = rng.uniform(*config.truck_yaw)
    # It turns about its rear axle: the nose swings out to the left, the tail stays in the lane.
    offset = rng.uniform(-0.15, 0.15) + 0.35 * length * math.sin(yaw)
    return Placement(
        junction.route("north_left"), ARM - centre, 0.0, 5.0, STANDING, TRUCK, length, width, offset, yaw
    )  # fmt: skip


def _collider(
    junction: Map, config: LeftTurnConfig, rng: np.random.Generator, hazard: bool, ego: Placement, speed: float
) -> Placement | None:
    """The vehicle in the hidden lane: meets an unbraked ego, passes clearly before or after it, or is absent."""
    story = rng.integers(3)
    timing = rng.uniform(*config.hazard_timing), -rng.uniform(*config.early), rng.uniform(*config.late)
    body = _body(rng)
    if not hazard and story == 0:
        return None
    ego_conflict, hidden_conflict = _conflict()
    meet = unbraked_time(ego.speed, ego.target_speed, ego_conflict - ego.progress)
    arrival = meet + (timing[0] if hazard else timing[story])
    end = float(junction.routes.length[junction.route("north_through")]) - 1.0
    progress = min(max(hidden_conflict - speed * arrival, 1.0), end)  # long gone is at the end, and leaves
    return Placement(junction.route("north_through"), progress, speed, speed, SCRIPTED, CAR, **body)


def _others(
    junction: Map, rng: np.random.Generator, count: int, ego: Placement, truck: Placement, collider_speed: float
) -> tuple[list[Placement], list[int]]:
    """`count` vehicles that obey their lights and keep their distance, and which of them see past the truck."""
    follow = Placement(0, ego.progress - rng.uniform(12.0, 25.0), ego.speed, ego.target_speed, **_body(rng))
    leaving = ego.target_speed + rng.uniform(1.0, 4.0)
    ahead = Placement(0, LINE + ARC + rng.uniform(10.0, 40.0), leaving, leaving, **_body(rng))
    gone = collider_speed + rng.uniform(0.5, 3.0)
    south = Placement(junction.route("north_through"), ARM + rng.uniform(40.0, 90.0), gone, gone, **_body(rng))
    groups = [
        _queue(rng, junction.route("west_left"), 2),
        _queue(rng, junction.route("west_through"), 2),
        _queue(rng, junction.route("east_left"), 2),
        _queue(rng, junction.route("east_through"), 2),
        _queue(rng, truck.route, 2, truck.progress - 0.5 * truck.length - rng.uniform(1.5, 3.0)),
        _platoon(rng, junction.route("south_through"), ego.progress),
        [follow],
        [ahead],
        [south],
    ]
    chosen: list[Placement] = [groups[0].pop(0)]
    while len(chosen) < count:
        group = groups[int(rng.integers(len(groups)))]
        if group:
            chosen.append(group.pop(0))
    west = (junction.route("west_left"), junction.route("west_through"))
    witnesses = [k for k, v in enumerate(chosen) if v.route in west and v.progress > LINE - 8.0]
    return chosen, witnesses


class _Body(TypedDict):
    length: float  # m
    width: float  # m


def _body(rng: np.random.Generator) -> _Body:
    """A passenger car's."""
    return {"length": rng.uniform(4.2, 5.2), "width": rng.uniform(1.8, 2.0)}


def _queue(rng: np.random.Generator, route: int, count: int, front: float | None = None) -> list[Placement]:
    """Vehicles waiting one behind the other at a red light, or behind whoever's rear is at `front`."""
    stop_at = LINE if front is None else math.inf
    bumper = LINE - rng.uniform(0.5, 2.0) if front is None else front
    queue = []
    for _ in range(count):
        body = _body(rng)
        target = rng.uniform(9.0, 13.0)
        queue.append(Placement(route, bumper - 0.5 * body["length"], 0.0, target, stop_at=stop_at, **body))
        bumper -= body["length"] + rng.uniform(2.0, 3.5)
    return queue


def _platoon(rng: np.random.Generator, route: int, around: float) -> list[Placement]:
    """Vehicles going straight on green beside the ego, spaced as IDM drivers space themselves."""
    speed = rng.uniform(8.0, 12.0)
    progress = around + rng.uniform(-10.0, 50.0)
    platoon = []
    for _ in range(3):
        platoon.append(Placement(route, progress, speed, speed * rng.uniform(1.0, 1.1), **_body(rng)))
        progress -= rng.uniform(18.0, 35.0)
    return platoon


LEFT_TURN = Scenario(
    name="left_turn",
    gym_id="CADLeftTurn-v0",
    config=LeftTurnConfig,
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
    draw=draw,
)
