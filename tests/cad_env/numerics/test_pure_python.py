"""With NUMBA_DISABLE_JIT=1 the same code runs in plain Python, and says the same."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import scenes
from scenes import whole_episode

STEPS = 14
CLOUD = {"cloud": {"azimuths": 64, "beams": 6}, "radio": "ideal"}
PROGRAM = """
import sys
import numba, numpy as np, scenes
assert numba.config.DISABLE_JIT and not hasattr(scenes.advance, "py_func")
seen, rest = scenes.whole_episode(2, {steps}, radio={{"delay": 0.1}}, sensor={{"gnss_noise": 0.3}})
points, _ = scenes.whole_episode(2, 3, **{cloud})
seen.update(cloud=points["cloud"], bytes=[one[2]["bytes_received"] for one in rest])
np.savez(sys.argv[1], reward=[one[0] for one in rest], **seen)
"""


def test_plain_python_lives_through_the_same_episode(tmp_path: Path):
    where = tmp_path / "plain.npz"
    subprocess.run(
        [sys.executable, "-W", "error", "-c", PROGRAM.format(steps=STEPS, cloud=CLOUD), str(where)],
        cwd=Path(scenes.__file__).parent, env={**os.environ, "NUMBA_DISABLE_JIT": "1"}, check=True,
    )  # fmt: skip
    plain = np.load(where)
    compiled, rest = whole_episode(2, STEPS, radio={"delay": 0.1}, sensor={"gnss_noise": 0.3})
    assert plain["bytes"].tolist() == [one[2]["bytes_received"] for one in rest]
    assert plain["bytes"].max() > 100
    np.testing.assert_allclose(plain["reward"], [one[0] for one in rest], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(plain["cloud"], whole_episode(2, 3, **CLOUD)[0]["cloud"], rtol=0.0, atol=1e-6)
    for name, part in compiled.items():
        assert part.shape == plain[name].shape
        np.testing.assert_allclose(plain[name], part, rtol=0.0, atol=1e-9, err_msg=name)
