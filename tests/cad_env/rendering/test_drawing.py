"""Pictures: what is shaded, who sees what, and that looking at an episode never changes it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from patience import PATIENCE
from scenes import boxes, digest, started
from shapely.geometry import Point, Polygon

from cad_env.envs.parallel import parallel_env
from cad_env.envs.single import CADEnv
from cad_env.pipeline.radio import LOST, OUT_OF_RANGE, REACHES
from cad_env.rendering.canvas import Canvas
from cad_env.rendering.framing import focus, screen
from cad_env.rendering.layers import (
    DECISIONS,
    EGO_COLOUR,
    EGO_SEES,
    LAYERS,
    LINK_COLOUR,
    LOST_COLOUR,
    NOBODY_SEES,
    OTHERS_SEE,
    SEEN_COLOURS,
    known,
    sight,
    who_sees,
)
from cad_env.rendering.legend import WIDTH
from cad_env.rendering.sight import in_sight, sensor_of
from cad_env.rendering.viewer import picture
from cad_env.scenarios import SCENARIOS
from cad_env.simulation.simulation import Simulation
from cad_env.types import BRAKE, GO, TRUCK
from cad_env.world.geometry import box_hides
from cad_env.world.state import World

REACH = 80.0  # m
AHEAD, BEHIND_TRUCK = (25.0, 0.0), (60.0, 0.0)


def truck_ahead() -> World:
    """The ego in the origin, heading east; a truck 40 m before it, and a car behind that."""
    world = boxes((0.0, 0.0, 0.0), (40.0, 0.0, 0.0, 12.0, 2.5), (60.0, 0.0, 0.0))
    world.kind[1] = TRUCK
    return world


def staged(world: World, **options) -> Simulation:
    """A simulation whose vehicles stand where a hand-made world has them; its first row is the ego, all are there."""
    simulation = started(1, **options)
    for name in ("position", "heading", "size", "kind", "driver"):
        part = getattr(simulation.world, name)
        part[: len(world.speed)] = getattr(world, name)
        if name == "driver":
            part[len(world.speed) :] = 0
    return simulation


def looking(simulation: Simulation, layer=None) -> Canvas:
    """White paper 160 m wide around the ego, 8 pixels a metre, with a layer on it."""
    canvas = Canvas(1280, 1280)
    canvas.look_at(np.zeros(2), (0.5, 0.5), 8.0)
    canvas.surface.fill((255, 255, 255))
    if layer is not None:
        layer(simulation, canvas)
    return canvas


def colour_at(canvas: Canvas, place: tuple[float, float]) -> tuple[int, ...]:
    x, y = canvas.pixels(np.array(place))
    return tuple(canvas.surface.get_at((int(x), int(y))))[:3]


def near(image: np.ndarray, colour: tuple[int, ...], within: int = 12) -> np.ndarray:
    """(H, W) where a picture has a colour."""
    return (np.abs(image.astype(int) - colour) <= within).all(axis=-1)


def test_the_ground_behind_a_truck_is_shaded_and_that_before_it_is_not():
    canvas = looking(staged(truck_ahead()), sight)
    assert colour_at(canvas, AHEAD) == (255, 255, 255)
    assert max(colour_at(canvas, (50.0, 0.0))) < 180
    assert colour_at(canvas, (50.0, 20.0)) == (255, 255, 255)


def test_beyond_the_range_of_the_sensor_all_is_shaded():
    canvas = looking(staged(truck_ahead(), sensor={"range": 30.0}), sight)
    assert colour_at(canvas, (-25.0, 0.0)) == (255, 255, 255)
    assert max(colour_at(canvas, (-35.0, 0.0))) < 180


def test_what_is_in_sight_is_what_no_box_hides():
    rng = np.random.default_rng(3)
    for _ in range(20):
        spots = [(*rng.uniform(-60, 60, 2), rng.uniform(-4, 4), rng.uniform(4, 15), 2.5) for _ in range(8)]
        world = boxes((0.0, 0.0, rng.uniform(-4, 4)), *(spot for spot in spots if np.hypot(*spot[:2]) > 12))
        polygon, sensor = Polygon(in_sight(world, 0, REACH)), sensor_of(world, 0)
        turns = np.stack([np.cos(world.heading), np.sin(world.heading)], axis=-1)
        assert polygon.is_valid
        for place in rng.uniform(-90, 90, (100, 2)):
            hidden = any(
                box_hides(*sensor, *place, *world.position[k], *turns[k], *world.size[k])
                for k in range(1, len(world.speed))
            )
            free = not hidden and np.hypot(*(place - sensor)) <= REACH
            if polygon.exterior.distance(Point(place)) > 0.01:  # on the very edge it may be either
                assert polygon.contains(Point(place)) == free


def test_a_sensor_inside_another_vehicle_sees_no_ground():
    world = boxes((0.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    assert np.ptp(in_sight(world, 0, REACH), axis=0).max() == pytest.approx(0.0)


def test_vehicles_have_the_colour_of_who_sees_them():
    simulation = staged(truck_ahead())
    visible = simulation.fleet.visible
    visible[:] = False
    visible[0, 1] = visible[1:, 2] = True
    simulation.agents[1:] = 1  # the truck is the only connected vehicle besides the ego
    assert who_sees(simulation)[:3].tolist() == [EGO_SEES, EGO_SEES, OTHERS_SEE]
    canvas = looking(simulation, known)
    assert colour_at(canvas, (-1.9, 0.6)) == EGO_COLOUR
    assert colour_at(canvas, (36.0, 0.8)) == SEEN_COLOURS[EGO_SEES]
    assert colour_at(canvas, (58.5, 0.7)) == SEEN_COLOURS[OTHERS_SEE]
    visible[1:, 2] = False
    assert who_sees(simulation)[2] == NOBODY_SEES
    assert colour_at(looking(simulation, known), (58.5, 0.7)) == SEEN_COLOURS[NOBODY_SEES]


def test_a_connected_vehicle_that_nobody_sees_knows_of_itself():
    simulation = started(1)
    simulation.fleet.visible[:] = False
    assert (who_sees(simulation)[simulation.agents[1:]] == OTHERS_SEE).all()


def test_arrivals_are_what_the_radio_delivered():
    simulation = started(1, radio={"loss": 0.3, "delay": 0.2})
    seen = set()
    for _ in range(30):
        simulation.step(np.full(len(simulation.agents), GO))
        ends = [simulation.arrival(sender, 0) for sender in range(1, len(simulation.agents))]
        report = simulation.fleet.report
        assert sum(size for end, size in ends if end == REACHES) == report.received_bytes[0]
        assert sum(end == LOST for end, _ in ends) == report.lost[0]
        seen |= {end for end, _ in ends}
    assert {REACHES, LOST} <= seen
    assert started(1, radio={"range": 1.0, "loss": 0.0}).arrival(1, 0)[0] == OUT_OF_RANGE


def picture_of(seed: int, *layers: str, steps: int = 0, action: int = GO, **options) -> np.ndarray:
    env = CADEnv(layers=layers, **options)
    env.reset(seed=seed, options={"hazard": True})
    for _ in range(steps):
        env.step(action)
    return picture(env)


def test_a_lost_message_is_a_broken_link_in_another_colour():
    for loss, there, absent in ((0.0, LINK_COLOUR, LOST_COLOUR), (1.0, LOST_COLOUR, LINK_COLOUR)):
        drawn = picture_of(2, "links", steps=3, radio={"loss": loss})[:, int(WIDTH) + 20 :]
        assert near(drawn, there).sum() > 50
        assert near(drawn, absent).sum() == 0


def test_without_a_radio_there_are_no_links():
    drawn = picture_of(2, "links", steps=3, radio="none")[:, int(WIDTH) + 20 :]
    assert near(drawn, LINK_COLOUR).sum() == near(drawn, LOST_COLOUR).sum() == 0


def test_received_tracks_have_the_colour_of_others():
    """Of what the ego does not see itself, trails appear only with a radio."""
    told, untold = (near(picture_of(23, "tracks", steps=40, radio=radio), SEEN_COLOURS[OTHERS_SEE])
                    for radio in ("dsrc", "none"))  # fmt: skip
    assert told[:500].sum() > untold[:500].sum() + 20


def test_the_decision_is_written_in_its_colour():
    for action, (_, colour) in zip((GO, BRAKE), DECISIONS, strict=True):
        drawn = picture_of(1, "outcome", steps=1, action=action)
        assert near(drawn[5:35, 8:60], colour).sum() > 100


@pytest.mark.parametrize("layer", LAYERS)
def test_each_layer_changes_the_picture_and_only_where_it_draws(layer: str):
    env = CADEnv()
    env.reset(seed=1_000_023, options={"hazard": True})
    for _ in range(35):
        env.step(GO)

    def drawn(*layers: str) -> np.ndarray:
        env.config["layers"] = layers
        image = picture(env).astype(int)
        image[:, : int(WIDTH) + 20][500:] = 0  # the legend speaks of the layers that are drawn
        return image

    change = np.abs(drawn(layer) - drawn()).max(axis=-1) > 0
    assert change.any()
    if layer != "sight":  # which covers what is hidden, most of the picture
        assert change.mean() < 0.1
    env.close()


@pytest.mark.parametrize("layers", [("sight", "x-ray"), "sight", 3, (1,)])
def test_an_unknown_layer_is_refused_with_one_line(layers):
    for make in (CADEnv, parallel_env):
        with pytest.raises(ValueError, match="layer") as refusal:
            make(layers=layers)
        assert "\n" not in str(refusal.value)


def test_looking_changes_no_episode(monkeypatch):
    unseen = digest(5, count=40)

    def watched(self, action, step=CADEnv.step):
        result = step(self, action)
        picture(self)
        return result

    monkeypatch.setattr(CADEnv, "step", watched)
    assert digest(5, count=40) == unseen


def test_the_ego_stays_in_the_picture_wherever_it_is():
    simulation, view = started(1), np.array([110.0, 110.0])
    for place in ((0.0, -10.0), (1.75, -52.0), (1.75, -180.0), (-200.0, 1.75)):
        simulation.world.position[0] = place
        assert (np.abs(place - focus(simulation, view)) < 0.5 * view).all()
    simulation.world.position[0] = 1.75, -40.0
    assert focus(simulation, view).tolist() == [0.0, 0.0]  # a junction stays in the middle


def test_along_a_road_that_fits_the_picture_follows_the_ego_and_across_it_shows_the_middle():
    simulation, view = started(1, scenario="overtaking"), np.array([166.0, 46.0])
    for place in ((-80.0, -1.75), (10.0, 1.75)):
        simulation.world.position[0] = place
        assert focus(simulation, view).tolist() == [place[0], 0.0]


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scene_has_a_picture_that_holds_its_ego(name: str):
    env = CADEnv(scenario=name, render_mode="rgb_array")
    env.reset(seed=3)
    image = env.render()
    size = screen(SCENARIOS[name].map)
    assert image.shape == (size["screen_height"], size["screen_width"], 3)
    assert image.std() > 5.0
    assert near(image, EGO_COLOUR).sum() > 20
    env.close()


def test_screen_settings_are_the_user_s():
    env = CADEnv(scenario="left_turn", config={"screen_width": 300, "screen_height": 200, "scaling": 2.0})
    env.reset(seed=0)
    assert picture(env).shape == (200, 300, 3)
    env.close()


def test_every_agent_s_environment_shows_the_layers_too():
    whole, bare = (parallel_env(render_mode="rgb_array", layers=layers) for layers in (tuple(LAYERS), ()))
    for env in (whole, bare):
        env.reset(seed=0)
    assert (whole.render() != bare.render()).any()
    whole.close()
    assert bare.render().std() > 5.0  # the one that was closed takes nothing from the other
    bare.close()


def test_a_window_shows_the_same_picture():
    """In a process of its own, for pygame chooses how to show windows once."""
    code = """
