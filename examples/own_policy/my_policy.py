"""Policies from outside: a rule on the observation, and one that looks at nothing.

cad-evaluate --method "my_policy:BrakeNearJunction(seconds=3.0)" "my_policy:BlindBrake(seconds=1.0)" always-go stgraph
"""

from dataclasses import dataclass, field

from cad_env import BRAKE, GO


@dataclass
class BrakeNearJunction:
    """Waits at the junction for a while, then goes."""

    seconds: float = 5.0
    privileged: bool = False  # True: `act` gets the truth in place of an observation
    knows: str = "what it sees"  # nothing is sent to it; default: what it sees and is sent
    waited: float = field(default=0.0, init=False)

    def reset(self, seed: int) -> None:
        """Forget the last episode."""
        self.waited = 0.0

    def act(self, observation: dict) -> int:
        """BRAKE while the way bends within 20 m and the ego has not stood for long enough."""
        self.waited += 0.1 * (observation["ego"][0] < 0.1)
        return BRAKE if self.waited < self.seconds and abs(observation["route"][10, 1]) > 1.0 else GO


@dataclass
class BlindBrake:
    """Brakes for the first seconds of an episode, whatever there is to see, then goes."""

    seconds: float = 1.0
    privileged: bool = False
    knows: str = "nothing"
    decisions: int = field(default=0, init=False)

    def reset(self, seed: int) -> None:
        """Begin to count."""
        self.decisions = 0

    def act(self, observation: dict) -> int:
        """BRAKE or GO by the clock alone."""
        self.decisions += 1
        return BRAKE if self.decisions <= 10 * self.seconds else GO
