"""Scenarios from outside: known by name, by id, by reference and as objects; refused where two would be one."""

import copy
import pickle
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import gymnasium as gym
import pytest
from scenes import forget

import cad_env
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.rules.expert import Expert, decisions, expert_of
from cad_env.scenarios import SCENARIOS, SHIPPED, registry, scenario_named
from cad_env.scenarios.left_turn import LEFT_TURN
from cad_env.scenarios.registry import outside_sources, registered
from cad_env.simulation.setup import Setup
from cad_env.types import BRAKE

OWN = replace(LEFT_TURN, name="own_turn", gym_id="CADOwnTurn-v0")  # found by tests as test_registry:OWN


class Waits:
    privileged = True

    def reset(self, seed: int) -> None: ...

    def act(self, observation: object) -> int:
        return BRAKE


@pytest.fixture(autouse=True)
def _clean() -> Iterator[None]:
    yield
    forget(OWN)


def test_a_scenario_is_an_argument_of_every_environment():
    same = CADEnv(scenario="left_turn").reset(seed=3)[0]
    for env in (CADEnv(scenario=OWN), gym.make("cad_env:CADScenario-v0", scenario=OWN), gym.make("CADOwnTurn-v0")):
        assert (env.reset(seed=3)[0]["tracks"] == same["tracks"]).all()
        assert env.unwrapped.config["scenario"] == "own_turn"
    for vector in (
        CADVectorEnv(2, scenario=OWN),
        CADVectorEnv(2, scenario=[OWN, "left_turn"]),
        gym.make_vec("CADScenario-v0", 2, vectorization_mode="vector_entry_point", scenario=OWN),
        gym.make_vec("CADOwnTurn-v0", 2, vectorization_mode="vector_entry_point"),
    ):
        assert (vector.reset(seed=3)[0]["tracks"][0] == same["tracks"]).all()
    for parallel in (
        cad_env.parallel_env(OWN),
        cad_env.parallel_env("CADOwnTurn-v0"),
        cad_env.parallel_env("CADScenario-v0", scenario=OWN),
    ):
        assert parallel.simulation.scenario is OWN
    assert Setup(scenario=OWN).scenario == "own_turn"


def test_registering_makes_it_known_after_the_shipped_ones():
    assert tuple(SCENARIOS) == registry.PACKAGED == (*SHIPPED, "unsignalised")
    assert cad_env.register(OWN) is cad_env.register(OWN) is scenario_named("own_turn") is OWN
    assert tuple(SCENARIOS) == (*registry.PACKAGED, "own_turn")
    assert SHIPPED == ("left_turn", "overtaking", "street_crossing")
    assert CADEnv(scenario="own_turn").simulation.scenario is OWN