import numpy as np, pygame
from cad_env.envs.single import CADEnv
from cad_env.rendering.viewer import picture
env, unseen = CADEnv(render_mode="human"), CADEnv()
for each in (env, unseen):
    each.reset(seed=1)
    each.step(0)
shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
assert (shown == picture(unseen)).all() and shown.std() > 5
env.close()
"""
    here = {**os.environ, "SDL_VIDEODRIVER": "dummy"}
    subprocess.run([sys.executable, "-c", code], check=True, env=here, timeout=PATIENCE)


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="there a display needs no name")
@pytest.mark.parametrize(("chosen", "driver"), [(None, "dummy"), ("offscreen", "offscreen")])
def test_without_a_display_nothing_looks_for_one_and_the_users_choice_stays(chosen: str | None, driver: str):
    """In a process of its own, as above."""
    code = """
import os, pygame
from cad_env.envs.single import CADEnv
chosen = os.environ.get("SDL_VIDEODRIVER")
env = CADEnv(render_mode="rgb_array", config={"screen_width": 200, "screen_height": 200, "scaling": 2.0})
env.reset(seed=1)
assert env.render().std() > 5
assert os.environ.get("SDL_VIDEODRIVER") == chosen
print(pygame.display.get_driver())
env.close()
"""
    unset = ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER")
    here = {name: value for name, value in os.environ.items() if name not in unset}
    here |= {"SDL_VIDEODRIVER": chosen} if chosen else {}
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, env=here, timeout=PATIENCE, capture_output=True, text=True
    )
    assert done.stdout.split()[-1] == driver
    assert "XDG_RUNTIME_DIR" not in done.stderr
