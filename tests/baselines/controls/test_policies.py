"""A control does what its name says, and nothing but the ego's own speed, place and clock moves it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from baselines.controls.policies import control
from baselines.methods import Always
from cad_env.envs.single import CADEnv
from cad_env.rules.blind import BEFORE, Blind, Control, Own, Slow, Stop, conflict_of
from cad_env.scenarios import SHIPPED, scenario_named
from cad_env.scenarios.junction import ARM
from cad_env.scenarios.ranges import Traffic
from cad_env.scoring.rollout import Episode, rollout
from cad_env.types import BRAKE, GO, STEP
from cad_env.world.geometry import boxes_touch
from cad_env.world.state import OFF, Truth

SEEDS = range(3_000_000, 3_000_004)


@pytest.fixture(scope="module", params=SHIPPED)
def env(request: pytest.FixtureRequest) -> Iterator[CADEnv]:
    env = CADEnv(scenario=request.param, radio="none", traffic="none")
    yield env
    env.close()


def driven(env: CADEnv, name: str, seed: int) -> Episode:
    return rollout(env, control(name, env.simulation.setup.scenario), seed)


def traced(env: CADEnv, name: str, seed: int) -> tuple[Episode, list[tuple[float, float]]]:
    """The episode, and the ego's progress (m) and speed (m/s) before every decision."""
    trace: list[tuple[float, float]] = []

    def watch(env: CADEnv, *_: object) -> None:
        world = env.simulation.world
        trace.append((float(world.progress[0]), float(world.speed[0])))

    return rollout(env, control(name, env.simulation.setup.scenario), seed, watch=watch), trace


@pytest.mark.parametrize("seconds", [0.0, 0.5, 2.0])
def test_blind_brakes_for_its_seconds_and_then_goes(env: CADEnv, seconds: float) -> None:
    for seed in SEEDS:
        action = driven(env, f"blind-{seconds:g}", seed).action
        count = round(seconds / STEP)
        assert (action[:count] == BRAKE).all()
        assert (action[count:] == GO).all()


def test_blind_0_is_always_go(env: CADEnv) -> None:
    for seed in SEEDS:
        going, blind = rollout(env, Always(GO), seed), driven(env, "blind-0", seed)
        assert (going.outcome, going.time) == (blind.outcome, blind.time)


@pytest.mark.parametrize("seconds", [0.5, 2.0])
def test_stop_stands_a_metre_before_the_conflict_for_its_seconds_once(env: CADEnv, seconds: float) -> None:
    scenario = env.simulation.setup.scenario
    place = conflict_of(scenario) - BEFORE
    for seed in SEEDS:
        episode, trace = traced(env, f"stop-{seconds:g}", seed)
        stands = np.array([progress for progress, speed in trace if speed < 0.1])
        if episode.outcome == "collision" and not len(stands):
            continue
        assert (stands <= place).all()
        assert (stands >= place - 2.0).all()
        waited = np.flatnonzero([speed < 0.1 for _, speed in trace])
        assert waited[-1] - waited[0] == len(waited) - 1  # once
        if episode.outcome == "success":
            assert (len(waited) - 1) * STEP == pytest.approx(seconds, abs=0.5)  # and the delay of its command


def test_slow_is_never_faster_once_it_has_slowed_down(env: CADEnv) -> None:
    for seed in SEEDS:
        speed = driven(env, "slow-5", seed).speed
        begun = int(np.argmax(speed <= 5.0))
        assert (speed[begun:] <= 5.0 + 1e-6).all()
        assert begun * STEP < 2.0
        assert speed[begun : begun + 40].mean() > 4.0  # and not much slower than it may be


def test_nobody_else_moves_a_control(env: CADEnv) -> None:
    """The others stand elsewhere, drive elsewhere or are gone: as long as the ego moves alike, it decides alike."""
    scenario = env.simulation.setup.scenario
    names = ("blind-1", "stop-1", "slow-6")
    seeing, mistaken = ([control(name, scenario) for name in names] for _ in range(2))
    env.reset(seed=SEEDS[0])
    for policy in (*seeing, *mistaken):
        policy.reset(SEEDS[0])
    done, rng = False, np.random.default_rng(1)
    while not done:
        truth = env.truth()
        world = truth.world
        others = type(world)(*(part.copy() for part in world))
        others.position[1:] += rng.normal(0.0, 50.0, others.position[1:].shape)
        others.speed[1:], others.driver[1:] = 0.0, OFF
        for one, other in zip(seeing, mistaken, strict=True):
            assert one.act(truth) == other.act(Truth(others, truth.routes, truth.row))
        _, _, terminated, truncated, _ = env.step(GO)
        done = terminated or truncated


@pytest.mark.parametrize("made", [Blind(1.0), Stop(20.0, 1.0), Slow(5.0)])
def test_an_episode_leaves_nothing_to_the_next(made: Control) -> None:
    def decisions() -> list[int]:
        made.reset(0)
        return [made.decide(Own(k * STEP, 8.0 if k < 20 else 0.0, 0.7 * k)) for k in range(60)]

    first = decisions()
    assert decisions() == first
    assert set(first) == {GO, BRAKE}


@pytest.mark.parametrize("scenario", SHIPPED)
def test_before_the_conflict_the_ego_is_in_nobodys_way_and_soon_after_it_is(scenario: str) -> None:
    story = scenario_named(scenario)
    scene = story.scene(story.configured({}), Traffic("none"), 1, hazard=True)
    routes, ego, hidden = story.map.routes, scene.placements[0].route, scene.placements[scene.hazard_row].route

    def touched(progress: float) -> bool:
        """Whether a car at that place of the ego's route touches one anywhere on the hidden route."""
        k = int(progress / routes.spacing)
        x, y = routes.point[ego, k]
        places = zip(*routes.point[hidden].T, routes.heading[hidden], strict=True)
        return any(boxes_touch(x, y, routes.heading[ego, k], 4.8, 1.9, *place, 4.8, 1.9) for place in places)

    conflict = conflict_of(scenario)
    assert not touched(conflict - BEFORE)
    assert touched(conflict + 5.0)


def test_the_conflict_is_where_the_fronts_meet_or_the_oncoming_lane_begins() -> None:
    routes = scenario_named("overtaking").map.routes
    begins = np.flatnonzero(routes.oncoming[0])[0] * routes.spacing
    # At a junction the middle of the hidden lane is 5.25 m from the centre; a car is 2 m wide and 4.8 m long.
    assert conflict_of("street_crossing") == pytest.approx(ARM - 5.25 - 1.0 - 2.4, abs=0.5)
    assert conflict_of("left_turn") == pytest.approx(ARM - 1.5, abs=0.5)  # the same on an arc
    assert conflict_of("overtaking") == begins


def test_routes_that_never_meet_have_no_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    story = scenario_named("left_turn")
    scene = story.scene(story.configured({}), Traffic("none"), 0, hazard=True)
    parked = list(scene.placements)
    parked[scene.hazard_row] = replace(parked[scene.hazard_row], route=story.map.route("east_through"))
    elsewhere = replace(scene, placements=tuple(parked))
    monkeypatch.setattr(type(story), "scene", lambda *_, **__: elsewhere)
    with pytest.raises(ValueError, match="never meets that of the hidden vehicle in 'left_turn'"):
        conflict_of.__wrapped__("left_turn")
