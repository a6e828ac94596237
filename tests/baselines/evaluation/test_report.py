"""The page that people read holds what was measured, and needs nothing else."""

import json
import random
from base64 import b64decode
from collections.abc import Iterable
from dataclasses import replace
from html.parser import HTMLParser
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import pytest

import evaluate
from baselines.evaluation import report
from baselines.evaluation.report import write_report
from baselines.evaluation.report.plots import all_plots
from baselines.evaluation.store import gif_of
from baselines.methods import METHODS, SHIPPED_METHODS
from cad_env.scoring.scorecard import Record, scorecards
from cad_env.scoring.table import cells_of

SCENES = ("left_turn", 'a <b> & "c"')
SETTINGS = {
    "scenario": list(SCENES), "method": list(SHIPPED_METHODS), "episodes": 40, "first_seed": 1_000_000,
    "radio": {"rate": "2000000.0", "loss": "0.05"}, "version of cad_env": "0123abcd", "command": "python <evaluate> &",
}  # fmt: skip


class Page(HTMLParser):
    """What a reader gets: the text, the pictures, and everything the page would fetch."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.text, self.open, self.links, self.images = "", list[str](), list[str](), dict[str, str]()
        self.feed(path.read_text())
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag not in ("meta", "img", "link", "br"):
            self.open.append(tag)
        if tag == "img":
            self.images[values["alt"] or ""] = values["src"] or ""
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += " " + data


def some_records(
    scenes: Iterable[str] = SCENES, methods: Iterable[str] = SHIPPED_METHODS, share: float = 0.5
) -> list[Record]:
    """40 episodes each with outcomes by chance; `share` of them with a hazard."""
    chance = random.Random(1)
    bare = Record("", "", 0, False, "success", 9.0, 0, None, None, 0, 0, 0, None, None, 0, 0.0)
    records = []
    for scene, name, seed in product(scenes, methods, range(40)):
        sent, hazard = 100 + seed if METHODS[name].shares else 0, chance.random() < share
        record = replace(
            bare, scenario=scene, method=name, seed=seed, hazard=hazard, messages_sent=sent, bytes_total=250 * sent,
            bytes_per_message_mean=250.0 if sent else None, bytes_per_message_max=480 if sent else None,
            hazard_time=chance.uniform(-1.0, 1.0) if hazard else None, min_ttc=chance.random(),
            outcome=chance.choice(["success", "collision", "timeout"]),
        )  # fmt: skip
        records.append(record)
    return records


def few_records(share: float = 0.5) -> list[Record]:
    return some_records(["left_turn"], ["expert", "stgraph"], share)


def written(folder: Path, records: list[Record]) -> Path:
    (folder / "settings.json").write_text(json.dumps(SETTINGS))
    (folder / "episodes.jsonl").write_text("".join(record.line() + "\n" for record in records))
    return write_report(folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of all methods in three scenes, with a report."""
    folder = tmp_path_factory.mktemp("results")
    written(folder, some_records())
    return folder


def test_every_method_and_number_of_the_table_is_on_the_page(folder: Path) -> None:
    text = Page(folder / "report.html").text
    for row in scorecards(some_records()):
        for cell in cells_of(row)[1:]:
            assert cell in text
    assert all(method.knows in text for method in (METHODS[name] for name in SHIPPED_METHODS))
    assert not Page(folder / "report.html").open


def test_the_page_says_what_was_run(folder: Path) -> None:
    text = Page(folder / "report.html").text
    for said in ("python <evaluate> &", "1000000 to 1000039", "rate 2 Mbit/s, loss 0.05", "0123abcd"):
        assert said in text
    assert 'a <b> & "c"' in text


def test_the_page_fetches_nothing(folder: Path) -> None:
    page = Page(folder / "report.html")
    assert all(link.startswith("data:") for link in page.links)
    assert "http" not in (folder / "report.html").read_text().lower()
    assert "url(" not in (folder / "report.html").read_text()


