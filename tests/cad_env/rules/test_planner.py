"""The rules: brake if going now would end in a contact, go again when it would not."""

import math

import numpy as np
import pytest
from scenes import ARM, EAST, NORTH, WEST, cross, world_of

from cad_env.envs.single import CADEnv
from cad_env.rules.expert import Expert
from cad_env.rules.motion import fit_motion, lane_heading
from cad_env.rules.planner import (
    SLOWEST,
    Planner,
    PlannerConfig,
    contact_ahead,
    decide,
    is_on_way,
    not_on_way,
    oncoming_stretch,
    seconds_for,
    stopping_distance,
)
from cad_env.scenarios.scene import Placement
from cad_env.scoring.rollout import rollout
from cad_env.types import BRAKE, FRAMES, GO, ROUTE_SPACING, STEP
from cad_env.world.state import SCRIPTED, STANDING, STREAM, Truth, crashed
from cad_env.world.step import advance

AHEAD = np.stack([np.arange(60) * ROUTE_SPACING, np.zeros(60)], axis=-1)
EGO = np.array([10.0, 10.0, 4.8, 1.9])  # speed, wanted speed, length, width
RULE = PlannerConfig(ahead=0.7, behind=0.5, gate=5.0).rule

NOWHERE = (math.inf, math.inf)  # no stretch of the way is in an oncoming lane


def crossing(seconds: float, speed: float = 10.0, at: float = 20.0) -> np.ndarray:
    """A car that drives towards +y and crosses the ego's way `at` m ahead in so many seconds."""
    return np.array([[at, -speed * seconds, math.pi / 2, speed, 4.8, 1.9]])


def test_who_would_be_hit_is_braked_for():
    assert decide(AHEAD, EGO, crossing(2.0), NOWHERE, RULE) == BRAKE


@pytest.mark.parametrize("seconds", [-3.0, 6.0])
def test_who_passes_well_before_or_after_is_not(seconds: float):
    assert decide(AHEAD, EGO, crossing(seconds), NOWHERE, RULE) == GO


def test_nobody_on_the_road_is_a_reason_to_go():
    assert decide(AHEAD, EGO, np.zeros((0, 6)), NOWHERE, RULE) == GO


def test_it_does_not_slip_in_just_behind_a_passing_vehicle():
    # Without the extra length behind it the way would be free: its rear is 3 m past when the ego comes.
    passing = crossing(1.1)
    assert not contact_ahead(AHEAD, EGO, passing, False, 4.0, 0.0, 0.0, 0.5)
    assert decide(AHEAD, EGO, passing, NOWHERE, RULE) == BRAKE


WAITING = np.array([0.0, 10.0, 4.8, 1.9])  # the ego stands, a few metres before a lane that crosses


def test_it_goes_when_the_vehicle_before_has_just_passed_and_the_gap_is_long_enough():
    # Rear bumper at the side of the ego, which starts from 5 m before the lane.
    passed = crossing(-0.4, speed=15.0, at=8.4)
    assert decide(AHEAD, WAITING, passed, NOWHERE, RULE) == GO
    for headway, wanted in ((2.0, BRAKE), (3.0, BRAKE), (6.0, GO), (8.0, GO)):
        following = crossing(headway, speed=15.0, at=8.4)
        assert decide(AHEAD, WAITING, np.concatenate([passed, following]), NOWHERE, RULE) == wanted, headway


def test_it_waits_for_a_long_enough_gap_and_takes_it():
    # A platoon 1.5 s apart, then 8 s nobody: it stands until the last has passed, and is through before the next.
    times = [2.0, 3.5, 5.0, 6.5, 14.5]
    stream = [Placement(NORTH, ARM - 15.0 * time, 15.0, 15.0, STREAM) for time in times]
    world = world_of(Placement(EAST, ARM - 25.0, 8.0, 8.0), *stream)
    scratch, asked, through = np.zeros(len(world.speed)), [], None
    for step in range(140):
        asked.append(Expert().act(Truth(world, cross(), 0)))
        advance(world, cross(), np.array([0]), np.array([asked[-1]]), scratch)
        if through is None and world.progress[0] > ARM + 4.0:
            through = STEP * (step + 1)
    assert not crashed(world).any()
    last_brake = STEP * np.flatnonzero(np.array(asked) == BRAKE)[-1]
    assert last_brake < 6.5 + 0.5
    assert 6.5 < through < 6.5 + 5.0


