"""GIFs of recorded episodes: which ones, and that they end as recorded."""

from dataclasses import replace
from pathlib import Path

import pytest

from baselines.cli import Progress
from baselines.evaluation import gifs
from baselines.evaluation.gifs import first_of_each, write_gifs
from baselines.evaluation.run import drive_task
from baselines.evaluation.settings import Settings
from cad_env.scoring.scorecard import Record

SETTINGS = Settings(
    scenario=("left_turn",), method=("always-go", "planner-shared"), hazard="yes", episodes=2, first_seed=1_000_023
)


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return [record for task in SETTINGS.tasks() for record in drive_task(SETTINGS, task)]


def test_the_first_seeds_of_each_kind_are_chosen(records: list[Record]):
    always = records[0]
    some = [replace(always, seed=seed, outcome=outcome) for seed, outcome in
            ((9, "success"), (3, "success"), (5, "success"), (7, "collision"))]  # fmt: skip
    chosen = first_of_each([*some, replace(some[0], scenario="elsewhere", seed=11)], 2)
    assert [(record.scenario, record.outcome, record.seed) for record in chosen] == [
        ("elsewhere", "success", 11), ("left_turn", "collision", 7), ("left_turn", "success", 3),
        ("left_turn", "success", 5),
    ]  # fmt: skip
    assert first_of_each(some, 0) == []


def test_an_episode_with_a_hazard_tells_more_than_one_without(records: list[Record]):
    calm, hazard = replace(records[0], seed=1, hazard=False), replace(records[0], seed=2, hazard=True)
    assert first_of_each([calm, hazard], 1) == [hazard]


def test_recorded_episodes_are_driven_again_and_written(records: list[Record], tmp_path: Path):
    paths = write_gifs(SETTINGS, records[:1], tmp_path / "gifs", 1)
    assert [path.name for path in paths] == ["left_turn_always-go_collision_1000023.gif"]
    assert paths[0].read_bytes()[:3] == b"GIF"
    assert paths[0].stat().st_size < 1_500_000


def test_an_episode_that_does_not_end_as_recorded_is_refused(records: list[Record], tmp_path: Path):
    wrong = replace(records[0], outcome="timeout")
    with pytest.raises(ValueError, match="ends in collision, but was recorded as timeout") as refusal:
        write_gifs(SETTINGS, [wrong], tmp_path, 1)
    assert "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())


def test_worker_processes_draw_what_this_one_does_and_both_tell_how_far_they_are(
    records: list[Record], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    told: list[tuple[float, float, str]] = []
    monkeypatch.setattr(Progress, "update", lambda bar, done: told.append((done, bar._total, bar._what)))
    short = [record for record in records if record.outcome == "collision"][:1]
    chosen = [*short, replace(short[0], scenario="left_turn", method="expert", outcome="success")]
    alone = write_gifs(SETTINGS, chosen, tmp_path / "alone", 1)
    monkeypatch.delattr(gifs, "filmed")  # this process can draw nothing any more
    together = write_gifs(replace(SETTINGS, jobs=2), chosen, tmp_path / "together", 1)
    assert [path.name for path in together] == [path.name for path in alone]
    assert [path.read_bytes() for path in together] == [path.read_bytes() for path in alone]
    assert told == [(1, 2, "drawing")] * 4


def test_a_worker_refuses_an_episode_that_does_not_end_as_recorded(records: list[Record], tmp_path: Path):
    wrong = [replace(records[0], outcome=outcome) for outcome in ("timeout", "success")]
    with pytest.raises(ValueError, match="ends in collision, but was recorded as"):
        write_gifs(replace(SETTINGS, jobs=2), wrong, tmp_path / "gifs", 1)
    assert not (tmp_path / "gifs").exists()
