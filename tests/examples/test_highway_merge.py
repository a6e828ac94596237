"""A scenario of one's own: what holds of the shipped scenes holds of the merge, and its expert passes it."""

import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scenes import Steady, started

import cad_env
import evaluate
from baselines.training import command as train_command
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.rules.expert import Expert
from cad_env.scenarios.ranges import DENSITIES, Traffic
from cad_env.scenarios.scene import EGO, HIDDEN, OCCLUDER, Scene, place
from cad_env.scoring.rollout import rollout, rollouts
from cad_env.types import BRAKE, GO, TRUCK, Image
from cad_env.world.state import OFF, STANDING, Truth, World
from cad_env.world.step import advance, note_contacts
from policies.model_folder import load_model
from policies.stgraph.config import StGraphConfig
from policies.training.cloning import Recipe
from policies.training.dagger import Course, train

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "highway_merge"))

from cad_highway_merge import HIGHWAY_MERGE, MERGE, MergeExpert
from cad_highway_merge.road import ENTER, GOAL

NAME = HIGHWAY_MERGE.name
SEEDS = range(1_000_000, 1_000_200)
KIND = pytest.mark.parametrize("hazard", [True, False])
DENSITY = pytest.mark.parametrize("density", DENSITIES)


@pytest.fixture(scope="module", autouse=True)
def _known() -> None:
    cad_env.register(HIGHWAY_MERGE)


class Blind:
    """Brakes for the first decisions whatever is seen, then goes."""

    privileged = True

    def __init__(self, decisions: int) -> None:
        self.decisions = self.left = decisions

    def reset(self, seed: int) -> None:
        self.left = self.decisions

    def act(self, observation: Any) -> int:
        self.left -= 1
        return BRAKE if self.left >= 0 else GO


def drawn(seed: int, hazard: bool | None = None, density: str = "light") -> Scene:
    return HIGHWAY_MERGE.scene(HIGHWAY_MERGE.configured({}), Traffic(density), seed, hazard)


def driven(policy: Any, seed: int, hazard: bool | None, density: str = "light", on: bool = False,
           stands: bool = False) -> tuple[str, float, World]:  # fmt: skip
    """How an episode in which nobody senses ends, after how many s, and its world; `on`: it goes on for 30 s."""
    scene, routes = drawn(seed, hazard, density), HIGHWAY_MERGE.map.routes
    world, ego, scratch = place(scene, routes), np.array([EGO]), np.zeros(len(scene.placements))
    if stands:
        world.driver[EGO], world.speed[EGO] = STANDING, 0.0
    policy.reset(seed)
    for step in range(1, 301):
        advance(world, routes, ego, np.array([policy.act(Truth(world, routes, EGO))]), scratch)
        if not on and (world.struck[EGO] >= 0 or world.progress[EGO] >= scene.goal):
            return ("collision" if world.struck[EGO] >= 0 else "success"), 0.1 * step, world
    return "timeout", 30.0, world


def outcomes(policy: Any, hazard: bool | None) -> Counter[str]:
    return Counter(driven(policy, seed, hazard)[0] for seed in SEEDS)


def test_the_same_seed_draws_the_same_scene_and_half_of_them_have_a_hazard():
    scenes = [drawn(seed) for seed in range(300)]
    assert [drawn(seed) for seed in range(30)] == scenes[:30]
    assert 107 < sum(scene.hazard for scene in scenes) < 193


def test_forcing_the_hazard_changes_only_the_hidden_vehicle():
    absent = 0
    for seed in range(100):
        one, other = drawn(seed, True), drawn(seed, False)
        assert one.connected == other.connected
        assert one.placements[:HIDDEN] == other.placements[:HIDDEN]
        assert one.placements[HIDDEN + 1 :] == other.placements[HIDDEN + 1 :]
        absent += other.placements[HIDDEN].driver == OFF
    assert 15 < absent < 50


@DENSITY
def test_nobody_touches_anybody_at_the_start(density: str):
    for seed in SEEDS:
        scene = drawn(seed, density=density)
        world = place(scene, HIGHWAY_MERGE.map.routes)
        note_contacts(world)
        assert (world.struck < 0).all()
        assert (scene.placements[OCCLUDER].kind, scene.placements[OCCLUDER].driver) == (TRUCK, STANDING)
        assert HIDDEN not in scene.connected
        assert set(scene.connected) & {3, 4}
        assert min(each.progress for each in scene.placements) > 1.0


