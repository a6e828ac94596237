"""Scenes with as many vehicles, and as many of them connected, as a measurement wants: cars parked along all arms."""

from dataclasses import dataclass, replace
from typing import Any

from cad_env.scenarios import scenario_named
from cad_env.scenarios.junction import ARM, ARMS
from cad_env.scenarios.ranges import Traffic
from cad_env.scenarios.scene import Placement, Scene
from cad_env.simulation.batch import SceneBatch
from cad_env.simulation.setup import setup_from
from cad_env.world.state import STANDING

FIRST, SPACING = 60.0, 7.0  # m from the junction's centre to the first parked car of an arm, and from one to the next
KERB = -6.0  # m beside its route, where a car is parked


@dataclass(frozen=True)
class Crowd:
    """A left turn in dense traffic, cut or filled up to a number of vehicles, of which the first ones are connected.

    Of the hidden stream only that vehicle is there which would hit the ego: the number is of those who matter.
    """

    vehicles: int
    connected: int

    def __getattr__(self, name: str) -> Any:
        return getattr(scenario_named("left_turn"), name)

    def scene(self, ranges: Any, traffic: Traffic, seed: int, hazard: bool | None = None) -> Scene:
        """The scene of a seed."""
        drawn = scenario_named("left_turn").scene(ranges, Traffic("dense"), seed, hazard)
        kept = [row for row in range(len(drawn.placements)) if row == drawn.hazard_row or row not in drawn.hidden]
        parked = (_parked(number) for number in range(self.vehicles))
        placements = (*(drawn.placements[row] for row in kept), *parked)[: self.vehicles]
        hidden = tuple(place for place, row in enumerate(kept) if row in drawn.hidden)
        rows = [row for row in range(self.vehicles) if row not in hidden]
        return replace(
            drawn, placements=placements, connected=tuple(rows[: self.connected]), hidden=hidden,
            hazard_row=hidden[0] if hidden else -1,
        )  # fmt: skip


def _parked(number: int) -> Placement:
    arm, place = ARMS[number % len(ARMS)], number // len(ARMS)
    route = scenario_named("left_turn").map.route(f"{arm}_through")
    return Placement(route, ARM - FIRST - SPACING * place, 0.0, 1.0, STANDING, offset=KERB)


def crowds(scenes: int, vehicles: int, connected: int) -> SceneBatch:
    """So many of them side by side, at the start of their episodes."""
    batch = SceneBatch([setup_from({})] * scenes)
    for place, simulation in enumerate(batch.simulations):
        simulation.scenario = Crowd(vehicles, connected)  # type: ignore[assignment]
        batch.start(place, place, hazard=True)
    return batch
