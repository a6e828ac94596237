"""TorchRL's wrapper takes the multi-agent environment as it is. Where it is installed: pip install -e ".[torchrl]"."""

import pytest
import torch

from cad_env.envs.fixed_agents import WHOLE, FixedAgents
from cad_env.envs.parallel import parallel_env
from cad_env.scenarios import SCENARIOS
from cad_env.types import BRAKE, GO

pytest.importorskip("torchrl")

# It says that it is tested with PettingZoo 1.24.3.
pytestmark = pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")


def wrapped(env):
    """As TorchRL wants it where agents leave: a mask of who is there, and done when all are."""
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper

    return PettingZooWrapper(env, use_mask=True, done_on_any=False, return_state=True)


@pytest.mark.parametrize("gym_id", [scenario.gym_id for scenario in SCENARIOS.values()])
def test_its_own_check_of_the_specs_passes(gym_id: str):
    from torchrl.envs.utils import check_env_specs

    env = wrapped(parallel_env(gym_id))
    assert env.group_map == {"cav": ["cav_0", "cav_1", "cav_2", "cav_3"]}  # one group: one network can drive them all
    check_env_specs(env, seed=1)


def test_a_rollout_is_the_episode_and_shows_who_has_left():
    env = wrapped(parallel_env("CADOvertaking-v0"))
    env.set_seed(10)
    env.reset()

    def everybody_goes(tensordict):  # TorchRL goes by the name of the argument
        return tensordict.set(("cav", "action"), torch.full((4,), GO))

    data = env.rollout(400, everybody_goes, auto_reset=True)
    plain = parallel_env("CADOvertaking-v0")
    observations, _ = plain.reset(seed=env._env.simulation.seed)
    for step in range(len(data)):
        for k, agent in enumerate(plain.possible_agents):
            alive = agent in observations
            assert bool(data["cav", "mask"][step, k]) is (agent in plain.agents)
            if alive and agent in plain.agents:
                seen = data["cav", "observation"][step, k]
                assert all((seen[name].numpy() == part).all() for name, part in observations[agent].items())
        observations, rewards, _, _, _ = plain.step(dict.fromkeys(plain.agents, GO))
        for k, agent in enumerate(plain.possible_agents):
            assert data["next", "cav", "reward"][step, k].item() == pytest.approx(rewards.get(agent, 0.0))
    assert not plain.agents
    assert data["next", "done"].sum() == 1
    assert BRAKE not in data["cav", "action"]
    assert len(set(data["cav", "mask"].sum(0).tolist())) > 1  # somebody left before the others


def test_a_varying_fleet_passes_its_check_with_fixed_agents_and_its_seeds_survive_float32():
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    env = PettingZooWrapper(FixedAgents(parallel_env("CADOvertaking-v0", penetration=0.4)), return_state=True)
    check_env_specs(env, seed=1)
    for _ in range(3):
        info = env.reset()["cav", "info"]
        seeds = info["seed_high"].to(torch.int64) * WHOLE + info["seed_low"].to(torch.int64)
        assert seeds.tolist() == [env._env.unwrapped.simulation.seed] * len(env.possible_agents)
        assert 0 < info["present"].sum() < len(env.possible_agents)


def test_its_environment_of_an_id_passes_its_check():
    from torchrl.envs.libs.gym import GymEnv
    from torchrl.envs.utils import check_env_specs

    check_env_specs(GymEnv("cad_env:CADOvertaking-v0"), seed=1)
