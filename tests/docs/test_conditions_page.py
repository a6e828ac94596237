"""The page about conditions lists those there are."""

from pathlib import Path

from cad_env.conditions import CONDITIONS

PAGE = Path(__file__).parents[2] / "docs" / "conditions.md"


def test_the_page_lists_every_condition_with_what_it_sets_and_why() -> None:
    listed = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    assert listed == [f"| `{name}` | {each.words} | {each.reason} |" for name, each in CONDITIONS.items()]
