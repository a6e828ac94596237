"""Other simulators' steps, where they are installed (extra `[peers]`): SUMO inside this process, and VMAS.

Neither has line of sight, tracking or a radio. SUMO moves twelve vehicles by IDM along a straight road, which is the
least it can be asked; VMAS drives four agents in its `road_traffic`.
"""

import contextlib
import io
import tempfile
import time
import warnings
from importlib.util import find_spec
from pathlib import Path

VEHICLES, ROAD = 12, 20_000  # m, so long that nobody arrives
AGENTS, ABREAST, FEW = 4, 64, 10  # of VMAS; its steps in a repeat are so many

NETWORK = f"""<net version="1.9">
<location netOffset="0,0" convBoundary="0,0,{ROAD},0" origBoundary="0,0,{ROAD},0" projParameter="!"/>
<edge id="road" from="a" to="b" priority="1">
<lane id="road_0" index="0" speed="14" length="{ROAD}" shape="0,-5 {ROAD},-5"/>
<lane id="road_1" index="1" speed="14" length="{ROAD}" shape="0,-2 {ROAD},-2"/>
</edge>
<junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-6"/>
<junction id="b" type="dead_end" x="{ROAD}" y="0" incLanes="road_0 road_1" intLanes="" shape="{ROAD},-6 {ROAD},0"/>
</net>
"""
ROUTES = "\n".join(
    ['<routes><vType id="idm" carFollowModel="IDM"/><route id="along" edges="road"/>']
    + [
        f'<vehicle id="{n}" type="idm" route="along" depart="0" departPos="{40 * n + 10}" departLane="{n % 2}"/>'
        for n in range(VEHICLES)
    ]
    + ["</routes>"]
)

Figures = dict[str, float]


def simulators(steps: int) -> Figures:
    """Steps a second of CPU time of those that are installed."""
    figures = {}
    if find_spec("libsumo") is not None:
        figures[f"peer libsumo, {VEHICLES} vehicles on a straight road, 0.1 s (1/s)"] = _sumo(steps)
    if find_spec("vmas") is not None:
        for scenes in (1, ABREAST):
            figures[f"peer VMAS road_traffic, {AGENTS} agents, {scenes} scenes (1/s)"] = _vmas(scenes)
    return figures


def _sumo(steps: int) -> float:
    import libsumo

    with tempfile.TemporaryDirectory() as folder:
        network, routes = Path(folder) / "road.net.xml", Path(folder) / "road.rou.xml"
        network.write_text(NETWORK, encoding="utf-8")
        routes.write_text(ROUTES, encoding="utf-8")
        libsumo.start(["sumo", "-n", str(network), "-r", str(routes), "--step-length", "0.1", "--no-step-log"])
        try:
            for _ in range(20):
                libsumo.simulationStep()
            if libsumo.vehicle.getIDCount() != VEHICLES:
                raise RuntimeError(f"{libsumo.vehicle.getIDCount()} vehicles are on SUMO's road, not {VEHICLES}")
            start = time.process_time()
            for _ in range(steps):
                libsumo.simulationStep()
            return steps / (time.process_time() - start)
        finally:
            libsumo.close()


def _vmas(scenes: int) -> float:
    # It imports the unmaintained gym, which says so on standard error.
    with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        import torch
        import vmas
    torch.set_num_threads(1)
    env = vmas.make_env("road_traffic", num_envs=scenes, device="cpu", continuous_actions=True, n_agents=AGENTS)
    env.reset()
    still = [torch.zeros(scenes, 2) for _ in env.agents]
    env.step(still)
    start = time.process_time()
    for _ in range(FEW):
        env.step(still)
    return FEW * scenes / (time.process_time() - start)
