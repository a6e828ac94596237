"""Who was hit by a follower: said of a collision, which stays one."""

import numpy as np
import pytest

from cad_env.envs.single import CADEnv
from cad_env.scoring.rollout import rollout
from cad_env.scoring.scorecard import record_of, scorecards
from cad_env.types import BRAKE
from cad_env.world.state import World, empty_world
from cad_env.world.step import struck_from_behind


def two(x: float, y: float, heading: float) -> World:
    """Vehicle 0 at the origin, headed along x, touched by one at (x, y)."""
    world = empty_world(2)
    world.position[1] = x, y
    world.heading[1] = heading
    world.struck[:] = 1, 0
    return world


@pytest.mark.parametrize(
    ("x", "y", "heading", "follows"),
    [(-5.0, 0.0, 0.0, True), (-4.0, 1.5, 0.3, True), (5.0, 0.0, 0.0, False), (-4.0, 1.0, np.pi / 2, False),
     (-4.0, 0.5, np.pi, False)],
)  # fmt: skip
@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_a_follower_comes_from_behind_and_heads_the_same_way(
    x: float, y: float, heading: float, follows: bool, turn: float
) -> None:
    cos, sin = np.cos(turn), np.sin(turn)
    world = two(x * cos - y * sin, x * sin + y * cos, heading + turn)
    world.heading[0] = turn
    assert struck_from_behind(world, 0) == follows
    assert struck_from_behind(world, 1) == (x > 0.0 and abs(heading) < 0.6)


def test_who_was_not_touched_was_not_hit_from_behind() -> None:
    world = two(-5.0, 0.0, 0.0)
    world.struck[:] = -1
    assert not struck_from_behind(world, 0)


class Braker:
    """Brakes hard while it drives on."""

    privileged = False

    def reset(self, seed: int) -> None: ...

    def act(self, observation: dict) -> int:
        return BRAKE


def test_info_record_and_scorecard_say_it_and_it_stays_a_collision() -> None:
    env = CADEnv(scenario="left_turn", traffic="none")
    env.reset(seed=3, options={"hazard": False})
    world = env.simulation.world
    ego, other = 0, env.simulation.scene.hidden[0]
    world.route[other], world.progress[other] = world.route[ego], world.progress[ego] - 6.0
    world.position[other] = world.position[ego] - 6.0 * np.array(
        [np.cos(world.heading[ego]), np.sin(world.heading[ego])]
    )
    world.heading[other], world.speed[other], world.target_speed[other] = world.heading[ego], 30.0, 30.0
    info = env.step(BRAKE)[4]
    while info["outcome"] is None:
        assert not info["struck_from_behind"]
        info = env.step(BRAKE)[4]
    assert (info["outcome"], info["struck_from_behind"], info["crashed"]) == ("collision", True, True)


def test_scores_keep_it_apart() -> None:
    episode = rollout(CADEnv(scenario="left_turn", traffic="none"), Braker(), 3)
    assert not episode.struck_from_behind
    record = record_of(episode)
    hit = type(record)(**{**vars(record), "outcome": "collision", "struck_from_behind": True})
    row = scorecards([hit, record])[0]
    assert (row.collisions, row.struck_from_behind) == (1, 1)
