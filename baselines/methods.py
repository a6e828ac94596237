"""name -> (what is shared, who decides): the rows of the results table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from baselines.learned import LEARNED, LearnedMethod
from cad_env.types import BRAKE, FRAMES, GO, Policy

if TYPE_CHECKING:
    from policies.model_folder import SavedModel

EXPERT = "expert"
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
class Method:
    """One row of the results table."""

    name: str
    knows: str  # one of KNOWLEDGE
    make_policy: Callable[[Path], Policy]  # from the folder of trained models
    model: str | None = None  # the folder in there that it needs
    depth: int = FRAMES  # newest frames in a message that is sent to it
    # The options of the environment that it needs beside scenario, radio and depth, from the same folder.
    needs: Callable[[Path], dict[str, Any]] = lambda _: {}

    @property
    def shares(self) -> bool:
        """False: nothing is sent, whatever the radio could carry."""
        return self.knows == SENT


def _planner(_: Path) -> Policy:
    from cad_env.rules.planner import Planner  # here, because numba takes half a second that --help need not wait

    return Planner()


def _cautious(_: Path) -> Policy:
    from cad_env.rules.cautious import Cautious

    return Cautious()


def _expert(_: Path) -> Policy:
    from cad_env.rules.expert import Expert

    return Expert()


def _learned(row: LearnedMethod) -> Method:
    def load(models: Path) -> "SavedModel":
        folder = models / row.model
        if not folder.is_dir():
            raise ValueError(f"no trained model for {row.name}: there is no folder {folder}")
        from policies.model_folder import load_model  # here, because torch takes a second that the others need not wait

        return load_model(folder)

    def needs(models: Path) -> dict[str, Any]:
        return load(models).environment() if row.shares in ("points", "features") else {}

    knows = NOTHING if row.blind else SEEN if row.shares == "nothing" else SENT
    return Method(row.name, knows, lambda models: load(models).policy(), row.model, row.depth, needs)


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        method.name: method
        for method in (
            Method("always-go", NOTHING, lambda _: Always(GO)),
            Method("always-brake", NOTHING, lambda _: Always(BRAKE)),
            Method("planner-own", SEEN, _planner),
            Method("planner-shared", SENT, _planner),
            Method(EXPERT, TRUTH, _expert),
            *(_learned(row) for row in LEARNED.values()),
            Method("cautious-own", SEEN, _cautious),
            _learned(LearnedMethod("ppo")),  # learns by reward, and not as the rows do
        )
    }
)
SHIPPED = ("always-go", "always-brake", "planner-own", "planner-shared", "expert", "stgraph", "stgraph-own")


def method_named(name: str) -> Method:
    """The method called `name`; ValueError that lists the choices otherwise."""
    if name not in METHODS:
        raise ValueError(f"unknown method {name!r}: choose among {', '.join(METHODS)}")
    return METHODS[name]


def shipped_models(scenario: str) -> Path:
    """Where the package keeps `shared` and `own`: of all scenarios, or else of the one that is named."""
    import policies

    weights = Path(policies.__path__[0]) / "weights"
    return weights / "all" if (weights / "all").is_dir() else weights / scenario
