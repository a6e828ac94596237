"""What observations say of hidden traffic: in every environment alike, by the spaces, and only if asked for."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from scenes import started, steps

from cad_env.envs.parallel import CADParallelEnv
from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.pipeline.hidden import HALF, PATIENCE
from cad_env.pipeline.observe import HORIZON
from cad_env.pipeline.observe_lanes import LANE_FEATURES
from cad_env.scenarios import SHIPPED
from cad_env.scenarios.overtaking import ONCOMING_LIMIT
from cad_env.simulation.setup import Setup
from cad_env.types import BRAKE, GO
from cad_env.world.lanes import CONFLICTS, PLACE

COLUMN = {name: k for k, name in enumerate(LANE_FEATURES)}
FURTHER = {"lanes", "lane_mask"}


@pytest.mark.parametrize("scenario", SHIPPED)
def test_gymnasium_s_checker_finds_nothing(scenario: str) -> None:
    env = gym.make("CADScenario-v0", scenario=scenario, coverage=True).unwrapped
    check_env(env, skip_render_check=True)
    assert env.observation_space["lanes"].shape == (CONFLICTS, len(LANE_FEATURES))


def test_pettingzoo_s_test_finds_nothing() -> None:
    env = CADParallelEnv(scenario="street_crossing", coverage=True, waiting=True)
    parallel_api_test(env, num_cycles=50)
    observations, _ = env.reset(seed=1)
    assert all(env.observation_space(agent).contains(seen) for agent, seen in observations.items())


def test_all_environments_show_the_same() -> None:
    single, vector, fleet = CADEnv(coverage=True), CADVectorEnv(2, coverage=True), CADParallelEnv(coverage=True)
    alone = CADEnv(coverage=True, ranges={"collaborators": (3, 3)})
    answers = [single.reset(seed=5)[0], vector.reset(seed=[5, 6])[0], fleet.reset(seed=5)[0], alone.reset(seed=5)[0]]
    for _ in range(40):
        one, many, agents, as_fleet = answers
        assert (one["lane_mask"] == many["lane_mask"][0]).all()
        for name in FURTHER:
            assert one[name].tobytes() == many[name][0].tobytes()
            assert as_fleet[name].tobytes() == agents["cav_0"][name].tobytes()
        answers = [
            single.step(GO)[0], vector.step(np.zeros(2, int))[0], fleet.step(dict.fromkeys(fleet.agents, GO))[0],
            alone.step(GO)[0],
        ]  # fmt: skip


def test_without_it_nothing_is_added_and_nothing_changes() -> None:
    without, with_it = CADEnv(radio="ideal"), CADEnv(radio="ideal", coverage=True)
    one, other = without.reset(seed=3)[0], with_it.reset(seed=3)[0]
    assert other.keys() - one.keys() == FURTHER
    assert set(with_it.observation_space.spaces) - set(without.observation_space.spaces) == FURTHER
    for _ in range(40):
        assert all(one[name].tobytes() == other[name].tobytes() for name in one)
        one, other = without.step(GO)[0], with_it.step(GO)[0]


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_sees_for_itself(copied) -> None:
    env = CADEnv(coverage=True)
    env.reset(seed=2)
    for _ in range(10):
        env.step(GO)
    twin = copied(env)
    for _ in range(5):
        env.step(BRAKE)
    seen = [env.step(GO)[0]["lanes"] for _ in range(10)]
    for _ in range(5):
        twin.step(BRAKE)
    assert all((twin.step(GO)[0]["lanes"] == each).all() for each in seen)


@pytest.mark.parametrize("options", [{"cloud": {}}, {"share": lambda graph: graph}])
def test_it_goes_with_the_project_s_own_messages_alone(options: dict) -> None:
    with pytest.raises(ValueError, match="coverage is a part of the project's own messages"):
        CADEnv(coverage=True, **options)


def test_it_is_a_switch_that_stays_as_it_is() -> None:
    with pytest.raises(ValueError, match="coverage"):
        Setup(coverage="yes")
    env = CADEnv(coverage=True)
    with pytest.raises(ValueError, match="coverage is a part of the observation"):
        env.reset(options={"config": {"coverage": False}})


@pytest.mark.parametrize("scenario", SHIPPED)
def test_the_rows_are_the_lanes_ahead_and_the_foremost_hidden_places(scenario: str) -> None:
    simulation = started(7, scenario=scenario, coverage=True, penetration=0.3)
    lanes, own = simulation.map.lanes, int(simulation.world.route[0])
    checked = 0
    for _ in steps(simulation, 120):
        seen = simulation.observation(0)
        rows, count = seen["lanes"], int(seen["lane_mask"].sum())
        assert (seen["lane_mask"][:count] == 1).all()
        assert not rows[count:].any()
        along = float(simulation.world.progress[0])
        ahead = [k for k in range(CONFLICTS) if lanes.other[own, k] >= 0
                 and lanes.through[own, k] - along + 0.5 * simulation.world.size[0, 0] > 0.0]  # fmt: skip
        assert len(ahead) == count
        for row, k in zip(rows, ahead, strict=False):
            assert row[COLUMN["reach"]] == pytest.approx(
                lanes.reach[own, k] - along - 0.5 * simulation.world.size[0, 0], abs=0.3
            )
            assert row[COLUMN["reach"]] < row[COLUMN["through"]]
            assert np.hypot(row[COLUMN["cos"]], row[COLUMN["sin"]]) == pytest.approx(1.0, abs=1e-5)
            away = row[COLUMN["hidden"]]
            limit = row[COLUMN["speed"]]
            at_once = max(away - HALF[0], 0.0) / limit
            assert row[COLUMN["time"]] >= at_once - 0.01
            if away == HORIZON:
                continue
            if scenario == "overtaking":  # its oncoming lane is straight
                assert limit == ONCOMING_LIMIT
                assert row[COLUMN["time"]] == pytest.approx(at_once, abs=0.01)
            place = round(float(lanes.entry[own, k] - away - lanes.start[lanes.other[own, k]]) / PLACE) - 1
            assert 0 < simulation.fleet.hidden.places[0, k, place] <= PATIENCE
            apart = np.hypot(*(row[[COLUMN["phantom_x"], COLUMN["phantom_y"]]] - row[[COLUMN["x"], COLUMN["y"]]]))
            assert apart <= abs(away) + 0.5
            checked += 1
    assert checked > 30


def test_a_lane_is_known_to_be_free_when_somebody_who_sees_it_says_so() -> None:
    """In the left turn the witness sees past the truck, and the ego alone does not."""

    def hidden(radio: str) -> float:
        simulation, found = started(1, hazard=False, coverage=True, radio=radio), []
        for _ in steps(simulation, 60, lambda agent: BRAKE if agent == 0 else GO):
            lanes, route = simulation.map.lanes, simulation.map.route("north_through")
            north = lanes.other[simulation.world.route[0]].tolist().index(route)
            found.append(simulation.fleet.hidden.places[0, north, -45:].mean())
        return float(np.mean(found[10:]))

    assert hidden("ideal") < 0.5 * hidden("none")