def test_who_follows_or_leads_in_the_same_stream_is_the_driver_s_business():
    same = np.array([[15.0, 0.0, 0.1, 3.0, 4.8, 1.9], [-8.0, 0.0, 0.0, 20.0, 4.8, 1.9]])
    assert decide(AHEAD, EGO, same, NOWHERE, RULE) == GO


@pytest.mark.parametrize("shift", [-90.0, -10.0, 3.0, 60.0, 118.0, 200.0])
@pytest.mark.parametrize(("beside", "heading", "on"), [
    (0.0, 0.0, True), (1.6, 0.3, True), (-1.6, -0.6, True),  # in its lane, and heads along it
    (1.9, 0.0, False), (-3.5, 0.0, False),  # the next lane
    (0.0, math.pi, False), (0.0, math.pi / 2, False), (0.0, 0.8, False),  # oncoming, crossing, leaving
])  # fmt: skip
def test_on_the_way_is_who_is_in_its_lane_or_in_line_with_it_and_heads_along(shift, beside, heading, on):
    assert is_on_way(AHEAD, shift, beside, heading) is on


def test_nobody_is_on_the_way_far_from_its_ends():
    assert [is_on_way(AHEAD, x, 0.0, 0.0) for x in (-101.0, -99.0, 217.0, 219.0)] == [False, True, True, False]


def bend() -> np.ndarray:
    """A way that goes 20 m on along +x, a quarter of a circle to the left, and on along +y at x = 30."""
    straight = [(x, 0.0) for x in np.arange(0.0, 20.0, ROUTE_SPACING)]
    arc = [(20.0 + 10.0 * math.sin(a), 10.0 - 10.0 * math.cos(a)) for a in np.arange(0.0, math.pi / 2, 0.2)]
    return np.array([*straight, *arc, *((30.0, y) for y in np.arange(10.0, 40.0, ROUTE_SPACING))])


def test_on_a_bent_way_its_ends_count_and_not_the_roads_that_they_lead_on():
    way, up = bend(), math.pi / 2
    assert is_on_way(way, 30.0, 60.0, up)  # a leader, beyond what is looked at
    assert is_on_way(way, 27.0, 3.0, math.pi / 4)  # in the turn
    assert is_on_way(way, -30.0, 0.0, 0.0)  # a follower
    assert not is_on_way(way, 30.0, -20.0, up)  # it comes up the road into which the ego turns
    assert not is_on_way(way, 60.0, 0.0, 0.0)  # it went straight on


def test_who_merges_into_the_way_is_braked_for_whatever_its_heading():
    for heading in (0.2, 0.4, 0.6):  # within 40 degrees of the ego's
        when, speed = 2.0, 8.0
        at = np.array([20.0, 0.0]) - when * speed * np.array([math.cos(heading), math.sin(heading)])
        merging = np.array([[*at, heading, speed, 4.8, 1.9]])
        assert not is_on_way(AHEAD, *merging[0, :3])
        assert decide(AHEAD, EGO, merging, NOWHERE, RULE) == BRAKE
        merging[0, 0] -= 60.0  # it comes much later
        assert decide(AHEAD, EGO, merging, NOWHERE, RULE) == GO


def test_who_comes_up_the_road_into_which_the_ego_turns_is_braked_for_and_who_leads_there_is_not():
    way, up = bend(), math.pi / 2
    turning = np.array([8.0, 8.0, 4.8, 1.9])
    ahead, before = ([[30.0, y, up, 9.0, 4.8, 1.9]] for y in (30.0, -28.0))
    rule = PlannerConfig(clear=25.0).rule  # as far as the merge
    assert decide(way, turning, np.array(ahead), NOWHERE, rule) == GO
    assert decide(way, turning, np.array(before), NOWHERE, rule) == BRAKE


def test_who_drives_beside_it_is_no_reason_to_brake():
    beside = np.array([[6.0, 3.5, 0.0, 8.0, 4.8, 1.9], [2.0, -3.5, 0.0, 12.0, 4.8, 1.9]])
    assert decide(AHEAD, EGO, beside, NOWHERE, RULE) == GO


def test_only_those_count_who_move_and_are_not_on_the_way():
    follower, leader = [-20.0, 0.0, 0.0, 12.0, 4.8, 1.9], [20.0, 0.5, 0.1, 8.0, 4.8, 1.9]
    stands, crosses = [20.0, 0.0, math.pi / 2, SLOWEST - 0.1, 4.8, 1.9], [20.0, -9.0, math.pi / 2, 9.0, 4.8, 1.9]
    comes = [60.0, 0.0, math.pi, 9.0, 4.8, 1.9]
    kept = not_on_way(AHEAD, np.array([follower, leader, crosses, stands, comes]))
    assert kept.tolist() == [crosses, comes]


