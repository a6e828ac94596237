"""From a row of the table and what a run may cost to a course, and what its folder is for."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from baselines.folder_note import claim
from baselines.methods import LearnedMethod, learned_named
from policies.registry import spec_named

if TYPE_CHECKING:
    from policies.training.dagger import Advance, Course

COURSE = "course.json"  # in the folder of a row: what it was trained with


@dataclass(frozen=True)
class Budget:
    """What the training of every row may cost; episodes are counted per scenario."""

    scenarios: tuple[str, ...]
    radio: str  # that of the rows that share and name no other
    episodes: int  # driven by the expert
    dagger_rounds: int  # DAgger rounds, of the rows that name no other number
    steps: int  # optimiser steps of the first round; later rounds take half as many
    validation: int  # closed-loop episodes after each third of a round
    dagger_episodes: int = 400  # in each DAgger round
    mixing: float = 0.0  # share of the decisions that the expert takes in the first DAgger round


@dataclass(frozen=True)
class Lesson:
    """One row, trained from one seed, in a folder of models."""

    row: str
    seed: int
    models: Path  # its own folder is in there
    demonstrations: Path  # of the expert, shared by all lessons

    @property
    def folder(self) -> Path:
        """Where the model goes."""
        return self.models / learned_named(self.row).model


def course_of(row: LearnedMethod, seed: int, budget: Budget, knobs: Mapping[str, Any] | None = None) -> "Course":
    """How a row is trained; ValueError for what is impossible. `knobs` of the network go before those of the row."""
    from policies.training.cloning import Recipe  # here, because torch takes a second that --help need not wait
    from policies.training.dagger import Course

    radio = "none" if row.shares == "nothing" else row.radio or budget.radio
    settings = {**commands_of(row, budget.scenarios), **row.config, **(knobs or {})}
    network = spec_named(row.spec).config_type(**settings)
    validation = budget.validation if row.most_validated is None else min(budget.validation, row.most_validated)
    return Course(
        scenarios=budget.scenarios, radio=radio, depth=row.depth, seed=seed, episodes=budget.episodes,
        dagger_rounds=budget.dagger_rounds if row.dagger_rounds is None else row.dagger_rounds,
        dagger_episodes=budget.dagger_episodes, mixing=budget.mixing,
        steps=max(round(row.pace * budget.steps), 3), validation=validation, final_validation=validation * 5 // 3,
        spec=row.spec, network=network, recipe=Recipe(**row.recipe),
    )  # fmt: skip


def commands_of(row: LearnedMethod, scenarios: Sequence[str]) -> dict[str, int]:
    """The setting of a network that its scenarios' commands ask for: nothing where they are the usual six.

    ValueError for a network that knows no others, and for scenarios that differ.
    """
    from cad_env.scenarios import scenario_named
    from cad_env.types import Command

    counts = {scenario_named(name).command_count for name in scenarios}
    if counts <= {len(Command)}:
        return {}
    known = {each.name for each in fields(spec_named(row.spec).config_type)}
    if len(counts) > 1 or "commands" not in known:
        raise ValueError(f"{row.name} cannot learn {', '.join(scenarios)}: they have {sorted(counts)} commands")
    return {"commands": counts.pop()}


def claim_course(folder: Path, course: "Course") -> None:
    """Note in the folder of a row what it is trained with; ValueError if that is not what it was begun with."""
    from cad_env.version import version

    claim(folder / COURSE, {**asdict(course), "version of cad_env": version()}, "use another --out or delete it")


def learn(lesson: Lesson, course: "Course", advance: "Advance") -> None:
    """Train the row into its folder, going on where it stopped."""
    from policies.training.dagger import train

    claim_course(lesson.folder, course)
    train(course, lesson.folder, advance, lesson.demonstrations)