@KIND
@DENSITY
def test_traffic_does_not_crash_by_itself(density: str, hazard: bool):
    for seed in SEEDS:
        for policy, stands in ((Steady(BRAKE), False), (Steady(BRAKE), True)):
            world = driven(policy, seed, hazard, density, on=True, stands=stands)[2]
            assert (world.struck < 0).all()  # one that does not enter the lane is not touched either
        world = driven(Steady(GO), seed, hazard, density)[2]
        assert (world.struck[1:] <= EGO).all()


def test_never_braking_meets_the_hidden_vehicle_in_a_hazard_and_arrives_without_one():
    struck = [int(driven(Steady(GO), seed, True)[2].struck[EGO]) for seed in SEEDS]
    assert struck.count(HIDDEN) > 0.9 * len(SEEDS)
    assert outcomes(Steady(GO), False) == {"success": len(SEEDS)}


@KIND
def test_the_expert_never_collides_and_arrives(hazard: bool):
    ends = outcomes(MergeExpert(), hazard)
    assert ends["collision"] == 0
    assert ends["success"] >= 0.99 * len(SEEDS)


def test_the_expert_loses_no_time_without_a_hazard():
    lost = [driven(MergeExpert(), seed, False)[1] - driven(Steady(GO), seed, False)[1] for seed in SEEDS[:100]]
    assert np.mean(lost) < 0.1


def test_the_rules_of_the_shipped_scenes_brake_for_nobody_in_a_merge():
    assert outcomes(Expert(), True)["collision"] > 0.9 * len(SEEDS)


@pytest.mark.parametrize(("seconds", "hazards", "calm"), [(0.5, 0.5, 0.0), (1.5, 0.0, 0.1), (2.0, 0.0, 0.15)])
def test_who_brakes_blindly_misses_one_kind_and_meets_another(seconds: float, hazards: float, calm: float):
    blind = Blind(round(10 * seconds))
    assert outcomes(blind, True)["collision"] >= hazards * len(SEEDS)
    assert outcomes(blind, False)["collision"] >= calm * len(SEEDS)


def test_only_others_see_the_hidden_vehicle_while_the_ego_can_still_stop():
    told = []
    for seed in SEEDS[:40]:
        simulation, only_others = started(seed, hazard=True, scenario=NAME), 0
        while simulation.world.progress[EGO] < ENTER - 22.0:  # m; 16 m/s takes 25 m to stop, and 22 m away is too late
            ego, *others = simulation.fleet.visible[:, HIDDEN]
            assert not ego
            listed = [near(tracked, simulation.world.position[HIDDEN]) for tracked in simulation.object_lists()]
            assert not listed[0]
            only_others += any(others) and any(listed[1:])
            simulation.step(np.zeros(len(simulation.agents), np.int64))
        told.append(0.1 * only_others)
    assert min(told) > 1.5  # s
    assert np.median(told) > 2.5


def knowing(seed: int, viewers: slice) -> str:
    """How a hazard ends for the expert if it knows of those alone whom these connected vehicles see now."""
    simulation, expert = started(seed, hazard=True, scenario=NAME), MergeExpert()
    actions = np.zeros(len(simulation.agents), np.int64)
    while (outcome := simulation.outcome()) is None:
        seen = simulation.fleet.visible[viewers].any(axis=0)
        known = simulation.world._replace(driver=np.where(seen, simulation.world.driver, OFF))
        actions[0] = expert.act(Truth(known, simulation.map.routes, EGO))
        simulation.step(actions)
    return outcome


def test_the_same_rules_crash_on_what_the_ego_sees_and_arrive_on_what_the_connected_see():
    alone = Counter(knowing(seed, slice(0, 1)) for seed in SEEDS[:40])
    together = Counter(knowing(seed, slice(None)) for seed in SEEDS[:40])
    assert alone["collision"] > 20
    assert together["success"] >= 38


def near(tracked: Any, position: Any) -> bool:
    return bool((np.hypot(*(tracked[:, :2] - position).T) < 1.5).any())


def test_the_environment_drives_as_the_world_does_one_by_one_and_in_batches():
    seeds = SEEDS[:6]
    envs, env = CADVectorEnv(3, scenario=NAME), CADEnv(scenario=NAME)
    many = sorted(rollouts(envs, MergeExpert(), seeds, hazard=True), key=lambda episode: episode.seed)
    for seed, one in zip(seeds, many, strict=True):
        alone = rollout(env, MergeExpert(), seed, hazard=True)
        assert alone.action.tolist() == one.action.tolist()
        outcome, seconds, _ = driven(MergeExpert(), seed, True)
        assert (one.outcome, one.time) == (outcome, pytest.approx(seconds))


