"""Overtaking's own story: out into the oncoming lane, past a truck, and back."""

import numpy as np
import pytest
from scenes import started, steps

from cad_env.rules.expert import Expert
from cad_env.scenarios.overtaking import ASKED, LANE, LEAVE, OVERTAKING, RETURN, SWING, WEST
from cad_env.scenarios.scene import EGO, HIDDEN, OCCLUDER
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
    simulation = started(1, hazard=False, scenario="overtaking", traffic="dense")
    for _ in steps(simulation):
        pass
    world = simulation.world
    behind = [r for r in range(5, len(world.speed)) if world.route[r] == OVERTAKING.map.route("east")]
    followers = [row for row in behind if simulation.scene.placements[row].progress < -WEST]
    assert followers
    assert all(world.position[row, 0] < 0.0 for row in followers if world.driver[row] != OFF)


def test_the_expert_waits_behind_the_truck_until_the_oncoming_vehicle_has_passed():
    expert, waited = Expert(), 0
    for seed in range(10):
        simulation = started(seed, hazard=True, scenario="overtaking")
        while simulation.outcome() is None:
            action = expert.act(simulation.truth())
            x, y = simulation.world.position[EGO]
            if action == BRAKE and simulation.world.speed[EGO] < 0.1:
                assert y < -1.0  # in its own lane
                assert x < LEAVE + 0.5 * SWING
                waited += 1
            if y > 0.5:
                assert simulation.world.position[HIDDEN, 0] < x + 5.0 or simulation.world.driver[HIDDEN] == OFF
            simulation.step(np.array([action, *[GO] * (len(simulation.agents) - 1)]))
        assert simulation.outcome() == "success"
    assert waited > 50


def test_the_parked_car_is_in_nobody_s_way_and_sees_the_oncoming_lane():
    for seed in range(20):
        scene = started(seed, scenario="overtaking").scene
        parked, truck = scene.placements[3], scene.placements[OCCLUDER]
        assert parked.driver == STANDING
        assert parked.offset + 0.5 * parked.width < -0.5 * LANE  # beside the lane
        assert parked.progress > truck.progress + 30.0
