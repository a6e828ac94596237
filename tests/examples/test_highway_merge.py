"""A scenario of one's own: what holds of the shipped scenes holds of the merge, and its expert passes it."""

import copy
import json
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scenes import Steady, forget, started

import cad_env
import evaluate
from baselines.training import command as train_command
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.rendering import layers
from cad_env.rendering.canvas import Tag
from cad_env.rendering.framing import SCALING, focus
from cad_env.rules.expert import Expert
from cad_env.scenarios.ranges import DENSITIES, Traffic
from cad_env.scenarios.registry import outside_sources
from cad_env.scenarios.scene import EGO, OCCLUDER, Scene, place
from cad_env.scoring.rollout import rollout, rollouts
from cad_env.types import BRAKE, GO, MAX_STEPS, STEP, TRUCK, Image
from cad_env.world.state import OFF, STANDING, STREAM, Truth, World
from cad_env.world.step import advance, note_contacts
from policies.command import CommandConfig, CommandNet, CommandPolicy
from policies.model_folder import load_model
from policies.registry import spec_named
from policies.stgraph.network import StGraphConfig, StGraphNet
from policies.stgraph.policy import StGraphPolicy
from policies.training.config import TrainingConfig
from policies.training.dagger import record_demonstrations, train_network
from policies.training.demonstrations import scenes_of

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "highway_merge"))

from cad_highway_merge import HIGHWAY_MERGE, MERGE, MergeExpert
from cad_highway_merge.road import ENTER, GOAL

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "highway_merge"
NAME = HIGHWAY_MERGE.name
SEEDS = range(1_000_000, 1_000_200)
KIND = pytest.mark.parametrize("hazard", [True, False])
DENSITY = pytest.mark.parametrize("density", DENSITIES)


@pytest.fixture(scope="module", autouse=True)
def _known() -> Iterator[None]:
    cad_env.register(HIGHWAY_MERGE)
    yield
    forget(HIGHWAY_MERGE)


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
    """How an episode in which nobody senses ends, after how many s, and its world; `on`: it goes on for 40 s."""
    scene, routes = drawn(seed, hazard, density), HIGHWAY_MERGE.map.routes
    world, ego, scratch = place(scene.placements, routes), np.array([EGO]), np.zeros(len(scene.placements))
    if stands:
        world.driver[EGO], world.speed[EGO] = STANDING, 0.0
    policy.reset(seed)
    for step in range(1, MAX_STEPS + 1):
        advance(world, routes, ego, np.array([policy.act(Truth(world, routes, EGO))]), scratch)
        if not on and (world.struck[EGO] >= 0 or world.progress[EGO] >= scene.goal):
            return ("collision" if world.struck[EGO] >= 0 else "success"), STEP * step, world
    return "timeout", STEP * MAX_STEPS, world


def outcomes(policy: Any, hazard: bool | None = None) -> Counter[str]:
    return Counter(driven(policy, seed, hazard)[0] for seed in SEEDS)


def test_the_same_seed_draws_the_same_scene_and_a_third_of_them_have_a_hazard():
    scenes = [drawn(seed) for seed in range(300)]
    assert [drawn(seed) for seed in range(30)] == scenes[:30]
    assert 70 < sum(scene.hazard for scene in scenes) < 120


def test_a_hazard_is_whom_an_ego_that_never_brakes_meets():
    for seed in SEEDS:
        one, other = drawn(seed, True), drawn(seed, False)
        assert one.hazard
        assert one.hazard_row in one.hidden
        assert (other.hazard, other.hazard_row) == (False, -1)
        assert drawn(seed) in (one, other)  # as it is, or drawn again until it is of the kind that is asked for


def test_the_stream_comes_in_platoons_that_follow_no_closer_than_its_headway():
    ranges, right = HIGHWAY_MERGE.configured({}), HIGHWAY_MERGE.map.route("right")
    waits, empty = [], 0
    for seed in range(300):
        scene = drawn(seed)
        stream = [scene.placements[row] for row in scene.hidden]
        assert all(car.route == right and car.driver == STREAM for car in stream)
        waits += [(one.progress - two.progress) / one.speed for one, two in pairwise(stream)]
        empty += not stream
    close = np.array(waits) <= ranges.headway[1] + 1e-9
    assert min(waits) >= ranges.headway[0] - 1e-9
    assert np.all(close | (np.array(waits) >= ranges.platoon_gap[0] - 1e-9))
    assert 0.55 < close.mean() < 0.85
    assert 3 < empty < 30


