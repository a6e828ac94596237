"""A window that is closed, or goes with another one: the episode goes on without it, and it is said once.

Each in a process of its own, for pygame chooses how to show windows once.
"""

import os
import subprocess
import sys

import pytest

START = """
import warnings
import numpy as np, pygame
import gymnasium as gym
from cad_env import parallel_env
from cad_env.envs.single import CADEnv
from cad_env.rendering.viewer import picture

def close_window():
    pygame.event.post(pygame.event.Event(pygame.QUIT))

def window():
    return pygame.display.get_surface() if pygame.display.get_init() else None

def told(act):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        act()
    return [SAID in str(each.message) for each in caught if "window" in str(each.message)]

SAID = "the window was closed: the episode goes on without it"
GONE = [True]
"""
SINGLE = """
env, unseen = CADEnv(render_mode="human"), CADEnv()
for each in (env, unseen):
    each.reset(seed=1, options={"hazard": True})  # else its time in info is nan, which equals nothing
assert window() is not None
close_window()
assert told(lambda: env.step(0)) == GONE
unseen.step(0)
assert window() is None and not env.done
for action in (0, 1, 0):
    assert told(lambda: env.step(action)) == []
    unseen.step(action)
assert env.simulation.world.position.tobytes() == unseen.simulation.world.position.tobytes()
assert env.step(0)[1:] == unseen.step(0)[1:]
assert told(lambda: env.reset(seed=2)) == [] and window() is None
assert told(lambda: env.reset(options={"config": {"scenario": "overtaking"}})) == [] and window() is None
assert told(env.render) == []
env.close()
env.reset(seed=1)
shown = pygame.surfarray.array3d(window()).swapaxes(0, 1)
assert shown.std() > 5  # whoever closes the environment begins anew
env.close()
"""
AGENTS = """
env, unseen = parallel_env(render_mode="human"), parallel_env()
for each in (env, unseen):
    each.reset(seed=1)
assert window() is not None
close_window()
go = dict.fromkeys(env.agents, 0)
assert told(lambda: env.step(go)) == GONE
unseen.step(go)
assert window() is None
assert told(lambda: env.step(go)) == [] and env.agents
assert env.step(go)[1] == [unseen.step(go), unseen.step(go)][1][1]
assert told(lambda: env.reset(seed=2)) == [] and window() is None
env.close()
env.reset(seed=1)
assert window() is not None
env.close()
"""
ANOTHER = """
env, other = (CADEnv(render_mode="human") for _ in range(2))
for each in (env, other):
    each.reset(seed=1)
other.close()  # highway-env ends pygame for all
assert told(lambda: env.step(0)) == GONE
assert told(lambda: env.step(0)) == [] and not env.done
stock = gym.make("CADLeftTurn-v0", render_mode="rgb_array")
stock.reset(seed=1)
assert stock.render().std() > 5
"""
WRAPPED = """
env = gym.make("CADLeftTurn-v0", render_mode="human")
env.reset(seed=1)
close_window()
assert told(lambda: env.step(0)) == GONE
while not any(env.step(0)[2:4]):
    pass
env.reset(seed=1)
env.close()
"""
KEYS = """
env = CADEnv(render_mode="human")
env.reset(seed=1)
before = pygame.surfarray.array3d(window())
for key in (pygame.K_o, pygame.K_m):
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
suited = [list(env.config["centering_position"]), env.config["scaling"]]
env.render()
env.render()
assert (pygame.surfarray.array3d(window()) != before).mean() > 0.1
assert [env.config["centering_position"], env.config["scaling"]] == suited
env.close()
"""


@pytest.mark.parametrize(
    "what", [SINGLE, AGENTS, ANOTHER, WRAPPED, KEYS], ids=["single", "agents", "another", "wrapped", "keys"]
)
def test_the_episode_goes_on_without_its_window(what: str):
    here = {**os.environ, "SDL_VIDEODRIVER": "dummy"}
    done = subprocess.run([sys.executable, "-c", START + what], env=here, timeout=120, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
