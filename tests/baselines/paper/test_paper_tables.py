"""The report says what was measured, beside what the paper says, and what is missing is missing."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paper_run import record, write_closed, write_episodes, write_run

from baselines.evaluation.job import job_of
from baselines.evaluation.settings import Settings
from baselines.methods import Always
from baselines.paper.acceptance import bars
from baselines.paper.claims import orders
from baselines.paper.closed_metrics import ClosedRow, closed_row, compared
from baselines.paper.folder import read_run
from baselines.paper.published import SCENES, TABLE_2, TABLE_3
from baselines.paper.report import found_in, write_results
from baselines.paper.sweeps import SWEEPS, points
from baselines.paper.tables import outcome_table, percent_cell, sweep_table, time_cell
from cad_env.envs.single import CADEnv
from cad_env.files import FileError
from cad_env.scoring.interval import wilson_estimate
from cad_env.scoring.rollout import rollout
from cad_env.scoring.scorecard import Record
from cad_env.types import BRAKE, GO

CALM = Record("left_turn", "stgraph", 1, False, "success", 10.0, 2, 300.0, 400, 40, 3, 12000, 5.0, None, 4, 0.0)
HAZARD = replace(CALM, seed=2, hazard=True, time=20.0, brakes=90, min_ttc=None, hardest_brake=5.5)
CRASH = replace(HAZARD, seed=3, outcome="collision", time=5.0, min_ttc=0.0, hardest_brake=3.9)
MINE = {record.seed: record for record in (CALM, HAZARD, CRASH)}
EXPERT = {record.seed: replace(record, outcome="success", time=10.0) for record in MINE.values()}


def row_of(
    name: str, successes: int, of: int, scene: str = "left_turn"
) -> tuple[ClosedRow, dict[int, dict[int, Record]]]:
    records = {
        k: replace(CALM, seed=k, method=name, outcome="success" if k < successes else "timeout") for k in range(of)
    }
    drives = {0: records}
    return closed_row("dsrc", scene, name, drives, {}), drives


def test_the_numbers_of_a_row_by_hand() -> None:
    row = closed_row("dsrc", "left_turn", "stgraph", {0: MINE}, EXPERT)
    assert (row.training_seeds, row.episodes) == (1, 3)
    assert row.success == wilson_estimate(2 / 3, 3)
    assert row.collision == wilson_estimate(1 / 3, 3)
    assert row.timeout.value == 0.0
    assert row.sct is not None
    assert row.sct.value == pytest.approx((1.0 + 0.5 + 0.0) / 3)
    assert row.mean_time.value == pytest.approx(35 / 3)
    assert row.time_lost is not None
    assert row.time_lost_p90 is not None
    assert (row.time_lost.value, row.time_lost_p90.value) == (5.0, 10.0)  # 0 and 10 s: the collision has no time
    assert row.needless_decisions == 2.0
    assert row.needless == wilson_estimate(1.0, 1)
    assert row.hard_brakes == wilson_estimate(1 / 3, 3)
    assert (row.bytes_per_message, row.largest_message) == (300.0, 400)
    assert row.bytes_per_second == pytest.approx(36000 / 35)
    assert row.lost == pytest.approx(9 / 90)  # of three senders in four
    assert row.min_ttc == 0.0
    assert row.success_spread is None


def test_without_the_expert_success_has_no_time_to_be_weighed_by() -> None:
    row = closed_row("dsrc", "left_turn", "stgraph", {0: MINE}, {})
    assert row.sct is row.time_lost is row.time_lost_p90 is None
    assert " | - | - | " in outcome_table([row])


def test_time_lost_stands_beside_the_collisions_of_every_table() -> None:
    row = closed_row("dsrc", "left_turn", "stgraph", {0: MINE}, EXPERT)
    cells = f"| {percent_cell(row.collision)} | {time_cell(row.time_lost)} |"
    assert cells in outcome_table([row])
    assert cells in sweep_table({"0.2": {"stgraph": row}}, "loss")
    head = [title.strip() for title in outcome_table([row]).splitlines()[0].split("|")]
    assert head.index("time lost, s") == head.index("collision %") + 1


def test_training_seeds_are_of_the_same_episodes_in_the_time_lost_too() -> None:
    one, twice = (
        closed_row("dsrc", "left_turn", "stgraph", dict.fromkeys(range(count), MINE), EXPERT) for count in (1, 2)
    )
    assert one.time_lost is not None
    assert one.time_lost == twice.time_lost


def test_other_traffic_is_another_world_than_the_experts(tmp_path: Path) -> None:
    found = found_in(read_run(write_run(tmp_path, ["left_turn"], 20))).sweeps
    known = {value: rows["stgraph"].time_lost is not None for value, rows in found["traffic"]["left_turn"].items()}
    assert known == {"none": False, "light": True, "dense": False}
    assert all(rows["stgraph"].time_lost is not None for rows in found["loss"]["left_turn"].values())


def test_training_seeds_give_a_spread_and_no_narrower_interval() -> None:
    fine = {seed: replace(record, outcome="success") for seed, record in MINE.items()}
    row = closed_row("dsrc", "left_turn", "stgraph", {0: MINE, 1: fine}, EXPERT)
    assert row.success == wilson_estimate(5 / 6, 3)
    assert row.success_spread == (pytest.approx(2 / 3), 1.0)
    assert row.collision_spread == (0.0, pytest.approx(1 / 3))


def test_standing_on_the_brake_is_a_hard_brake_and_rolling_on_is_none() -> None:
    env = CADEnv(scenario="left_turn", radio="none")
    braking, going = (rollout(env, Always(action), 1_000_001) for action in (BRAKE, GO))
    assert braking.hardest_brake == pytest.approx(6.0, abs=0.1)
    assert going.hardest_brake < 4.0
    assert braking.connected == going.connected == 1 + len(env.simulation.agents[1:])


@pytest.mark.parametrize(
    ("ours", "theirs", "verdict"), [(198, 120, "holds"), (120, 198, "opposite"), (120, 121, "open")]
)
def test_an_order_holds_where_intervals_are_apart(ours: int, theirs: int, verdict: str) -> None:
    rows = {name: row_of(name, count, 200) for name, count in (("stgraph", ours), ("collab-gat", theirs))}
    drives = {name: drive for name, (_, drive) in rows.items()}
    (order,) = orders([row for row, _ in rows.values()], drives)
    assert (order.better, order.worse, order.verdict) == ("stgraph", "collab-gat", verdict)
    assert order.advantage.value == pytest.approx((ours - theirs) / 200)
    assert (order.adjusted_p < 0.001) == (verdict != "open")


def test_an_order_is_open_if_training_seeds_disagree() -> None:
    lucky, unlucky, other = (
        row_of("stgraph", 200, 200)[1][0],
        row_of("stgraph", 60, 200)[1][0],
        row_of("gat", 40, 200)[1],
    )
    drives = {"stgraph": {0: lucky, 1: unlucky}, "gat": other, "collab-gat": row_of("collab-gat", 100, 200)[1]}
    rows = [closed_row("dsrc", "left_turn", name, each, {}) for name, each in drives.items()]
    verdicts = {(order.better, order.worse): order.verdict for order in orders(rows, drives)}
    assert verdicts["stgraph", "collab-gat"] == "open"
    assert verdicts["collab-gat", "gat"] == "holds"


def test_every_row_is_compared_on_the_same_episodes_after_holm() -> None:
    rows = {name: row_of(name, count, 100) for name, count in (("stgraph", 99), ("gat", 90), ("ppo", 50))}
    rows["ppo"][1][0].pop(0)  # an episode that is not there
    drives = {name: drive for name, (_, drive) in rows.items()}
    gat, ppo, ours = compared([rows[name][0] for name in ("gat", "ppo", "stgraph")], drives["stgraph"], drives)
    assert ours.test is None
    assert gat.test is not None
    assert (gat.test.first_only, gat.test.second_only) == (9, 0)
    assert gat.adjusted_p == pytest.approx(2 / 2**9)  # the larger of two is as it was
    assert ppo.test is not None
    assert ppo.test.first_only == 49
    assert ppo.advantage is not None
    assert ppo.advantage.value == pytest.approx(49 / 99)


def test_bars_are_judged_by_what_was_measured() -> None:
    ours, expert = row_of("stgraph", 97, 100)[0], row_of("expert", 100, 100)[0]
    large = replace(row_of("compressed", 90, 100)[0], bytes_per_message=33_000.0)
    found = {bar.demand: bar for bar in bars("left_turn", {"dsrc": [ours, expert], "ideal": [large]}, {})}
    assert {demand: bar.met for demand, bar in found.items()} == {
        "collisions at most 1 %": True,
        "success at least 98 %": False,
        "needless brakes in at most 10 % of episodes without a hazard": False,
        "success within 2 points of the expert's": False,
        "mean message at most 600 B": True,
        "messages 100 times smaller than those of compressed": True,
    }
    assert found["messages 100 times smaller than those of compressed"].measured == "110 times"


@pytest.mark.parametrize(("lost", "met"), [(2.0, True), (2.1, False)])
def test_time_lost_has_its_bar(lost: float, met: bool) -> None:
    late = {seed: replace(record, time=10.0 + lost, outcome="success") for seed, record in MINE.items()}
    row = closed_row("dsrc", "left_turn", "stgraph", {0: late}, EXPERT)
    found = {bar.demand: bar.met for bar in bars("left_turn", {"dsrc": [row]}, {})}
    assert found["at most 2 s lost to the expert"] is met


@pytest.mark.parametrize(
    ("collisions", "lost", "met"), [(5, 5.0, False), (6, 0.0, True), (0, 5.1, True), (0, 0.0, False)]
)
def test_a_scene_that_is_passed_with_closed_eyes_is_not_met(collisions: int, lost: float, met: bool) -> None:
    records = {
        k: replace(
            CALM, seed=k, method="best-blind", outcome="collision" if k < collisions else "success", time=10 + lost
        )
        for k in range(100)
    }
    expert = {k: replace(CALM, seed=k, method="expert", time=10.0) for k in records}
    row = closed_row("dsrc", "left_turn", "best-blind", {0: records}, expert)
    (found,) = bars("left_turn", {"dsrc": [row]}, {})
    assert found.demand == "best-blind collides in more than 5 % or loses more than 5 s"
    assert found.met is met


def test_the_papers_rows_agree_with_each_other() -> None:
    twice = {row.method: row.scores for row in TABLE_3}
    assert all(twice.get(row.method, row.scores) == row.scores for row in TABLE_2)
    assert all(len(row.scores) == 2 * len(SCENES) for row in (*TABLE_2, *TABLE_3))
    assert TABLE_2[-1].of("left_turn") == (0.6070, 0.7670)


def test_every_point_of_a_sweep_is_a_run_that_can_be_made() -> None:
    fields = Settings.__dataclass_fields__
    for point in points():
        assert set(point.overrides) <= set(fields)
        settings = Settings(scenario=("left_turn",), method=("expert",), **point.overrides)
        assert job_of(settings, "left_turn", "planner-shared").options["depth"] == point.overrides.get("depth", 15)
    assert len({point.folder for point in points()}) == sum(len(sweep.points) for sweep in SWEEPS.values())


def test_settings_speak_bytes_degrees_and_heads() -> None:
    settings = Settings(scenario=("left_turn",), budget=64, gnss_yaw_noise=180.0, collaborators=3)
    environment = job_of(settings, "left_turn", "planner-shared").options
    assert environment["radio"].budget == pytest.approx(64)
    assert environment["sensor"].gnss_yaw_noise == pytest.approx(np.pi)
    assert environment["ranges"] == {"collaborators": (3, 3)}
    env = CADEnv(**environment)
    env.reset(seed=1)
    assert len(env.simulation.agents) == 4


def test_a_whole_run_has_all_its_parts(tmp_path: Path) -> None:
    text = write_results(write_run(tmp_path, ["left_turn"], 20), "python reproduce.py").read_text()
    assert "Left out" not in text
    for words in ("python reproduce.py", "0.9265 / ", "200 kbit = 25 kB", '"0. 7020"', "| **stgraph** | 3 | 20 |",
                  "radio `ideal`", "stgraph over collab-gat", "Points came out *better*", "2722",
                  "| 0.35 | 0.", "| stgraph | dsrc | 2 | "):  # fmt: skip
        assert words in text, words
    pictures = {path.name for path in (tmp_path / "img").iterdir()}
    swept = {f"sweep_{name}.png" for name in SWEEPS if name not in ("budget", "depth")}
    assert pictures == {"safety_left_turn.png", *swept}
    assert all(f"img/{name}" in text for name in pictures)
    numbers = json.loads((tmp_path / "results.json").read_text())
    assert set(numbers) == {"open", "thresholds", "closed", "orders", "sweeps", "bars", "costs", "commands"}
    assert {row["method"] for row in numbers["closed"]["dsrc"]["left_turn"]} >= {"stgraph", "expert"}


def test_who_needs_another_radio_is_compared_with_the_main_one(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for radio, name, success in (("dsrc", "stgraph", 1.0), ("dsrc", "raw-points", 0.0), ("ideal", "raw-points", 0.4)):
        records = [record("overtaking", name, seed, rng, success, 300) for seed in range(60)]
        write_episodes(tmp_path / "closed" / radio / ("0" if name == "stgraph" else "1"), records)
    found = found_in(read_run(tmp_path))
    (ideal,) = found.closed["ideal"]["overtaking"]
    assert ideal.adjusted_p is not None
    assert ideal.adjusted_p < 0.001
    assert [(order.radio, order.worse, order.verdict) for order in found.orders] == [
        ("dsrc", "raw-points", "holds"), ("ideal", "raw-points", "holds"),
    ]  # fmt: skip


def test_what_is_not_there_is_left_out_with_a_word(tmp_path: Path) -> None:
    text = write_results(tmp_path).read_text()
    assert text.count("Left out") == 7
    assert "sweep of loss, bursts" in text
    assert json.loads((tmp_path / "results.json").read_text())["closed"] == {}


def test_a_run_of_few_rows_is_a_report_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    records = [record("overtaking", "always-go", seed, rng, 0.5) for seed in range(5)]
    write_episodes(tmp_path / "closed" / "dsrc" / "0", records)
    text = write_results(tmp_path).read_text()
    assert "| always-go | 1 | 5 |" in text
    assert "Left out: there is no pair of rows" in text


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    write_closed(tmp_path, training_seeds=1, episodes=2, scenes=["left_turn"])
    (tmp_path / "closed" / "dsrc" / "0" / "episodes.jsonl").write_text("{}\n")
    with pytest.raises(FileError, match=r"episodes.jsonl: line 1: an episode's record must have the keys"):
        read_run(tmp_path)


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("costs.json", b"[" * 3000, "not JSON of at most 64 levels"),
        ("costs.json", b'{"stgraph": {"ms": NaN}}', "stgraph.ms must be a finite number, got nan"),
        ("costs.json", b"\xff", "not JSON: 'utf-8' codec"),
        ("notes.md", b"fine \xff", "not UTF-8 text: byte 5"),
    ],
)
def test_damaged_notes_and_costs_are_named(name: str, data: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FileError, match=f"^{tmp_path / name}: {reason}"):
        read_run(tmp_path)
