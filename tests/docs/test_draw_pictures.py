"""The pictures of the docs: written into an empty folder, small, and showing what they are to show."""

from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from scenes import started

from cad_env.envs.single import CADEnv
from cad_env.rendering.canvas import Tag
from cad_env.rendering.danger import danger, only_told
from cad_env.rendering.viewer import picture
from cad_env.scenarios import SHIPPED
from cad_env.types import GO
from docs.draw_pictures import cast, main, tells, write_drawing

IMAGES = Path(__file__).parents[2] / "docs" / "img"


@pytest.mark.parametrize("scenario", SHIPPED)
def test_each_scene_has_a_drawing(scenario: str, tmp_path: Path):
    path = write_drawing(scenario, tmp_path)
    assert path.name == f"{scenario}.png"
    assert path.stat().st_size < 150_000
    with PIL.Image.open(path) as drawing:
        assert np.asarray(drawing.convert("RGB")).std() > 5.0


@pytest.mark.slow
def test_the_gallery_writes_all_pictures_into_a_new_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["--out", str(tmp_path / "img")]) == 0
    names = {path.name for path in (tmp_path / "img").iterdir()}
    assert names == {"alone_or_sharing.gif", *(f"{name}.png" for name in SHIPPED)}
    assert (tmp_path / "img" / "alone_or_sharing.gif").stat().st_size < 1_500_000
    assert capsys.readouterr().out.count("kB") == len(names)


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "file").write_text("in the way")
    assert main(["--out", str(tmp_path / "file")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1


def test_the_telling_moment_is_when_the_ego_is_blind_and_told():
    told, alone = started(1_000_023, hazard=True), started(1_000_023, hazard=True, radio="none")
    row, moments = told.scene.hazard_row, 0
    for _ in range(45):
        for simulation in (told, alone):
            simulation.step(np.full(len(simulation.agents), GO))
        assert not tells(alone)
        if tells(told):
            moments += 1
            assert not told.fleet.visible[0, row]
            assert only_told(told, row)
    assert moments > 5


@pytest.mark.parametrize("scenario", SHIPPED)
def test_without_a_hazard_there_is_nothing_to_tell_and_no_word(scenario: str):
    env = CADEnv(scenario=scenario)
    env.reset(seed=1_000_023, options={"hazard": False})
    for _ in range(30):
        env.step(GO)
    assert env.simulation.scene.hazard_row == -1
    assert not tells(env.simulation)
    assert (picture(env, (cast, danger)) == picture(env)).all()
    env.close()


def test_the_word_is_beside_the_vehicle_that_would_hit_the_ego():
    env = CADEnv()
    env.reset(seed=1_000_023, options={"hazard": True})
    world, row = env.simulation.world, env.simulation.scene.hazard_row
    assert row in env.simulation.scene.hidden
    places: list[np.ndarray] = []

    class Noted:
        def label_beside(self, place: np.ndarray, tag: Tag) -> None:
            places.append(place.copy())
            assert place.tolist() == world.position[row].tolist()

    for _ in range(30):
        env.step(GO)
        danger(env.simulation, Noted())
    assert len(places) > 5
    env.close()


def test_the_gallery_in_the_docs_is_there():
    assert {path.name for path in IMAGES.iterdir()} >= {"alone_or_sharing.gif", "left_turn.png"}
