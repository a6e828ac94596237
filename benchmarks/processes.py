"""What takes a process of its own: start-up, the memory of a thousand scenes, scoring and recording as users do it."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENV_ID = "CADLeftTurn-v0"

COLD = f"""
import time, gymnasium as gym, cad_env
env = gym.make({ENV_ID!r})
env.reset(seed=0)
env.step(0)
print(time.process_time())
"""


def startup_figures() -> dict[str, list[float]]:
    """Seconds until the first step, with nothing compiled and with everything, and until a command's help."""
    figures: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        for name in ("cold: import to first step, CPU (s)", "warm: import to first step, CPU (s)"):
            done = _run(["-c", COLD], environment)
            figures[name] = [float(done.stdout)]
    for command in ("train.py", "evaluate.py"):
        if (ROOT / command).exists():
            figures[f"{command} --help, wall (s)"] = [_wall(lambda c=command: _run([c, "--help"])) for _ in range(3)]
    return figures


def _run(arguments: list[str], environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)


def _wall(act: Callable[[], object]) -> float:
    start = time.perf_counter()
    act()
    return time.perf_counter() - start


MEMORY = f"""
import sys, gymnasium as gym, numpy as np, cad_env
count = int(sys.argv[1])
env = gym.make_vec({ENV_ID!r}, num_envs=count, vectorization_mode="vector_entry_point")
env.reset(seed=0)
for _ in range(100):
    env.step(np.zeros(count, np.int64))
peak = next(line for line in open("/proc/self/status", encoding="utf-8") if line.startswith("VmHWM"))
print(int(peak.split()[1]) / 1024)
"""

DEMONSTRATIONS = """
import sys, time
from pathlib import Path
from cad_env.vector import CADVectorEnv
from policies.demonstrations import record
record(Path(sys.argv[1]) / "warm", CADVectorEnv(1, radio="none"), None, range(1), lambda done: None)
start = time.process_time()
record(Path(sys.argv[1]) / "shards", CADVectorEnv(64, radio="none"), None, range(1000), lambda done: None)
print(time.process_time() - start)
"""


def memory_figures() -> dict[str, list[float]]:
    """Peak memory, MB, of a process with one scene and with 1,024; on Linux only, which keeps count of it."""
    if not Path("/proc/self/status").exists():
        return {}
    return {f"memory, {count:,} scenes (MB)": [float(_run(["-c", MEMORY, str(count)]).stdout)] for count in (1, 1024)}


def work_figures() -> dict[str, list[float]]:
    """Seconds that 1,000 recorded expert episodes and 500 scored episodes of the shipped network take."""
    with tempfile.TemporaryDirectory() as folder:
        demonstrations = float(_run(["-c", DEMONSTRATIONS, folder]).stdout)
        score = [
            "evaluate.py",
            "--scenario",
            "left_turn",
            "--method",
            "stgraph",
            "--episodes",
            "500",
            "--jobs",
            "2",
            "--out",
            folder,
        ]
        scoring = _wall(lambda: _run(score))
    return {
        "demonstrations 1,000 expert episodes, CPU (s)": [demonstrations],
        "evaluate.py, 500 episodes of stgraph, 2 processes, wall (s)": [scoring],
    }
