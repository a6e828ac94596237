"""The street crossing's own story: a queue beside the ego, and red lights that are run until somebody stops."""

import numpy as np
import pytest
from scenes import started, steps

from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import EGO, OCCLUDER, Scene
from cad_env.scenarios.street_crossing import CROSSING_LINE, STREET_CROSSING, StreetCrossingRanges
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, CAR, GO, MAX_STEPS, TRUCK
from cad_env.world.state import STANDING, STREAM, crashed

RANGES = StreetCrossingRanges()
MAP = STREET_CROSSING.map


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [STREET_CROSSING.scene(RANGES, Traffic(), seed) for seed in range(200)]


def queued(scene: Scene) -> list[int]:
    beside = MAP.route("south_left")
    return [row for row, vehicle in enumerate(scene.placements) if vehicle.route == beside]


def first_that_stops(scene: Scene) -> int | None:
    """Which of the hidden stream, the first one counted 0, is the first that stops at its red light."""
    stops = [k for k, row in enumerate(scene.hidden) if scene.placements[row].stop_at < np.inf]
    return stops[0] if stops else None


def test_a_queue_of_cars_and_trucks_waits_beside_the_way_of_the_ego(scenes):
    lengths, kinds = set(), set()
    for scene in scenes:
        rows = queued(scene)
        lengths.add(len(rows))
        kinds |= {scene.placements[row].kind for row in rows[1:]}
        assert rows[0] == OCCLUDER
        assert {scene.placements[row].driver for row in rows} == {STANDING}
        assert scene.placements[EGO].route == MAP.route("south_through")
    assert lengths == {2, 3, 4}
    assert kinds == {CAR, TRUCK}


def test_the_first_that_stops_closes_the_lane_to_all_behind_it(scenes):
    stories = set()
    for scene in scenes:
        stream = [scene.placements[row] for row in scene.hidden]
        assert {(vehicle.route, vehicle.driver) for vehicle in stream} <= {(MAP.route("west_through"), STREAM)}
        first = first_that_stops(scene)
        if first is None:
            stories.add("all run" if stream else "nobody comes")
            continue
        assert {vehicle.stop_at for vehicle in stream[:first]} <= {np.inf}
        assert {vehicle.stop_at for vehicle in stream[first:]} == {CROSSING_LINE}
        assert {vehicle.late_braking for vehicle in stream[first + 1 :]} <= {0.0}  # they stop behind it
        late = stream[first].late_braking
        assert late == 0.0 or RANGES.late_braking[0] <= late <= RANGES.late_braking[1]
        stories.add("late" if late else "in time")
    assert stories == {"all run", "nobody comes", "late", "in time"}


def test_shares_of_one_are_always_and_of_none_never():
    def stopping(**ranges) -> list[int | None]:
        configured = STREET_CROSSING.configured({"empty_share": 0.0, **ranges})
        return [first_that_stops(STREET_CROSSING.scene(configured, Traffic("none"), seed)) for seed in range(20)]

    assert stopping(run_share=(1.0, 1.0)) == [None] * 20
    # With 0 the first that still can stop does: who is too near to its line is through.
    assert all(first is not None and first < 12 for first in stopping(run_share=(0.0, 0.0)))


def after_an_episode(seed: int, **ranges) -> Simulation:
    """A simulation whose ego has stood from the start to the end of its time."""
    simulation = started(seed, scenario="street_crossing", traffic="none", ranges={"empty_share": 0.0, **ranges})
    for _ in steps(simulation, action=lambda agent: GO if agent else BRAKE):
        pass
    assert simulation.steps == MAX_STEPS
    return simulation


def test_all_before_the_first_that_stops_run_and_nobody_passes_after_it():
    both = 0
    for seed in range(30):
        simulation = after_an_episode(seed)
        scene, world = simulation.scene, simulation.world
        first = first_that_stops(scene)
        rows = np.array(scene.hidden)
        ran, stopped = rows[:first], rows[first:] if first is not None else rows[:0]
        reach = np.array([scene.placements[row].speed for row in ran]) * 40.0
        progress = np.array([scene.placements[row].progress for row in ran])
        assert (world.progress[ran] > np.minimum(CROSSING_LINE, progress + reach - 1.0)).all()  # at their full speed
        assert (world.progress[stopped] + 0.5 * world.size[stopped, 0] < CROSSING_LINE + 0.1).all()
        assert (np.diff(world.progress[stopped]) < -5.0).all()  # one behind the other
        assert not crashed(world).any()
        both += len(ran) > 0 and len(stopped) > 0
    assert both > 10


def test_whoever_stops_does_so_before_its_line_the_late_one_harder():
    hardest: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(40):
        simulation = started(seed, scenario="street_crossing", traffic="none", ranges={"run_share": (0.6, 0.8)})
        first = first_that_stops(simulation.scene)
        if first is None:
            continue
        row = simulation.scene.hidden[first]
        stops, world, braking = simulation.scene.placements[row], simulation.world, 0.0
        for _ in steps(simulation, action=lambda agent: GO if agent else BRAKE):
            if world.speed[row] > 3.0:
                braking = max(braking, -world.acceleration[row])
        if world.speed[row] > 0.3:
            continue  # it is still on its way
        assert CROSSING_LINE - 6.0 < world.progress[row] + 0.5 * stops.length < CROSSING_LINE + 0.1
        hardest[stops.late_braking > 0.0].append(braking)
        if stops.late_braking:
            assert stops.late_braking <= braking < stops.late_braking + 1.0
    assert min(map(len, hardest.values())) > 5
    assert min(hardest[True]) > 4.5
    assert np.median(hardest[False]) < 4.5


def test_a_runner_meets_an_unbraked_ego_and_cross_traffic_and_followers_keep_to_their_light():
    crossing = {MAP.route(name) for name in ("east_left", "east_through", "west_left")}
    hit = 0
    for seed in range(20):
        simulation = started(seed, hazard=True, scenario="street_crossing", traffic="dense")
        for _ in steps(simulation):
            pass
        world, placed = simulation.world, simulation.scene.placements
        hit += world.struck[EGO] in simulation.scene.hidden
        waiting = [row for row in range(len(world.speed)) if world.route[row] in crossing]
        same_way = [row for row in range(1, len(placed)) if placed[row].route == placed[EGO].route]
        followers = [row for row in same_way if placed[row].progress < placed[EGO].progress]
        assert waiting
        assert all(
            world.progress[row] + 0.5 * world.size[row, 0] < CROSSING_LINE + 0.1 for row in (*waiting, *followers)
        )
    assert hit >= 18
