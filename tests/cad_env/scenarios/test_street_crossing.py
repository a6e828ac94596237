"""The street crossing's own story: a queue beside the ego, and a red light that somebody runs."""

import numpy as np
import pytest
from scenes import started, steps

from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import EGO, HIDDEN, OCCLUDER, Scene
from cad_env.scenarios.street_crossing import CROSSING_LINE, STREET_CROSSING, StreetCrossingRanges
from cad_env.types import CAR, TRUCK
from cad_env.world.state import IDM, OFF, SCRIPTED, STANDING

RANGES = StreetCrossingRanges()
MAP = STREET_CROSSING.map


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return [STREET_CROSSING.scene(RANGES, Traffic(), seed) for seed in range(200)]


def queued(scene: Scene) -> list[int]:
    beside = MAP.route("south_left")
    return [row for row, vehicle in enumerate(scene.placements) if vehicle.route == beside]


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


def test_the_hidden_vehicle_runs_its_light_stops_in_time_stops_late_or_is_absent(scenes):
    stories = set()
    for scene in scenes:
        hidden = scene.placements[HIDDEN]
        assert hidden.route == MAP.route("west_through")
        if scene.hazard:
            assert hidden.driver == SCRIPTED
            assert scene.timing is not None
            assert RANGES.hazard_timing[0] <= scene.timing <= RANGES.hazard_timing[1]
            continue
        assert scene.timing is None
        assert hidden.stop_at == CROSSING_LINE
        stories.add("absent" if hidden.driver == OFF else "late" if hidden.late_braking else "in time")
    assert stories == {"absent", "late", "in time"}


def story(seed: int) -> str:
    hidden = started(seed, hazard=False, scenario="street_crossing").scene.placements[HIDDEN]
    return "absent" if hidden.driver == OFF else "late" if hidden.late_braking else "in time"


def test_whoever_stops_does_so_before_its_line_the_late_one_harder():
    hardest: dict[str, list[float]] = {"late": [], "in time": []}
    for seed in range(40):
        simulation = started(seed, hazard=False, scenario="street_crossing", traffic="none")
        hidden, world = simulation.scene.placements[HIDDEN], simulation.world
        if hidden.driver != IDM:
            continue
        braking = 0.0
        for _ in range(150):
            simulation.step(np.zeros(len(simulation.agents), np.int64))
            if world.speed[HIDDEN] > 3.0:
                braking = max(braking, -world.acceleration[HIDDEN])
        assert world.speed[HIDDEN] == pytest.approx(0.0, abs=0.3)
        assert CROSSING_LINE - 6.0 < world.progress[HIDDEN] + 0.5 * hidden.length < CROSSING_LINE + 0.1
        hardest["late" if hidden.late_braking else "in time"].append(braking)
        if hidden.late_braking:
            assert hidden.late_braking <= braking < hidden.late_braking + 1.0
    assert min(hardest["late"]) > 4.5
    assert np.median(hardest["in time"]) < 4.5


def test_the_runner_meets_an_unbraked_ego_and_cross_traffic_keeps_to_its_light():
    crossing = {MAP.route(name) for name in ("east_left", "east_through", "west_left")}
    for seed in range(20):
        simulation = started(seed, hazard=True, scenario="street_crossing", traffic="dense")
        for _ in steps(simulation):
            pass
        world = simulation.world
        assert simulation.outcome() == "collision"
        assert world.struck[EGO] == HIDDEN
        waiting = [row for row in range(len(world.speed)) if world.route[row] in crossing]
        assert waiting
        assert all(world.progress[row] + 0.5 * world.size[row, 0] < CROSSING_LINE + 0.1 for row in waiting)
