"""What the models that ship do: some episodes of every scene in half a minute, beside always going and the expert."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.cli import parsed, refused, say, stopped
from baselines.signals import sigterm_as_ctrl_c

METHODS_SHOWN = ("always-go", "stgraph-motion-own", "stgraph-motion", "expert")


@dataclass(frozen=True)
class Demo:
    """Drive some episodes of every scene and print who collides, with 95 % intervals. Nothing is kept."""

    episodes: int = 20  # of each scene and method
    jobs: int = 2  # processes


@sigterm_as_ctrl_c()
def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    try:
        demo = parsed(Demo, argv)
        from baselines.evaluation.run import score  # here, so that --help is quick
        from baselines.evaluation.settings import Settings
        from cad_env.scoring.table import table

        with tempfile.TemporaryDirectory() as folder:
            settings = Settings(method=METHODS_SHOWN, episodes=demo.episodes, jobs=demo.jobs, out=Path(folder))
            rows = [row for row in score(settings) if row.hazard == "all"]
    except (ValueError, OSError) as error:
        return refused(error)
    except KeyboardInterrupt as error:
        return stopped(error)
    say(table(rows))
    say(f"\nIn every episode: {settings.met().words}.")
    say("always-go knows nothing, stgraph-motion-own what it sees, stgraph-motion what it sees and is sent,")
    say("expert the truth.")
    return 0