def test_the_command_is_to_merge_from_before_the_bend_until_the_lane_and_the_goal_is_past_it():
    routes, ramp = HIGHWAY_MERGE.map.routes, HIGHWAY_MERGE.map.route("ramp")
    busy = np.flatnonzero(routes.command[ramp] == MERGE) * routes.spacing
    assert busy[0] < ENTER - 40.0
    assert busy[-1] == pytest.approx(GOAL - 25.0, abs=1.0)


def test_a_picture_of_it_can_be_drawn():
    env = CADEnv(scenario=NAME, render_mode="rgb_array", config={"screen_height": 460, "centering_position": [0.5] * 2})
    env.reset(seed=7, options={"hazard": True})
    drawing: Image = env.render()
    env.close()
    assert drawing.shape == (460, 1080, 3)
    assert drawing.std() > 10.0


def test_a_hazard_that_would_have_to_start_beyond_the_road_is_refused():
    with pytest.raises(ValueError, match=r"ego_start=\(30.0, 150.0\).*starts more than \d+ m away"):
        HIGHWAY_MERGE.configured({"ego_start": (30.0, 150.0)})


@pytest.mark.parametrize(
    "asked", [{"id": "CADHighwayMerge-v0"}, {"id": "cad_env:CADScenario-v0", "scenario": HIGHWAY_MERGE}]
)
def test_gym_makes_it_and_the_observation_has_its_command(asked: dict[str, Any]):
    env = gym.make(**asked)
    observation, _ = env.reset(seed=1)
    assert env.observation_space["command"].shape == (7,)
    assert env.observation_space.contains(observation)
    asked_for = set()
    for _ in range(100):
        observation, _, terminated, truncated, _ = env.step(GO)
        asked_for.add(int(observation["command"].argmax()))
        if terminated or truncated:
            break
    assert asked_for >= {0, MERGE}


def test_it_goes_side_by_side_and_with_every_connected_vehicle_as_an_agent():
    envs = gym.make_vec("CADHighwayMerge-v0", num_envs=2, vectorization_mode="vector_entry_point")
    observations, _ = envs.reset(seed=1)
    assert observations["command"].shape == (2, 7)
    fleet = cad_env.parallel_env("CADHighwayMerge-v0")
    observations, _ = fleet.reset(seed=1)
    assert fleet.observation_space("cav_0").contains(observations["cav_0"])
    with pytest.raises(ValueError, match="equally many commands"):
        CADVectorEnv(2, scenario=[HIGHWAY_MERGE, "left_turn"])


def test_worker_processes_score_it_with_its_own_expert(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = [
        "--scenario",
        NAME,
        "--method",
        "always-go",
        "expert",
        "--episodes",
        "26",
        "--jobs",
        "2",
        "--hazard",
        "yes",
    ]
    assert evaluate.main([*words, "--no-report", "--out", str(tmp_path)]) == 0
    rows = {line.split()[1]: line for line in capsys.readouterr().out.splitlines() if line.startswith(NAME)}
    assert " 100.0 [" in rows["always-go"].split("26", 1)[1][:20]
    assert " 0.0 [" in rows["expert"].split("26", 1)[1][:20]


def test_it_is_demonstrated_and_learned(tmp_path: Path):
    config = Course(
        scenarios=(NAME,), episodes=12, dagger_rounds=1, dagger_episodes=2, steps=6, segments=1, validation=1,
        final_validation=1, thresholds=(0.5,), recipe=Recipe(batch=16), network=StGraphConfig(commands=7),
    )  # fmt: skip
    train(config, tmp_path, lambda done: None)
    assert load_model(tmp_path).network.config.commands == 7


def test_another_scenario_of_its_name_is_refused():
    with pytest.raises(ValueError, match=r"'highway_merge' .* is known already"):
        cad_env.register(replace(HIGHWAY_MERGE, gym_id="CADOther-v0"))
    with pytest.raises(ValueError, match="has command 6, but there are 6"):
        replace(HIGHWAY_MERGE, commands=())


def test_the_command_trains_networks_that_know_its_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["--scenario", NAME, "--score", "0", "--out", str(tmp_path)]
    lessons = train_command.TrainSettings(scenario=(NAME,), out=tmp_path).lessons()
    assert {config.network.commands for _, config in lessons} == {7}
    assert train_command.main([*words, "--method", "raw-points"]) == 2
    assert "raw-points cannot learn highway_merge: they have [7] commands" in capsys.readouterr().err
    models = ["--scenario", NAME, "--method", "stgraph", "--episodes", "1", "--out", str(tmp_path / "scores")]
    assert evaluate.main([*models, "--no-report"]) == 2
    assert "knows 6 commands, and highway_merge has 7" in capsys.readouterr().err
