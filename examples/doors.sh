#!/usr/bin/env bash
# Everything that can come from outside, with an installed cad-env (`pip install 'cad-env[learning]'`), from any folder.
#
#   bash examples/doors.sh        python and cad-evaluate are taken from PATH
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
few=(--episodes 3 --no-report)

echo "-- a scenario, found by its entry point"
python -m pip install -q --disable-pip-version-check --no-deps "$here/highway_merge"
cad-evaluate --scenario highway_merge --method always-go expert --jobs 2 "${few[@]}" --out scenario
python -c '
import gymnasium as gym
env = gym.make("cad_env:CADScenario-v0", scenario="highway_merge")
assert env.reset(seed=1)[0]["command"].shape == (7,)'

echo "-- a policy"
PYTHONPATH="$here/own_policy" cad-evaluate --scenario left_turn "${few[@]}" --out policy \
  --method "my_policy:BlindBrake(seconds=1.0)" my_policy:BrakeNearJunction stgraph

echo "-- a network"
PYTHONPATH="$here/own_network" cad-train --method my_network:SPEC --scenario left_turn --episodes 8 --dagger-rounds 0 \
  --steps 30 --validation 2 --score 4 --jobs 1 --out network

echo "-- what is sent, and how"
PYTHONPATH="$here/sharing" python -c 'import my_sharing; my_sharing.main(episodes=3)'

echo "-- a reward"
PYTHONPATH="$here/reward" python -c 'import my_reward; my_reward.main(episodes=3)'
