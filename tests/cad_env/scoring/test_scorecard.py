"""Records add up to scorecards, and every rate has its interval."""

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from cad_env.checks import ConfigError
from cad_env.scoring.interval import wilson
from cad_env.scoring.scorecard import OUTCOMES, Record, parse_record, scorecards
from cad_env.scoring.table import table

CALM = Record("left_turn", "expert", 1, False, "success", 10.0, 0, 200.0, 300, 10, 1, 2000, None, None, 4, 0.0)
CRASH = replace(CALM, seed=2, hazard=True, outcome="collision", time=5.0, brakes=3, min_ttc=0.1, hazard_time=5.0)
STUCK = replace(CALM, seed=3, outcome="timeout", time=40.0, brakes=400, bytes_total=4000, bytes_per_message_max=500)


def records() -> st.SearchStrategy[Record]:
    count, amount = st.integers(0, 10**6), st.floats(0.0, 1e6)
    return st.builds(
        Record, st.just("left_turn"), st.sampled_from(["expert", "always-go"]), count, st.booleans(),
        st.sampled_from(OUTCOMES), amount, count, st.none() | amount, st.none() | count, count, count, count,
        st.none() | amount, st.none() | amount, count, amount,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("count", "of", "low", "high"),
    [(50, 500, 0.07668, 0.12942), (10, 100, 0.05523, 0.17437), (0, 10, 0.0, 0.27753), (10, 10, 0.72247, 1.0)],
)
def test_wilson_gives_the_known_intervals(count: int, of: int, low: float, high: float) -> None:
    assert wilson(count, of) == pytest.approx((low, high), abs=5e-6)


@given(st.integers(1, 1000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_a_rate_lies_in_its_interval_which_narrows_with_more_episodes(pair: tuple[int, int]) -> None:
    count, of = pair
    low, high = wilson(count, of)
    assert 0.0 <= low <= count / of <= high <= 1.0
    more_low, more_high = wilson(4 * count, 4 * of)
    assert more_high - more_low < high - low
    assert (low, high) == tuple(binomtest(count, of).proportion_ci(method="wilson"))


@given(records())
def test_a_record_survives_its_line(record: Record) -> None:
    line = record.line()
    assert "\n" not in line
    assert parse_record(line) == record


@pytest.mark.parametrize("change", [
    {"seed": -1}, {"seed": 1.5}, {"seed": True}, {"hazard": 1}, {"outcome": "crash"}, {"outcome": None},
    {"outcome": []}, {"time": -0.1}, {"time": "9"}, {"time": None}, {"brakes": None}, {"bytes_per_message_mean": "x"},
    {"bytes_per_message_max": 1.5}, {"min_ttc": -1}, {"scenario": 3}, {"method": None}, {"messages_lost": "0"},
    {"scenario": "\ud800"}, {"method": "a\udce8"},
    {"time": 10**400}, {"brakes": 10**400}, {"bytes_total": 2**53 + 1}, {"hardest_brake": 1e300}, {"min_ttc": 10**309},
    {"hazard_time": "0"}, {"connected": 1.5}, {"connected": None}, {"hardest_brake": -1.0}, {"hardest_brake": None},
    {"hazard_time": -0.1},
])  # fmt: skip
def test_an_altered_record_is_refused_with_the_name_of_what_is_wrong(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=f"cannot have {next(iter(change))} ") as caught:
        parse_record(json.dumps({**json.loads(CALM.line()), **change}))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "line", ["", "null", "7", "[]", "{}", CALM.line()[:-9], CALM.line().replace("time", "tyme"), "[" * 5000,
             CALM.line().replace("10.0", "NaN"), CALM.line().replace("10.0", "Infinity")],
)  # fmt: skip
def test_what_is_no_record_is_refused_in_one_line(line: str) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        parse_record(line)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", [0, 2**63, 2**128 - 1, 10**400])
def test_a_seed_of_any_size_survives_its_line(seed: int) -> None:
    assert parse_record(replace(CALM, seed=seed).line()).seed == seed


def test_the_largest_numbers_add_up() -> None:
    most = 2**53
    loud = replace(CALM, time=most, bytes_total=most, messages_sent=most, bytes_per_message_max=most, min_ttc=most)
    row = scorecards([loud, replace(loud, seed=2)])[0]
    assert (row.mean_time, row.bytes_per_message_mean) == (most, 1.0)
    json.dumps(vars(row), allow_nan=False)


def test_a_key_that_comes_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match="'seed' comes twice"):
        parse_record(CALM.line()[:-1] + ', "seed": 2}')