@DENSITY
def test_nobody_touches_anybody_at_the_start(density: str):
    for seed in SEEDS:
        scene = drawn(seed, density=density)
        world = place(scene.placements, HIGHWAY_MERGE.map.routes)
        note_contacts(world)
        assert (world.struck < 0).all()
        assert (scene.placements[OCCLUDER].kind, scene.placements[OCCLUDER].driver) == (TRUCK, STANDING)
        assert not set(scene.hidden) & set(scene.connected)
        assert set(scene.connected) & {6, 7}
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
    for seed in SEEDS:
        assert driven(Steady(GO), seed, True)[2].struck[EGO] == drawn(seed, True).hazard_row
    assert outcomes(Steady(GO), False) == {"success": len(SEEDS)}


@KIND
def test_the_expert_never_collides_and_arrives(hazard: bool):
    ends = outcomes(MergeExpert(), hazard)
    assert ends["collision"] == 0
    assert ends["success"] >= 0.99 * len(SEEDS)


def test_the_expert_loses_little_time_without_a_hazard():
    lost = [driven(MergeExpert(), seed, False)[1] - driven(Steady(GO), seed, False)[1] for seed in SEEDS[:100]]
    assert 0.0 <= np.mean(lost) < 2.5


def test_the_rules_of_the_shipped_scenes_are_not_enough_in_a_merge():
    """They look as far ahead as the ego can stop: too short for whoever comes from behind so fast."""
    ends = outcomes(Expert())
    assert 0.08 * len(SEEDS) < ends["collision"] < 0.25 * len(SEEDS)


@pytest.mark.parametrize("seconds", [0.0, 1.0, 2.0, 4.0, 8.0])
def test_nobody_passes_it_with_closed_eyes(seconds: float):
    assert outcomes(Blind(round(10 * seconds)))["collision"] > 0.2 * len(SEEDS)


def test_only_others_see_the_hidden_vehicle_while_the_ego_can_still_stop():
    told = []
    for seed in SEEDS[:40]:
        simulation, only_others = started(seed, hazard=True, scenario=NAME), 0
        row = simulation.scene.hazard_row
        while simulation.world.progress[EGO] < ENTER - 22.0:  # m; 16 m/s takes 25 m to stop, and 22 m away is too late
            ego, *others = simulation.fleet.visible[:, row]
            assert not ego
            listed = [near(tracked, simulation.world.position[row]) for tracked in simulation.object_lists()]
            assert not listed[0]
            only_others += any(others) and any(listed[1:])
            simulation.step(np.zeros(len(simulation.agents), np.int64))
        told.append(STEP * only_others)
    assert min(told) > 0.5  # s
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
    assert together["success"] >= 36


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


def test_a_picture_of_it_shows_the_ego_and_the_highway_well_within():
    env = CADEnv(scenario=HIGHWAY_MERGE, render_mode="rgb_array")
    env.reset(seed=7, options={"hazard": True})
    drawing: Image = env.render()
    assert drawing.shape == (300, 1080, 3)
    assert drawing.std() > 10.0
    simulation, view = env.simulation, np.array([1080, 300]) / SCALING
    while env.simulation.outcome() is None:
        middle, ego = focus(simulation, view), simulation.world.position[EGO]
        assert (np.abs(ego - middle) < 0.5 * view - 3.0).all()
        assert abs(middle[1]) < 6.0  # m from the right lane, in a picture of 46 m
        env.step(GO)
    env.close()


def test_the_picture_names_the_command(monkeypatch: pytest.MonkeyPatch):
    notes: list[str] = []
    monkeypatch.setattr(
        layers, "Tag", lambda text, *given, **further: notes.append(text) or Tag(text, *given, **further)
    )
    env = CADEnv(scenario=HIGHWAY_MERGE, render_mode="rgb_array")
    observation, _ = env.reset(seed=7, options={"hazard": True})
    while not observation["command"][MERGE]:
        observation, *_ = env.step(GO)
    env.render()
    env.close()
    assert "merge" in notes


