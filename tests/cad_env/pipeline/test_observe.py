"""What a policy is shown: inside its space, in the ego frame, nearest first."""

import math

import numpy as np
import pytest
from scenes import Twitchy, cross, started, steps

from cad_env.envs.parallel import parallel_env
from cad_env.envs.single import CADEnv
from cad_env.pipeline.graph_arrays import empty_graph_arrays
from cad_env.pipeline.observe import HORIZON, View, as_observation, empty_view, observation_space, observe_ego
from cad_env.pipeline.observe import observe_tracks as observe
from cad_env.scenarios import SCENARIOS
from cad_env.types import FRAMES, MAX_MERGED_TRACKS, OBSERVED_TRACKS, ROUTE_POINTS, ROUTE_SPACING, TRUCK, Command

SPACE = observation_space()


def view_of(places: list[tuple[float, ...]], trail: np.ndarray) -> View:
    """A view of (x, y) places that were seen in every frame."""
    rows, view = empty_graph_arrays(rows=MAX_MERGED_TRACKS), empty_view()
    rows.used[0] = len(places)
    for k, (x, y) in enumerate(places):
        rows.position[k] = x, y, 0.75
        rows.mask[k] = True
    observe(view, rows, trail)
    return view


def still(x: float, y: float, heading: float) -> np.ndarray:
    return np.tile([x, y, heading], (FRAMES, 1))


def test_ahead_is_plus_x_and_left_is_plus_y():
    view = view_of([(3.0, 14.0)], still(3.0, 4.0, math.pi / 2))
    assert view.tracks[0] == pytest.approx(np.tile([10.0, 0.0, 0.75], (FRAMES, 1)), abs=1e-6)
    view = view_of([(-7.0, 4.0)], still(3.0, 4.0, math.pi / 2))
    assert view.tracks[0] == pytest.approx(np.tile([0.0, 10.0, 0.75], (FRAMES, 1)), abs=1e-6)


def test_each_frame_is_in_the_frame_the_ego_had_then():
    trail = still(0.0, 0.0, 0.0)
    trail[:, 0] = np.arange(FRAMES)  # 1 m a frame towards a standing object
    view = view_of([(20.0, 5.0)], trail)
    assert view.tracks[0, :, 0] == pytest.approx(20.0 - np.arange(FRAMES))
    assert (view.tracks[0, :, 1] == 5.0).all()


def test_the_nearest_come_first_and_the_farthest_are_left_out():
    places = [(10.0 + (7 * k) % 25, 0.0) for k in range(25)]
    view = view_of(places, still(0.0, 0.0, 0.0))
    assert view.tracks[:, -1, 0] == pytest.approx(10.0 + np.arange(OBSERVED_TRACKS))
    assert view.mask.all()


def test_absent_tracks_are_masked_zeros():
    view = view_of([(10.0, 0.0)], still(0.0, 0.0, 0.0))
    assert view.mask[0].all()
    assert not any(part[1:].any() for part in (view.tracks, view.mask, view.kind))


def test_a_view_forgets_what_it_showed_before():
    rows, view = empty_graph_arrays(rows=MAX_MERGED_TRACKS), empty_view()
    rows.used[0], rows.mask[0], rows.kind[0] = 1, True, TRUCK
    rows.position[0] = 9.0, 9.0, 1.75
    observe(view, rows, still(0.0, 0.0, 0.0))
    assert view.kind[0] == TRUCK
    rows.mask[0, :10] = False
    observe(view, rows, still(0.0, 0.0, 0.0))
    assert view.mask[0].tolist() == [0] * 10 + [1] * 5
    assert not view.tracks[0, :10].any()
    rows.used[0] = 0
    observe(view, rows, still(0.0, 0.0, 0.0))
    assert not any(part.any() for part in (view.tracks, view.mask, view.kind))


def test_the_far_away_is_clipped_to_the_space():
    view = view_of([(1e6, -1e6)], still(0.0, 0.0, 0.0))
    assert view.tracks[0, 0].tolist() == [HORIZON, -HORIZON, 0.75]