def test_rows_count_what_happened() -> None:
    everything, hazard, calm = scorecards([CALM, CRASH, STUCK])
    assert [row.hazard for row in (everything, hazard, calm)] == ["all", "yes", "no"]
    assert (everything.episodes, everything.collisions, everything.successes, everything.timeouts) == (3, 1, 1, 1)
    assert everything.collision_rate == pytest.approx(1 / 3)
    assert (everything.collision_low, everything.collision_high) == wilson(1, 3)
    assert (everything.mean_time, everything.mean_time_success) == (pytest.approx(55.0 / 3.0), 10.0)
    assert (hazard.mean_time, hazard.mean_time_success) == (5.0, None)
    assert (everything.bytes_per_message_mean, everything.bytes_per_message_max) == (8000 / 30, 500)
    assert everything.bytes_per_second == pytest.approx(8000 / 55)
    assert everything.min_ttc == 0.1
    assert calm.min_ttc is None


def test_the_time_of_successes_has_the_interval_of_a_mean() -> None:
    calm = scorecards([CALM, replace(CALM, seed=4, time=12.0), replace(CALM, seed=5, time=14.0), STUCK])[1]
    assert (calm.hazard, calm.mean_time_success) == ("no", 12.0)
    half = 1.959964 * 2.0 / 3**0.5
    assert (calm.mean_time_success_low, calm.mean_time_success_high) == pytest.approx((12.0 - half, 12.0 + half))
    crashed = scorecards([CRASH])[0]
    assert crashed.mean_time_success is crashed.mean_time_success_low is crashed.mean_time_success_high is None


def test_conditions_are_groups_of_their_own_each_with_its_expert() -> None:
    late = replace(CALM, method="mine", time=13.0)
    some = [CALM, late, replace(CALM, condition="dense", time=12.0), replace(late, condition="dense")]
    rows = [row for row in scorecards(some) if row.hazard == "all"]
    assert [(row.condition, row.method, row.time_lost) for row in rows] == [
        (None, "expert", 0.0), (None, "mine", 3.0), ("dense", "expert", 0.0), ("dense", "mine", 1.0),
    ]  # fmt: skip
    alone = scorecards([replace(late, condition="dense")], expert=[CALM, replace(CALM, condition="dense", time=12.0)])
    assert alone[0].time_lost == 1.0
    parts = table(rows).split("\n\n")
    assert [part.splitlines()[0].split()[0] for part in parts] == ["scenario", "condition:", "scenario"]
    assert parts[1] == "condition: dense"


def test_a_line_names_its_condition_only_if_there_is_one() -> None:
    assert "condition" not in json.loads(CALM.line())
    named = replace(CALM, condition="alone")
    assert json.loads(named.line())["condition"] == "alone"
    assert parse_record(named.line()) == named
    with pytest.raises(ValueError, match="cannot have condition 3"):
        parse_record(named.line().replace('"alone"', "3"))


def test_braking_is_needless_only_where_there_is_no_hazard() -> None:
    everything, hazard, calm = scorecards([CALM, CRASH, STUCK])
    assert everything.needless_brakes is hazard.needless_brakes is None
    assert calm.needless_brakes == 0.5
    assert (calm.needless_low, calm.needless_high) == wilson(1, 2)


def test_silence_has_no_bytes_per_message() -> None:
    silent = replace(CALM, messages_sent=0, bytes_total=0, bytes_per_message_mean=None, bytes_per_message_max=None)
    row = scorecards([silent])[0]
    assert row.bytes_per_message_mean is row.bytes_per_message_max is None
    assert row.bytes_per_second == 0.0


@given(st.lists(records(), max_size=20))
def test_rows_with_and_without_hazard_add_up_to_all(some: list[Record]) -> None:
    rows = scorecards(some)
    assert sum(row.episodes for row in rows if row.hazard == "all") == len(some)
    for row in rows:
        assert row.collisions + row.successes + row.timeouts == row.episodes > 0
        parts = [part for part in rows if part.method == row.method and part.hazard != "all"]
        if row.hazard == "all":
            for name in ("episodes", "collisions", "successes", "timeouts", "messages_sent", "messages_lost"):
                assert sum(getattr(part, name) for part in parts) == getattr(row, name)
    json.dumps([vars(row) for row in rows], allow_nan=False)


def test_the_order_of_episodes_does_not_matter() -> None:
    assert scorecards([CALM, CRASH, STUCK]) == scorecards([STUCK, CRASH, CALM])


def test_the_table_gives_per_cents_with_interval_and_number() -> None:
    lines = table(scorecards([CALM, CRASH, STUCK])).splitlines()
    assert lines[0].split()[:4] == ["scenario", "method", "hazard", "episodes"]
    assert lines[2].split()[:4] == ["left_turn", "expert", "all", "3"]
    assert "33.3 [ 6.1, 79.2]" in lines[2]
    assert len(lines) == 5
    assert max(map(len, lines)) == len(lines[1])


def test_each_scenario_has_a_table_of_its_own_with_the_same_columns() -> None:
    elsewhere = replace(CALM, scenario="a_scenario_with_a_long_name")
    first, second = table(scorecards([CALM, elsewhere])).split("\n\n")
    assert first.splitlines()[:2] == second.splitlines()[:2]
    assert first.splitlines()[2].startswith("left_turn ")
    assert second.splitlines()[2].startswith("a_scenario_with_a_long_name ")
