"""Overtaking's own story: out into the oncoming lane, past a truck, and back."""

import numpy as np
import pytest
from scenes import started, steps

from cad_env.rules.expert import Expert
from cad_env.scenarios.overtaking import ASKED, LANE, LEAVE, OVERTAKING, RETURN, SWING, WEST
from cad_env.scenarios.scene import EGO, OCCLUDER
from cad_env.types import BRAKE, GO, Command
from cad_env.world.state import OFF, STANDING

WAYS = OVERTAKING.map.routes
EGO_WAY = OVERTAKING.map.route("overtake")


def test_the_way_swings_out_passes_and_comes_back():
    def side(x: float) -> float:
        point = WAYS.point[EGO_WAY]
        return float(np.interp(x, point[:, 0], point[:, 1]))

    assert side(LEAVE - 10.0) == side(RETURN + SWING + 10.0) == pytest.approx(-LANE / 2)
    assert side(LEAVE + SWING / 2) == pytest.approx(0.0, abs=0.02)
    assert side(LEAVE + SWING + 1.0) == side(0.5 * (LEAVE + SWING + RETURN)) == pytest.approx(LANE / 2)
    length = np.hypot(*np.diff(WAYS.point[EGO_WAY], axis=0).T)
    assert length == pytest.approx(np.full_like(length, WAYS.spacing), abs=0.01)  # an arc length is an index


def test_commands_tell_the_phase():
    phases = []
    for command in WAYS.command[EGO_WAY]:
        if not phases or phases[-1] != command:
            phases.append(Command(command))
    follow = Command.FOLLOW_LANE
    assert phases == [follow, Command.CHANGE_LEFT, follow, Command.CHANGE_RIGHT, follow]
    asked = np.argmax(WAYS.command[EGO_WAY] == Command.CHANGE_LEFT) * WAYS.spacing
    assert asked == pytest.approx(LEAVE - ASKED - WEST, abs=0.5)


def test_only_the_overtaking_way_is_ever_in_an_oncoming_lane():
    inside = np.flatnonzero(WAYS.oncoming[EGO_WAY])
    assert WAYS.oncoming.sum() == len(inside)
    points = WAYS.point[EGO_WAY, inside]
    assert (points[:, 1] + 0.95 > -0.1).all()  # the left side of a car, 1.9 m wide, is at or over the middle
    outside = np.delete(WAYS.point[EGO_WAY], inside, axis=0)
    assert (outside[:, 1] + 0.95 < 0.15).all()


def test_the_ego_drives_past_the_truck_without_touching_it():
    for seed in range(20):
        simulation = started(seed, hazard=False, scenario="overtaking", traffic="none")
        beside = 0
        for _ in steps(simulation):
            beside += simulation.world.position[EGO, 1] > 1.0
        assert simulation.outcome() == "success"
        assert beside > 20


def test_nobody_overtakes_the_truck_but_the_ego():
    followers = 0
    for seed in range(6):
        simulation = started(seed, hazard=False, scenario="overtaking", traffic="dense")
        for _ in steps(simulation):
            pass
        world, placed = simulation.world, simulation.scene.placements
        same_way = [row for row in range(4, len(placed)) if placed[row].route == OVERTAKING.map.route("east")]
        behind = [row for row in same_way if placed[row].progress < -WEST]
        followers += len(behind)
        assert all(world.position[row, 0] < 0.0 for row in behind)
    assert followers > 12


def test_the_stream_comes_the_other_way_along_the_lane_in_which_the_ego_overtakes():
    met = 0
    for seed in range(20):
        scene = started(seed, scenario="overtaking").scene
        assert {scene.placements[row].route for row in scene.hidden} <= {OVERTAKING.map.route("oncoming")}
        met += len(scene.hidden)
    assert met > 100
    middle = int((LEAVE + SWING - WEST + 10.0) / WAYS.spacing)
    oncoming = WAYS.point[OVERTAKING.map.route("oncoming")]
    assert np.abs(oncoming - WAYS.point[EGO_WAY, middle]).sum(axis=1).min() < 0.6  # m, apart from the spacing


def test_the_expert_waits_behind_the_truck_for_a_gap_and_takes_it():
    expert, waited, times = Expert(), 0, []
    for seed in range(10):
        simulation = started(seed, hazard=True, scenario="overtaking")
        world, hidden = simulation.world, list(simulation.scene.hidden)
        while simulation.outcome() is None:
            action = expert.act(simulation.truth())
            x, y = world.position[EGO]
            if action == BRAKE and world.speed[EGO] < 0.1:
                assert y < -1.0  # in its own lane
                assert x < LEAVE + 0.5 * SWING
                waited += 1
            if y > 0.5:  # beside or before whoever is in the oncoming lane now, but never close before one
                here = world.position[hidden, 0] - x
                assert not ((here > 0.0) & (here < 15.0) & (world.driver[hidden] != OFF)).any()
            simulation.step(np.array([action, *[GO] * (len(simulation.agents) - 1)]))
        assert simulation.outcome() == "success"
        times.append(simulation.time)
    assert waited > 50
    assert max(times) < 35.0


def test_whenever_the_ego_goes_without_looking_somebody_may_come():
    # A hazard is no matter of timing: a delay of any length meets about as many of the stream.
    for delay in (0, 60, 120):
        collided = 0
        for seed in range(60):
            simulation = started(seed, scenario="overtaking", traffic="none", radio="none")
            others = [GO] * (len(simulation.agents) - 1)
            while simulation.outcome() is None:
                action = BRAKE if simulation.steps < delay else GO
                simulation.step(np.array([action, *others]))
            collided += simulation.outcome() == "collision"
        assert 0.25 < collided / 60 < 0.8, delay


def test_two_parked_cars_are_in_nobody_s_way_and_stand_far_beyond_the_truck():
    for seed in range(20):
        scene = started(seed, scenario="overtaking").scene
        truck = scene.placements[OCCLUDER]
        for row, beyond in ((2, 30.0), (3, 75.0)):
            parked = scene.placements[row]
            assert parked.driver == STANDING
            assert parked.offset + 0.5 * parked.width < -0.5 * LANE  # beside the lane
            assert parked.progress > truck.progress + beyond