def test_every_way_in_shows_the_command_of_the_scenario():
    # Always a hazard: Gymnasium's checker compares infos, and without one their `hazard_time` is nan.
    busy = {"empty_share": 0.0, "headway": (1.0, 1.0), "platoon_gap": (1.0, 1.0)}
    for env in (
        gym.make("cad_env:CADScenario-v0", scenario=HIGHWAY_MERGE, ranges=busy),
        gym.make(HIGHWAY_MERGE.gym_id, radio="ideal", ranges=busy),
        gym.make(HIGHWAY_MERGE.gym_id, cloud={}, ranges=busy),
    ):
        observation, _ = env.reset(seed=1)
        assert env.observation_space.contains(observation)
        told = [observation["command"]]
        while told[-1][MERGE] == 0:
            told.append(env.step(GO)[0]["command"])
        assert all(command.shape == (7,) and command.sum() == 1 for command in told)
        check_env(env.unwrapped, skip_render_check=True)
    envs = gym.make_vec(HIGHWAY_MERGE.gym_id, 3, vectorization_mode="vector_entry_point")
    assert envs.observation_space["command"].shape == (3, 7)
    assert envs.observation_space.contains(envs.reset(seed=1)[0])
    parallel = cad_env.parallel_env(HIGHWAY_MERGE.gym_id)
    observations, _ = parallel.reset(seed=1)
    assert all(parallel.observation_space(agent).contains(seen) for agent, seen in observations.items())
    copied = copy.deepcopy(CADEnv(scenario=HIGHWAY_MERGE))
    assert copied.observation_space.contains(copied.reset(seed=1)[0])


def test_all_agents_can_be_driven():
    env = cad_env.parallel_env(HIGHWAY_MERGE)
    env.reset(seed=SEEDS[0], options={"hazard": True})
    expert = MergeExpert()
    while env.agents:
        env.step({agent: expert.act(env.truth(agent)) for agent in env.agents})
    assert env.outcomes["cav_0"] == "success"


@pytest.mark.parametrize(
    "make",
    [
        lambda: CADVectorEnv(2, scenario=["left_turn", HIGHWAY_MERGE]),
        lambda: TrainingConfig(scenarios=("left_turn", NAME)),
        lambda: CADEnv(scenario="left_turn").configure({"scenario": NAME}),
        lambda: TrainingConfig(scenarios=(NAME,), network=StGraphConfig(commands=8)),
        lambda: rollout(CADEnv(scenario=NAME), StGraphPolicy(StGraphNet()), 1),
        lambda: next(rollouts(CADVectorEnv(2, scenario=NAME), CommandPolicy(CommandNet(CommandConfig(), 0), 0.5), [1])),
    ],
)
def test_what_knows_other_numbers_of_commands_is_refused_in_one_line(make: Callable[[], object]):
    with pytest.raises(ValueError, match=r"commands") as refusal:
        make()
    assert "\n" not in str(refusal.value)


def test_a_network_of_the_six_commands_is_not_scored_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["--scenario", NAME, "--method", "stgraph", "--episodes", "1", "--no-report", "--out", str(tmp_path)]
    assert evaluate.main(words) != 0
    assert "error: the model of stgraph knows 6 commands, and highway_merge has 7" in capsys.readouterr().err


def test_two_processes_score_it_as_one_does_with_its_own_expert(tmp_path: Path):
    found = []
    for jobs in ("1", "2"):
        words = ["--scenario", NAME, "--method", "always-go", "expert", "--episodes", "6", "--no-report"]
        assert evaluate.main([*words, "--jobs", jobs, "--out", str(tmp_path / jobs)]) == 0
        found.append([(tmp_path / jobs / name).read_text() for name in ("episodes.jsonl", "scores.json")])
    assert found[0] == found[1]
    records = [json.loads(line) for line in found[0][0].splitlines()]
    assert {each["outcome"] for each in records if each["method"] == "expert"} == {"success"}
    assert "collision" in {each["outcome"] for each in records if each["method"] == "always-go"}
    known = json.loads((tmp_path / "1" / "settings.json").read_text())
    assert known[f"source of {NAME}"] == outside_sources(NAME)[f"source of {NAME}"]


