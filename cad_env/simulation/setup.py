"""Everything about an environment that is not drawn from the seed."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from cad_env.checks import check_mapping, check_numbers, check_range, check_switch, plain, settle
from cad_env.config import (
    PoseConfig,
    RadioConfig,
    SensorConfig,
    check_keywords,
    check_names,
    knows_its_names,
    pose_config,
    radio_config,
)
from cad_env.lidar.config import MAX_RANGE, CloudConfig, cloud_config
from cad_env.scenarios import scenario_named
from cad_env.scenarios.ranges import Traffic
from cad_env.simulation.graph_exchange import GraphCodec, ShareRule
from cad_env.types import FRAMES


@knows_its_names("option")
@dataclass(frozen=True)
class Setup:
    """Everything about an environment that is not drawn from the seed."""

    scenario: Any = "left_turn"  # given as a name or a Scenario; afterwards its name
    ranges: Mapping[str, Any] = field(default_factory=dict)  # of the scenario, by name
    traffic: str = "light"  # none, light or dense: how much is on the road around the cast
    penetration: float | None = None  # probability that a vehicle is connected; None: as many as `collaborators` says
    sensor: SensorConfig = field(default_factory=SensorConfig)
    radio: RadioConfig = field(default_factory=lambda: radio_config("dsrc"))
    pose: PoseConfig = field(default_factory=PoseConfig)  # what a vehicle knows of where it is
    depth: int = FRAMES  # newest frames in a message
    cloud: CloudConfig | None = None  # given: points are shared instead of graphs
    coverage: bool = False  # messages also say what was seen to be empty, and observations where hidden traffic may be
    share: ShareRule | None = None  # what a vehicle sends of its graph (None from it: nothing); None: all of it
    codec: GraphCodec | None = None  # how a graph becomes bytes; None: the project's own message format

    def __post_init__(self) -> None:
        check_numbers(self, "", {"depth": (1, FRAMES), "penetration": (0.0, 1.0)})
        ranges = check_mapping("ranges", self.ranges, "the scenario's ranges")
        settle(self, "ranges", {name: plain(value) for name, value in ranges.items()})
        if self.cloud is not None:
            check_range("sensor range with clouds", self.sensor.range, 1.0, MAX_RANGE)
        if self.share is not None and not callable(self.share):
            raise ValueError(f"share must be None or a function from a Graph to a Graph or None, got {self.share!r}")
        if self.codec is not None and not isinstance(self.codec, GraphCodec):
            raise ValueError(f"codec must be None or have encode and decode (GraphCodec), got {self.codec!r}")
        check_switch("coverage", self.coverage)
        if self.coverage and (self.cloud is not None or self.exchanges_graphs):
            raise ValueError("coverage is a part of the project's own messages: leave out cloud, share and codec")
        if not self.pose.exact and (self.cloud is not None or self.exchanges_graphs):
            raise ValueError("pose is a part of the project's own messages: leave out cloud, share and codec")
        if not self.pose.exact and (self.sensor.gnss_noise or self.sensor.gnss_yaw_noise):
            raise ValueError("pose and the sensor's gnss_noise are two models of one error: leave out one of them")
        if self.cloud is not None and self.exchanges_graphs:
            raise ValueError("share and codec are for graphs: leave them out where points are shared (cloud)")
        Traffic(self.traffic, self.penetration)
        if self.penetration is not None and "collaborators" in self.ranges:
            raise ValueError(
                f"penetration draws each connected vehicle by itself: leave out the range collaborators, "
                f"got {self.ranges['collaborators']!r}"
            )
        scenario = scenario_named(self.scenario)
        scenario.configured(dict(self.ranges))
        settle(self, "scenario", scenario.name)
        # Its own, so that changing the given ones later does not change what was built.
        own = {name: tuple(value) if isinstance(value, list) else value for name, value in self.ranges.items()}
        settle(self, "ranges", own)

    @property
    def exchanges_graphs(self) -> bool:
        """Whether graphs are sent by rules from outside, and not by the compiled path."""
        return self.share is not None or self.codec is not None


def setup_from(options: Mapping[str, Any]) -> Setup:
    """A Setup from keyword arguments: radio and pose by preset, record or dict, sensor and cloud by record or dict.

    >>> setup_from({"radio": "cv2x"}).radio.budget
    90000.0
    >>> setup_from({"radoi": "cv2x"})
    Traceback (most recent call last):
    ...
    cad_env.config.UnknownNameError: unknown option radoi='cv2x': choose among cloud, codec, ...; did you mean radio?
    """
    check_keywords(dict(options), [f.name for f in fields(Setup)])
    given = dict(options)
    if "scenario" in given:
        given["scenario"] = scenario_named(given["scenario"]).name
    for name, kind in (("radio", RadioConfig), ("sensor", SensorConfig), ("pose", PoseConfig)):
        if isinstance(given.get(name), Mapping):
            check_names(f"{name} setting", dict(given[name]), [f.name for f in fields(kind)])
            given[name] = kind(**given[name])
    if "radio" in given:
        given["radio"] = radio_config(given["radio"])
    if "pose" in given:
        given["pose"] = pose_config(given["pose"])
    given["cloud"] = cloud_config(given.get("cloud"))
    if "sensor" in given and not isinstance(given["sensor"], SensorConfig):
        raise ValueError(f"sensor must be a SensorConfig or a dict of its settings, got {given['sensor']!r}")
    return Setup(**given)
