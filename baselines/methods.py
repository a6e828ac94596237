"""name -> (what is shared, who decides): the rows of the results table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from baselines.learned import ROWS, Row
from cad_env.types import BRAKE, FRAMES, GO, Policy
from policies.registry import family_named

if TYPE_CHECKING:
    from policies.model_folder import SavedModel

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


def _learned(row: Row) -> Contender:
    def load(models: Path) -> "SavedModel":
        folder = models / row.model
        if not folder.is_dir():
            raise ValueError(f"no trained model for {row.name}: there is no folder {folder}")
        from policies.model_folder import load_model  # here, because torch takes a second that the others need not wait

        return load_model(folder, family_named)

    def needs(models: Path) -> dict[str, Any]:
        return load(models).environment() if row.shares in ("points", "features") else {}

    knows = NOTHING if row.blind else SEEN if row.shares == "nothing" else SENT
    return Contender(row.name, knows, lambda models: load(models).driver(), row.model, row.depth, needs)


CONTENDERS: Mapping[str, Contender] = MappingProxyType(
    {
        contender.name: contender
        for contender in (
            Contender("always-go", NOTHING, lambda _: Always(GO)),
            Contender("always-brake", NOTHING, lambda _: Always(BRAKE)),
            Contender("planner-own", SEEN, _planner),
            Contender("planner-shared", SENT, _planner),
            Contender("expert", TRUTH, _expert),
            *(_learned(row) for row in ROWS.values()),
            Contender("cautious-own", SEEN, _cautious),
            _learned(Row("ppo")),  # learns by reward, and not as the rows do
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
