"""What highway-env's environments can be asked beside reset, step and render: served, or refused in one line."""

import copy
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv

from cad_env.config import check_names
from cad_env.types import BRAKE, GO
from cad_env.world.state import OFF

SETTABLE = ("heading", "position", "speed", "target_speed")  # fields of vehicles that the world takes over
_DRIVERS = "the drivers of a scene are compiled, and drawn by its scenario"


def not_served(name: str, why: str) -> Callable[..., NoReturn]:
    """A method that raises a one-line NotImplementedError with its name and the reason."""

    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise NotImplementedError(f"{name} of highway-env is not served by cad_env: {why}")

    refuse.__name__, refuse.__doc__ = name, f"Not served: {why}."
    return refuse


class HighwayBase(AbstractEnv):
    """highway-env's AbstractEnv, whose calls would else fail in the middle or silently change nothing."""

    metadata: dict[str, Any]
    simulation: Any

    def get_available_actions(self) -> list[int]:
        """Both, always."""
        return [GO, BRAKE]

    def update_metadata(self, video_real_time_ratio: float = 1) -> None:
        """Films show so many times the real time: one frame a decision, 10 a second. Of this environment only.

        highway-env writes into the class, doubles the speed, and counts frames between decisions, which do not exist.
        """
        frames = video_real_time_ratio * self.config["policy_frequency"]
        self.metadata = {**type(self).metadata, "render_fps": frames}

    def simplify(self) -> "HighwayBase":
        """A copy without the vehicles that are farther from the ego than PERCEPTION_DISTANCE (200 m)."""
        copied = copy.deepcopy(self)
        world = copied.simulation.world
        far = np.hypot(*(world.position - world.position[0]).T) >= self.PERCEPTION_DISTANCE
        world.driver[far] = OFF
        return copied

    def set_vehicle_field(self, args: tuple[str, Any]) -> "HighwayBase":
        """A copy in which a field (name, value) of all vehicles but the ego is set; ValueError for another name."""
        name, value = args
        check_names("vehicle field", {name: value}, list(SETTABLE))
        copied = copy.deepcopy(self)
        for vehicle in copied.road.rows[1:]:
            setattr(vehicle, name, value)
        return copied

    @property
    def vehicle(self) -> Any:
        """The ego, None before the first reset."""
        return self.controlled_vehicles[0] if self.controlled_vehicles else None

    @vehicle.setter
    def vehicle(self, vehicle: Any) -> None:
        raise NotImplementedError("vehicle cannot be set in cad_env: the ego is the first vehicle of its scene")

    change_vehicles = not_served("change_vehicles()", _DRIVERS)
    randomize_behavior = not_served("randomize_behavior()", _DRIVERS)
    set_preferred_lane = not_served("set_preferred_lane()", _DRIVERS)
    set_route_at_intersection = not_served("set_route_at_intersection()", _DRIVERS)
    call_vehicle_method = not_served("call_vehicle_method()", _DRIVERS)
    to_finite_mdp = not_served("to_finite_mdp()", "the ego has no lanes and speeds to choose among")