def test_odometry_is_where_the_ego_was_as_it_stands_now():
    trail = np.array([[0.0, float(k), math.pi / 2 + 0.01 * (k - FRAMES + 1)] for k in range(FRAMES)])
    trail[:, 2] += 8 * math.pi  # turns that wound up in the past
    view = empty_view()
    observe_ego(view, trail, trail[-1], cross(), 0, 0.0, 10.0, 12.0, 4.8, 1.9)
    assert view.odometry[:, 0] == pytest.approx(np.arange(FRAMES) - 14.0, abs=1e-5)
    assert view.odometry[:, 1] == pytest.approx(0.0, abs=1e-5)
    assert view.odometry[:, 2] == pytest.approx(0.01 * np.arange(-14, 1), abs=1e-5)
    assert view.ego.tolist() == pytest.approx([10.0, 12.0, 4.8, 1.9])


def test_the_way_ahead_starts_two_metres_on_and_goes_on_beyond_the_route():
    for progress in (100.0, 590.0):
        view = empty_view()
        trail = still(progress - 300.0, 0.5, 0.0)
        observe_ego(view, trail, trail[-1], cross(), 0, progress, 10.0, 12.0, 4.8, 1.9)
        ahead = ROUTE_SPACING * np.arange(1, ROUTE_POINTS + 1)
        assert view.route == pytest.approx(np.stack([ahead, np.full(ROUTE_POINTS, -0.5)], axis=-1), abs=1e-4)


def test_the_command_follows_the_route():
    simulation = started(5, hazard=False)
    commands = [int(np.argmax(simulation.observation(0)["command"])) for _ in steps(simulation)]
    changes = [c for k, c in enumerate(commands) if k == 0 or c != commands[k - 1]]
    assert changes == [Command.FOLLOW_LANE, Command.TURN_LEFT, Command.FOLLOW_LANE]
    assert simulation.outcome() == "success"


def test_what_is_shown_is_where_it_is():
    # Perfect sensors: every shown newest node, put back into the world, is the centre of a vehicle that is there.
    simulation = started(2, sensor={"noise": 0.0, "miss": 0.0}, radio="ideal")
    checked = 0
    for _ in steps(simulation):
        seen, world = simulation.observation(0), simulation.world
        nodes = seen["tracks"][:, -1, :2][seen["mask"][:, -1] == 1]
        cos, sin = math.cos(world.heading[0]), math.sin(world.heading[0])
        there = nodes @ np.array([[cos, sin], [-sin, cos]]) + world.position[0]
        for place in there:
            assert np.linalg.norm(world.position - place, axis=1).min() < 0.25
            checked += 1
    assert checked > 300


EXTREMES = [
    {},
    {"sensor": {"noise": 10.0, "miss": 0.5, "gnss_noise": 50.0, "gnss_yaw_noise": 3.0, "range": 500.0}},
    {"radio": {"rate": 2e6, "loss": 0.5, "delay": 1.4}, "depth": 1},
    {"radio": "none", "traffic": "dense", "ranges": {"ego_speed": (20.0, 20.0), "collaborators": (4, 4)}},
    {"scenario": "overtaking", "traffic": "dense"},
    {"scenario": "street_crossing", "penetration": 1.0},
]


@pytest.mark.parametrize("options", EXTREMES)
def test_every_observation_of_an_episode_is_inside_its_space(options: dict):
    env, policy = CADEnv(**options), Twitchy()
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        ended = False
        while not ended:
            assert SPACE.contains(observation)
            assert observation["command"].sum() == 1
            assert not observation["tracks"][observation["mask"] == 0].any()
            observation, _, terminated, truncated, _ = env.step(policy.act(observation))
            ended = terminated or truncated
        assert SPACE.contains(observation)


@pytest.mark.parametrize("options", EXTREMES)
def test_every_observation_of_every_agent_is_inside_its_space(options: dict):
    arguments = dict(options)
    name = arguments.pop("scenario", "left_turn")
    env, policy = parallel_env(SCENARIOS[name].gym_id, **arguments), Twitchy()
    observations, _ = env.reset(seed=1)
    while env.agents:
        assert all(SPACE.contains(observation) for observation in observations.values())
        observations, *_ = env.step({agent: policy.act(observations[agent]) for agent in env.agents})
    assert all(SPACE.contains(observation) for observation in observations.values())


def test_an_observation_is_a_copy():
    view = empty_view()
    observation = as_observation(view)
    view.tracks[:] = 1.0
    assert not observation["tracks"].any()
    assert list(observation) == list(View._fields)
    assert set(observation) == set(SPACE)
