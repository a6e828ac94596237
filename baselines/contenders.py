"""name -> (what is shared, who decides): the rows of the results table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cad_env.types import BRAKE, GO, Policy

MODEL_FILES = ("model.safetensors", "config.json")
NOTHING, SEEN, SENT, TRUTH = KNOWLEDGE = ("nothing", "what it sees", "what it sees and is sent", "the truth")


@dataclass
class Always:
    """The same decision whatever it sees."""

    action: int
    privileged: bool = False

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Any) -> int:
        """The decision it was made with."""
        return self.action


@dataclass(frozen=True)
class Contender:
    """One row of the results table."""

    name: str
    knows: str  # one of KNOWLEDGE
    make_policy: Callable[[Path], Policy]  # from the folder of trained models
    model: str | None = None  # the folder in there that it needs

    @property
    def shares(self) -> bool:
        """False: nothing is sent, whatever the radio could carry."""
        return self.knows == SENT


def _planner(_: Path) -> Policy:
    from cad_env.planner import Planner  # here, because numba takes half a second that --help need not wait

    return Planner()


def _cautious(_: Path) -> Policy:
    from cad_env.cautious import Cautious

    return Cautious()


def _expert(_: Path) -> Policy:
    from cad_env.planner import Expert

    return Expert()


def _learned(name: str, knows: str, model: str) -> Contender:
    def load(models: Path) -> Policy:
        folder = models / model
        if not folder.is_dir():
            raise ValueError(f"no trained model for {name}: there is no folder {folder}")
        from policies.driver import LearnedPolicy  # here, because torch takes a second that the others need not wait

        return LearnedPolicy.load(folder)

    return Contender(name, knows, load, model)


CONTENDERS: Mapping[str, Contender] = MappingProxyType(
    {
        contender.name: contender
        for contender in (
            Contender("always-go", NOTHING, lambda _: Always(GO)),
            Contender("always-brake", NOTHING, lambda _: Always(BRAKE)),
            Contender("planner-own", SEEN, _planner),
            Contender("planner-shared", SENT, _planner),
            Contender("expert", TRUTH, _expert),
            _learned("stgraph", SENT, "shared"),
            _learned("stgraph-own", SEEN, "own"),
            Contender("cautious-own", SEEN, _cautious),
            _learned("ppo", SENT, "ppo"),
        )
    }
)
SHIPPED = ("always-go", "always-brake", "planner-own", "planner-shared", "expert", "stgraph", "stgraph-own")


def contender_named(name: str) -> Contender:
    """The contender called `name`; ValueError that lists the choices otherwise."""
    if name not in CONTENDERS:
        raise ValueError(f"unknown contender {name!r}: choose among {', '.join(CONTENDERS)}")
    return CONTENDERS[name]


def shipped_models(scenario: str) -> Path:
    """Where the package keeps `shared` and `own`: of all scenarios, or else of the one that is named."""
    import policies

    weights = Path(policies.__path__[0]) / "weights"
    return weights / "all" if (weights / "all").is_dir() else weights / scenario
