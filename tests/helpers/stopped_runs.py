"""Commands that are stopped at one point of their work, not after some time: they send the signal to themselves."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from patience import PATIENCE

ROOT = Path(__file__).parents[2]

# The signal goes to every process of the command, as a terminal's Ctrl-C and a cluster's SIGTERM do, or to one.
_STOP = """
import os, signal, sys, threading

def stop():
    if {everywhere}:
        os.killpg(0, signal.{how})
    else:
        os.kill(os.getpid(), signal.{how})
    threading.Event().wait()  # the signal comes, or the test fails because this never ends
"""
# After the first episode is on the disk; the others that have ended are lost, as if they had ended later.
AT_FIRST_EPISODE = """
from baselines.evaluation.store import Store
append = Store.append

def stopping(store, records):
    append(store, list(records)[:1])
    stop()

Store.append = stopping
"""
# When a worker first tells of its work: in train.py, that a shard is written.
AT_FIRST_REPORT = """
from baselines import workers
heard = workers.heard

def stopping(progress):
    if found := heard(progress):
        stop()
    return found

workers.heard = stopping
"""
# When the workers are there, whatever they have done.
AT_FIRST_LOOK = """
from baselines import workers
workers.heard = lambda progress: stop()
"""


def stopped_run(
    script: str, arguments: list[str], point: str, how: str, everywhere: bool, cwd: Path
) -> tuple[int, str]:
    """Run a script's command and stop it; its exit code and what was said on standard error.

    It ends only when its workers, who share standard error, have ended.
    """
    code = _STOP.format(how=how, everywhere=everywhere) + point
    code += f"\nfrom {script} import main\nsys.exit(main(sys.argv[1:]))\n"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True, cwd=cwd, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    try:
        said = process.communicate(timeout=PATIENCE)[1]
    finally:
        if process.poll() is None:  # it hangs: the test has failed
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    return process.returncode, said


def last_words(said: str) -> list[str]:
    """The lines but those that only tell how far it is, of which a busy machine gives more."""
    return [
        line for line in said.splitlines()
        if not line.startswith(("scoring ", "training ", "record ", "cad_env: compiling"))
    ]  # fmt: skip