def test_it_looks_as_far_as_it_would_need_to_stop_and_clear_beyond():
    later = crossing(5.0, at=45.0)  # it would be met 45 m ahead
    assert decide(AHEAD, EGO, later, NOWHERE, RULE) == GO
    assert decide(AHEAD, EGO, later, NOWHERE, PlannerConfig(clear=40.0).rule) == BRAKE
    assert seconds_for(EGO, stopping_distance(EGO[0]) + RULE.clear) == pytest.approx(2.5)


def test_who_stands_across_the_way_does_not_deadlock_it():
    # A waiting vehicle is not on a collision course; the way around or behind it is the driver model's work.
    assert decide(AHEAD, EGO, np.array([[20.0, 0.0, math.pi / 2, 0.5, 4.8, 1.9]]), NOWHERE, RULE) == GO


def test_once_waiting_would_leave_it_in_the_way_it_goes():
    # It would come to stand in the other's path, but is past it before the other comes.
    later = crossing(2.0, speed=15.0, at=9.0)
    assert contact_ahead(AHEAD, EGO, later, False, 4.0, RULE.ahead, RULE.behind, RULE.margin)
    assert contact_ahead(AHEAD, EGO, later, True, 4.0, 0.0, 0.0, RULE.margin)
    assert not contact_ahead(AHEAD, EGO, later, False, 4.0, 0.0, 0.0, RULE.margin)
    assert decide(AHEAD, EGO, later, NOWHERE, RULE) == GO


def oncoming(distance: float, speed: float = 15.0) -> np.ndarray:
    """A car that comes towards the ego on its way, so far ahead."""
    return np.array([[distance, 0.0, math.pi, speed, 4.8, 1.9]])


def test_before_an_oncoming_lane_it_looks_as_far_as_it_needs_to_be_through():
    far = oncoming(120.0)  # they would meet after 4.8 s, beyond the 4 s that it looks ahead otherwise
    assert decide(AHEAD, EGO, far, NOWHERE, RULE) == GO
    assert decide(AHEAD, EGO, far, (13.0, 60.0), RULE) == BRAKE
    assert decide(AHEAD, EGO, far, (13.0, 30.0), RULE) == GO  # it is back in its lane before they meet


def test_it_does_not_wait_before_it_is_at_the_gate():
    assert decide(AHEAD, EGO, oncoming(120.0), (stopping_distance(10.0) + RULE.gate + 1.0, 60.0), RULE) == GO


def test_too_late_to_wait_only_a_true_contact_counts():
    # Out there at 10 m/s it is through 45 m after 4.5 s, when the other is 10 m further on: close, but no contact.
    close, stretch = oncoming(127.0), (stopping_distance(10.0) - 1.0, 45.0)
    assert contact_ahead(AHEAD, EGO, close, False, 4.5, RULE.ahead, RULE.behind, RULE.margin)
    assert decide(AHEAD, EGO, close, stretch, RULE) == GO
    assert decide(AHEAD, EGO, close, (stopping_distance(10.0) + 1.0, 45.0), RULE) == BRAKE


def test_a_stretch_is_read_off_the_points_of_the_way():
    flags = np.zeros(40, np.int8)
    assert oncoming_stretch(flags, 2.0) == (math.inf, math.inf)
    flags[5:9] = 1
    flags[30:] = 1
    assert oncoming_stretch(flags, 2.0) == (10.0, 18.0)


def test_an_oncoming_vehicle_is_taken_to_keep_to_its_lane_and_any_other_as_it_heads():
    assert abs(lane_heading(AHEAD, math.pi - 0.05)) == pytest.approx(math.pi)
    for heading in (0.05, math.pi / 2, math.pi - 0.3):
        assert lane_heading(AHEAD, heading) == heading
    bend = np.cumsum([[2 * math.cos(0.1 * k), 2 * math.sin(0.1 * k)] for k in range(41)], axis=0)
    assert lane_heading(bend, math.pi - 0.05) == math.pi - 0.05  # a bend is no lane to keep to


def node(x: float, y: float, t: int) -> tuple[float, float]:
    """Where a car that is at (x, y) now and has the velocity (-9, 12) m/s was `t` frames ago."""
    return x + 9.0 * STEP * t, y - 12.0 * STEP * t


