"""The rules of priority to the right over known vehicles."""

import pytest

from cad_env.envs.parallel import parallel_env
from cad_env.rules.priority import PriorityConfig, PriorityPlanner
from cad_env.scenarios.scene import Placement, place
from cad_env.scenarios.unsignalised import LINE, UNSIGNALISED
from cad_env.scoring.fleet import rollout_fleet
from cad_env.types import BRAKE, GO
from cad_env.world.state import STANDING, Truth

MAP = UNSIGNALISED.map
EXPERT = PriorityPlanner(privileged=True)


def decision(way: str, away: float, *others: tuple[str, float, float], speed: float = 8.0) -> int:
    """Of a car so many metres before its line; others: way, m before their line, m/s."""
    own = Placement(MAP.route(f"south_{way}"), LINE - away, speed, 8.0)
    rest = [Placement(MAP.route(name), LINE - far, pace, 8.0) for name, far, pace in others]
    return EXPERT.act(Truth(place([own, *rest], MAP.routes), MAP.routes, 0))


@pytest.mark.parametrize("way", ["through", "left", "right"])
def test_it_goes_where_nobody_is(way: str):
    assert decision(way, 8.0) == GO


def test_it_lets_pass_who_comes_from_the_right_and_not_who_comes_from_the_left_in_good_time():
    assert decision("through", 8.0, ("east_through", 10.0, 8.0)) == BRAKE
    assert decision("through", 9.0, ("west_through", 11.0, 4.0)) == GO
    assert decision("through", 9.0, ("west_through", 11.0, 11.0)) == GO  # there is time to see whether it brakes
    assert decision("through", 0.5, ("west_through", 4.0, 11.0)) == BRAKE  # it cannot stop any more


def test_it_lets_pass_who_comes_towards_its_left_turn():
    assert decision("left", 6.0, ("north_through", 10.0, 8.0)) == BRAKE
    assert decision("through", 6.0, ("north_through", 10.0, 8.0)) == GO


def test_it_does_not_brake_before_it_has_to():
    assert decision("through", 30.0, ("east_through", 30.0, 8.0)) == GO


def test_of_two_that_hardly_move_the_nearer_one_goes():
    assert decision("through", 1.0, ("east_through", 6.0, 2.0), speed=1.0) == GO
    assert decision("through", 6.0, ("east_through", 1.0, 2.0), speed=2.5) == BRAKE


def test_it_brakes_for_who_stands_in_its_way():
    own = Placement(MAP.route("south_through"), LINE + 1.0, 5.0, 8.0)
    for away, action in ((-9.0, BRAKE), (10.0, GO)):
        other = Placement(MAP.route("east_through"), LINE - away, 0.0, 8.0, STANDING)
        assert EXPERT.act(Truth(place([own, other], MAP.routes), MAP.routes, 0)) == action


def test_most_of_a_fleet_on_the_truth_arrive():
    env = parallel_env("CADUnsignalised-v0", radio="none", traffic="none")
    outcomes = [agent.outcome for seed in range(6) for agent in rollout_fleet(env, EXPERT, seed).agents]
    assert outcomes.count("success") >= 0.9 * len(outcomes)


def test_it_decides_on_observations():
    env = parallel_env("CADUnsignalised-v0", traffic="none")
    policy, chosen = PriorityPlanner(), []
    observations, _ = env.reset(seed=1)
    for _ in range(60):
        actions = {agent: policy.act(observations[agent]) for agent in env.agents}
        chosen += actions.values()
        observations, *_ = env.step(actions)
    assert {*chosen} == {GO, BRAKE}


@pytest.mark.parametrize(("name", "value"), [("hold", -1.0), ("trusted", "some"), ("margin", 9.0)])
def test_nonsense_is_refused_by_name_and_value(name: str, value: object):
    with pytest.raises(ValueError, match=name):
        PriorityConfig(**{name: value})