def test_a_command_line_finds_it_by_reference_in_every_process(tmp_path: Path):
    words = ["--scenario", "cad_highway_merge:HIGHWAY_MERGE", "--method", "always-go", "expert", "--episodes", "2"]
    program = [sys.executable, str(ROOT / "evaluate.py"), *words, "--jobs", "2", "--no-report", "--out", str(tmp_path)]
    paths = os.pathsep.join([str(EXAMPLE), str(ROOT)])
    subprocess.run(program, check=True, env={**os.environ, "PYTHONPATH": paths}, capture_output=True)
    records = [json.loads(line) for line in (tmp_path / "episodes.jsonl").read_text().splitlines()]
    assert [(each["scenario"], each["method"]) for each in records] == [
        (NAME, method) for method in ("always-go", "expert") for _ in range(2)
    ]


def test_demonstrations_are_its_expert_s_and_marked_with_its_source(tmp_path: Path):
    (recorded,) = record_demonstrations(tmp_path, NAME, 3, lambda done: None)
    env = CADEnv(scenario=NAME)
    actions = [rollout(env, MergeExpert(), seed).action for seed in recorded.seed.tolist()]
    assert recorded.action.tolist() == recorded.label.tolist() == np.concatenate(actions).tolist()
    assert scenes_of(env.simulation.setup)[f"source of {NAME}"] == outside_sources(NAME)[f"source of {NAME}"]


@pytest.mark.parametrize("spec", ["stgraph", "command", "point_transformer", "compressed"])
def test_every_network_learns_it_for_a_moment_and_drives(spec: str, tmp_path: Path):
    network = spec_named(spec).config_type()
    config = TrainingConfig(
        scenarios=(NAME,), radio="ideal", episodes=8, dagger_rounds=1, dagger_episodes=1, steps=6, segments=2,
        validation=1, final_validation=1, thresholds=(0.5,), batch=8, spec=spec, network=network,
    )  # fmt: skip
    assert (network.commands, config.network.commands) == (6, 7)
    train_network(config, tmp_path, lambda done: None)
    model = load_model(tmp_path)
    assert model.network.config.commands == 7
    env = CADEnv(scenario=NAME, radio="ideal", **model.environment())
    assert rollout(env, model.policy(), SEEDS[0]).outcome in ("success", "collision", "timeout")


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
    config = TrainingConfig(
        scenarios=(NAME,), episodes=12, dagger_rounds=1, dagger_episodes=2, steps=6, segments=1, validation=1,
        final_validation=1, thresholds=(0.5,), batch=16, network=StGraphConfig(commands=7),
    )  # fmt: skip
    train_network(config, tmp_path, lambda done: None)
    assert load_model(tmp_path).network.config.commands == 7


def test_another_scenario_of_its_name_is_refused():
    with pytest.raises(ValueError, match=r"'highway_merge' .* is known already"):
        cad_env.register(replace(HIGHWAY_MERGE, gym_id="CADOther-v0"))
    with pytest.raises(ValueError, match="has command 6, but there are 6"):
        replace(HIGHWAY_MERGE, commands=())


def test_the_command_trains_networks_that_know_its_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    asked = train_command.TrainSettings(scenario=(NAME,), out=tmp_path, method=("stgraph", "raw-points", "compressed"))
    assert {task.config.network.commands for task in asked.tasks()} == {7}
    assert train_command.main(["--scenario", NAME, "left_turn", "--out", str(tmp_path)]) == 2
    assert re.search("error: .*commands", capsys.readouterr().err)
    models = ["--scenario", NAME, "--method", "stgraph", "--episodes", "1", "--out", str(tmp_path / "scores")]
    assert evaluate.main([*models, "--no-report"]) == 2
    assert "knows 6 commands, and highway_merge has 7" in capsys.readouterr().err