@pytest.mark.parametrize("frames", [[0, 1], [0, 1, 2, 3, 4, 5], [0, 2, 9], [3, 4, 5, 6]])
def test_a_straight_motion_is_fitted_exactly_also_with_gaps(frames: list[int]):
    track, mask = np.zeros((FRAMES, 3)), np.zeros(FRAMES, np.int8)
    odometry, motion = np.zeros((FRAMES, 3)), np.zeros(6)
    for back in range(FRAMES):
        # The ego drove 1 m a frame along +x and turned: every node is in the frame it had then.
        pose = np.array([-1.0 * back, 0.0, 0.02 * back])
        odometry[-1 - back] = pose
        dx, dy = np.array(node(20.0, -5.0, back)) - pose[:2]
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        track[-1 - back] = dx * cos + dy * sin, dy * cos - dx * sin, 0.75
        mask[-1 - back] = back in frames
    assert fit_motion(track, mask, odometry, motion)
    assert motion[:2] == pytest.approx([20.0, -5.0])
    assert motion[2:4] == pytest.approx([math.atan2(12.0, -9.0), 15.0])


def test_one_node_is_no_motion():
    mask = np.zeros(FRAMES, np.int8)
    mask[-1] = 1
    assert not fit_motion(np.zeros((FRAMES, 3)), mask, np.zeros((FRAMES, 3)), np.zeros(6))


def test_noise_on_a_waiting_vehicle_is_not_taken_for_motion():
    rng, moving = np.random.default_rng(0), 0
    mask = np.zeros(FRAMES, np.int8)
    mask[-3:] = 1
    for _ in range(500):
        track = np.array([20.0, 0.0, 0.75]) + rng.normal(0.0, 0.2, (FRAMES, 3))
        motion = np.zeros(6)
        fit_motion(track, mask, np.zeros((FRAMES, 3)), motion)
        moving += motion[3] > 0.0
    assert moving < 0.05 * 500


def test_the_expert_sees_the_truth_and_only_who_is_there():
    ego = Placement(EAST, ARM - 20.0, 10.0, 10.0)
    threat = Placement(NORTH, ARM - 20.0, 10.0, 10.0, SCRIPTED)
    world = world_of(ego, threat)
    assert Expert().act(Truth(world, cross(), 0)) == BRAKE
    world.driver[1] = 0
    assert Expert().act(Truth(world, cross(), 0)) == GO
    world.driver[1], world.speed[1] = STANDING, 0.0
    assert Expert().act(Truth(world, cross(), 0)) == GO


def test_the_expert_brakes_for_who_comes_towards_it():
    world = world_of(Placement(EAST, ARM - 20.0, 10.0, 10.0), Placement(WEST, ARM - 10.0, 10.0, 10.0, SCRIPTED))
    assert Expert().act(Truth(world, cross(), 0)) == BRAKE


@pytest.fixture(scope="module")
def episodes() -> dict[str, list]:
    sharing, alone = CADEnv(radio="dsrc"), CADEnv(radio="none")
    seeds = range(1_000_000, 1_000_040)
    return {
        "own": [rollout(alone, Planner(), seed, hazard=True) for seed in seeds],
        "shared": [rollout(sharing, Planner(), seed, hazard=True) for seed in seeds],
        "expert": [rollout(alone, Expert(), seed, hazard=True) for seed in seeds],
    }


def test_sharing_is_what_saves_the_planner(episodes):
    collisions = {name: sum(e.outcome == "collision" for e in some) for name, some in episodes.items()}
    assert collisions["own"] >= 8
    assert collisions["shared"] <= 1
    assert collisions["expert"] == 0


def test_who_braked_starts_again_and_arrives(episodes):
    for name, late in (("shared", 1), ("expert", 0)):
        assert sum(episode.outcome == "timeout" for episode in episodes[name]) <= late  # the gap was never long enough
        for episode in episodes[name]:
            assert episode.outcome != "success" or episode.action[-1] == GO
        assert sum(episode.brakes > 0 for episode in episodes[name]) >= 36


def test_the_same_knowledge_gives_the_same_decision():
    env = CADEnv()
    observation, _ = env.reset(seed=4)
    assert Planner().act(observation) == Planner().act({k: v.copy() for k, v in observation.items()})
    assert not Planner().privileged
    assert Expert().privileged


@pytest.mark.parametrize(
    ("name", "value"),
    [("clear", -1.0), ("clear", 61.0), ("ahead", -1.0), ("behind", math.nan), ("margin", "1")],
)
def test_a_careless_configuration_is_refused(name: str, value: object):
    with pytest.raises(ValueError, match=f"{name} must be a number from .*, got {value!r}"):
        PlannerConfig(**{name: value})