@pytest.mark.parametrize("again", [copy.deepcopy, copy.copy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_is_the_same_scenario(again):
    cad_env.register(OWN)
    assert cad_env.register(again(OWN)) is OWN


@pytest.mark.parametrize(
    ("other", "complaint"),
    [
        (
            replace(OWN, gym_id="CADOther-v0"),
            r"scenario 'own_turn' \(CADOther-v0\) is known already",
        ),
        (replace(LEFT_TURN, expert=Waits), r"scenario 'left_turn' .* is known already"),
        (replace(OWN, name="other"), "another environment has the id 'CADOwnTurn-v0' already"),
        (replace(OWN, name="other", gym_id="CADLeftTurn-v0"), "another environment has the id 'CADLeftTurn-v0'"),
        (replace(OWN, name="other", gym_id="CartPole-v1"), "another environment has the id 'CartPole-v1' already"),
        (replace(OWN, name="other", gym_id="CADScenario-v0"), "another environment has the id 'CADScenario-v0'"),
        (None, "must be a cad_env.scenarios.scenario.Scenario, got None"),
    ],
)
def test_what_would_be_taken_for_another_is_refused_and_leaves_no_trace(other, complaint: str):
    cad_env.register(OWN)
    ids = list(gym.registry)
    with pytest.raises(ValueError, match=complaint) as refusal:
        cad_env.register(other)
    assert "\n" not in str(refusal.value)
    assert (tuple(SCENARIOS), list(gym.registry)) == ((*registry.PACKAGED, "own_turn"), ids)


@pytest.mark.parametrize("name", ["", "all", "my turn", "a:b", 3])
def test_a_name_that_no_command_line_takes_is_refused(name):
    with pytest.raises(ValueError, match="the name of a scenario must be an identifier"):
        replace(OWN, name=name)


def test_it_is_found_by_reference_and_handed_on_by_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    found = scenario_named("test_registry:OWN")
    assert found.name == "own_turn"
    assert registered() == ("test_registry:OWN",)


@pytest.mark.parametrize(
    ("reference", "complaint"),
    [
        ("no_such_module:OWN", "scenario 'no_such_module:OWN' cannot be imported: No module named"),
        ("json:OWN", "scenario 'json:OWN' cannot be imported: module 'json' has no attribute 'OWN'"),
        ("json:dumps", "scenario 'json:dumps' is not a Scenario but <function"),
        (":OWN", "scenario ':OWN' cannot be imported"),
    ],
)
def test_a_reference_to_nothing_is_refused_in_one_line(reference: str, complaint: str):
    with pytest.raises(ValueError, match=complaint) as refusal:
        scenario_named(reference)
    assert "\n" not in str(refusal.value)


def installed(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    entry = EntryPoint(name, "test_registry:OWN", registry.GROUP)
    monkeypatch.setattr(registry, "_installed", lambda: {name: entry})


def test_an_installed_one_is_imported_when_it_is_asked_for(monkeypatch: pytest.MonkeyPatch):
    installed(monkeypatch, "own_turn")
    with pytest.raises(ValueError, match="choose among left_turn, overtaking, street_crossing, unsignalised, own_turn"):
        scenario_named("right_turn")
    assert tuple(SCENARIOS) == registry.PACKAGED
    assert scenario_named("own_turn").gym_id == "CADOwnTurn-v0"
    assert registered() == ("test_registry:OWN",)


def test_an_entry_point_under_another_name_is_refused(monkeypatch: pytest.MonkeyPatch):
    installed(monkeypatch, "turn")
    with pytest.raises(ValueError, match="the entry point 'turn' must have the name of its scenario, 'own_turn'"):
        scenario_named("turn")


def test_an_installed_package_has_its_id_without_being_imported(tmp_path: Path):
    (tmp_path / "plugin-1.dist-info").mkdir()
    (tmp_path / "plugin-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: plugin\nVersion: 1\n")
    (tmp_path / "plugin-1.dist-info" / "entry_points.txt").write_text("[cad_env.scenarios]\nown_turn = plugin:OWN\n")
    (tmp_path / "plugin.py").write_text(
        "from dataclasses import replace\nfrom cad_env.scenarios.left_turn import LEFT_TURN\n"
        "OWN = replace(LEFT_TURN, name='own_turn', gym_id='CADOwnTurn-v0')\n"
    )
    program = (
        f"import sys; sys.path[:0] = [{str(tmp_path)!r}]\n"
        "import gymnasium, cad_env\n"
        "assert not {'plugin', 'highway_env', 'numba'} & set(sys.modules)\n"
        "env = gymnasium.make('CADOwnTurn-v0')\n"
        "assert env.unwrapped.simulation.scenario is sys.modules['plugin'].OWN\n"
        "assert cad_env.parallel_env('CADOwnTurn-v0').simulation.scenario.name == 'own_turn'\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_digest_of_its_source_marks_results_of_one_from_outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert all(outside_sources(name) == {} for name in registry.PACKAGED)
    found = []
    for number, actors in enumerate(("actors", "actors", "lambda *given: actors(*given)")):
        source = (
            "from dataclasses import replace\nfrom cad_env.scenarios.left_turn import LEFT_TURN, actors\n"
            f"def mine(*given): return ({actors})(*given)\n"
            f"OWN = replace(LEFT_TURN, name='own_turn', gym_id='CADOwnTurn-v0', actors=mine)\n"
        )
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "mine.py").write_text(source)
        monkeypatch.syspath_prepend(folder)
        scenario_named("mine:OWN")
        found.append(outside_sources("own_turn"))
        forget(OWN)
        del sys.modules["mine"]
    assert [list(each) for each in found] == [["source of own_turn"]] * 3
    assert found[0] == found[1] != found[2]


def test_the_expert_is_the_scenario_s_own_or_the_shipped_one():
    assert expert_of("left_turn") == Expert()
    own = replace(OWN, expert=Waits)
    assert isinstance(expert_of(own), Waits)
    envs = CADVectorEnv(3, scenario=own)
    envs.reset(seed=0)
    truths = envs.batch.truths(envs.batch.outcomes.nonzero()[0]), envs.batch.truths(envs._everywhere.nonzero()[0])
    assert [decisions(Waits(), each).tolist() for each in truths] == [[], [BRAKE] * 3]
    assert [truth.row for truth in truths[1].each()] == [0, 0, 0]
    assert decisions(Expert(), truths[1]).tolist() == [Expert().act(truth) for truth in truths[1].each()]


def test_an_expert_that_is_not_privileged_is_refused():
    class Blind(Waits):
        privileged = False

    with pytest.raises(ValueError, match="the expert of 'own_turn' must be privileged"):
        expert_of(replace(OWN, expert=Blind))


def asking(command: object) -> tuple:
    first, *others = LEFT_TURN.plans
    return (replace(first, commands=(command, *first.commands[1:])), *others)


def test_further_commands_follow_the_six():
    own = replace(OWN, commands=("reverse", "park"), plans=asking(7))
    assert own.command_names[5:] == ("change_right", "reverse", "park")
    env = CADEnv(scenario=own)
    observation, _ = env.reset(seed=1)
    assert observation["command"].tolist() == [0] * 7 + [1]
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"plans": asking(6)}, "route 'south_left' of own_turn has command 6, but there are 6 (follow_lane, turn_left"),
        ({"plans": asking(-1)}, "has command -1, but"),
        ({"plans": asking("merge")}, "has command 'merge', but"),
        ({"plans": asking(True)}, "has command True, but"),
        ({"plans": asking(8), "commands": ("reverse", "park")}, "has command 8, but there are 8 ("),
        ({"plans": (replace(LEFT_TURN.plans[0], commands=(0, 0)),)}, "must have a command for each of its lanes"),
        ({"commands": ("park", "park")}, "commands of 'own_turn' must be identifiers, each once"),
        ({"commands": ("turn_left",)}, "must be identifiers, each once"),
        ({"commands": ("turn around",)}, "must be identifiers, each once"),
        ({"commands": (3,)}, "must be identifiers, each once"),
        ({"commands": tuple(f"c{k}" for k in range(122))}, "at most 127 commands in all, got 128"),
    ],
)
def test_commands_that_an_observation_has_no_place_for_are_refused(changes: dict, complaint: str):
    with pytest.raises(ValueError, match=re.escape(complaint)) as refusal:
        replace(OWN, **changes)
    assert "\n" not in str(refusal.value)


def test_scenes_side_by_side_have_equally_many_commands():
    with pytest.raises(ValueError, match="must have equally many commands, got own_turn 7, left_turn 6"):
        CADVectorEnv(2, scenario=[replace(OWN, commands=("park",)), "left_turn"])


def test_a_background_that_is_too_small_is_refused():
    with pytest.raises(ValueError, match=r"background of a scenario must offer more vehicles: \d are wanted, 0 there"):
        CADEnv(scenario=replace(OWN, background=lambda *given: [])).reset(seed=1)