def test_the_plots_are_there_with_titles_and_captions(folder: Path) -> None:
    page = Page(folder / "report.html")
    assert list(page.images) == [
        "Collisions", "Successes", "Safety against bytes on the air", "Collisions against hazard time",
    ]  # fmt: skip
    for title, source in page.images.items():
        kind, data = source.split(",")
        assert kind == "data:image/svg+xml;base64"
        assert ElementTree.fromstring(b64decode(data)).tag.endswith("svg")
        assert title in page.text


def test_the_same_results_give_the_same_page(tmp_path: Path) -> None:
    first = written(tmp_path, few_records()).read_bytes()
    assert written(tmp_path, few_records()).read_bytes() == first


def test_a_point_moves_with_its_rate() -> None:
    some = few_records()
    other = [replace(record, outcome="success") for record in some]
    pairs = zip(all_plots(scorecards(some), some, {}), all_plots(scorecards(other), other, {}), strict=True)
    assert all(before.svg != after.svg for before, after in pairs)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_runs_of_one_kind_of_episode_have_a_page_too(share: float, tmp_path: Path) -> None:
    page = Page(written(tmp_path, few_records(share)))
    assert ("Collisions against hazard time" in page.images) == (share > 0.0)


def test_silence_needs_no_plot_of_bytes(tmp_path: Path) -> None:
    silent = [record for record in few_records() if not record.messages_sent]
    assert "Safety against bytes on the air" not in Page(written(tmp_path, silent)).images


def test_animations_are_in_the_page_as_far_as_they_fit_the_telling_ones_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gifs").mkdir()
    some = some_records(["left_turn"], ["always-go", "expert"])
    for record in some[3:5] + some[40:]:
        gif_of(tmp_path, record).write_bytes(b"GIF89a" + bytes(94))
    monkeypatch.setattr(report, "ROOM", 450)
    page = Page(written(tmp_path, some))
    shown = [name for name, source in page.images.items() if source.startswith("data:image/gif;base64,")]
    kinds = [f"left turn, expert: {outcome}, a hazard" for outcome in ("collision", "success", "timeout")]
    assert [name.partition(", seed")[0] for name in shown] == [*kinds, "left turn, expert: collision, no hazard"]
    assert "38 more" in page.text


def test_the_command_writes_a_report_that_names_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    some = ["--scenario", "left_turn", "--method", "always-go", "--episodes", "2", "--hazard", "yes"]
    assert evaluate.main([*some, "--out", str(tmp_path)]) == 0
    assert str(tmp_path / "report.html") in capsys.readouterr().out
    page = Page(tmp_path / "report.html")
    assert "python evaluate.py --scenario left_turn --method always-go --episodes 2 --hazard yes" in page.text
    assert "Collisions against hazard time" in page.images  # so the timing of a hazard comes from the scene


def test_the_command_animates_an_episode_of_each_kind(tmp_path: Path) -> None:
    some = ["--scenario", "left_turn", "--method", "always-go", "--episodes", "2", "--hazard", "yes", "--gif", "1"]
    assert evaluate.main([*some, "--out", str(tmp_path)]) == 0
    assert [path.name for path in (tmp_path / "gifs").iterdir()] == ["left_turn_always-go_collision_1000000.gif"]
    assert "left turn, always-go: collision, a hazard, seed 1000000" in Page(tmp_path / "report.html").images


def test_the_page_says_what_a_method_from_outside_knows(tmp_path: Path) -> None:
    name = "my_policy:Mine(seconds=1.0)"
    records = [replace(record, method=name) for record in few_records() if record.method == "expert"]
    settings = {**SETTINGS, "method": [name], f"knowledge of {name}": "what it sees"}
    (tmp_path / "settings.json").write_text(json.dumps(settings))
    (tmp_path / "episodes.jsonl").write_text("".join(record.line() + "\n" for record in records))
    assert "knows what it sees" in Page(write_report(tmp_path)).text
