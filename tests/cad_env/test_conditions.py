"""A name means the same wherever it is printed: what each condition sets, and that an environment takes it."""

import re
from typing import Any

import pytest

from cad_env.conditions import CONDITIONS, Condition, condition_named
from cad_env.config import POSE_PRESETS, RadioConfig, SensorConfig, radio_config
from cad_env.scenarios import SCENARIOS
from cad_env.simulation.setup import setup_from
from cad_env.simulation.simulation import Simulation

USUAL = {"traffic": "light"} | dict.fromkeys(("penetration", "collaborators", "loss", "burst", "delay"))
SETS = {
    "nominal": {},
    "alone": {"penetration": 0.0},
    "penetration-05": {"penetration": 0.05},
    "penetration-10": {"penetration": 0.1},
    "penetration-25": {"penetration": 0.25},
    "penetration-50": {"penetration": 0.5},
    "penetration-100": {"penetration": 1.0},
    "loss-40": {"loss": 0.4},
    "loss-70": {"loss": 0.7},
    "bursts-40": {"loss": 0.4, "burst": 5.0},
    "delay-300": {"delay": 0.3},
    "delay-500": {"delay": 0.5},
    "one-collaborator": {"collaborators": 1},
    "dense": {"traffic": "dense"},
    "dense-penetration-10": {"traffic": "dense", "penetration": 0.1},
    "gnss-white-1m": {"pose": "white"},
    "gnss-standard": {"pose": "standard"},
    "gnss-urban": {"pose": "urban"},
    "gnss-denied": {"pose": "denied"},
    "false-alarms": {"false_alarm": 0.1},
    "partial-views": {"partial": 1.0},
    "urban-everything": {"penetration": 0.5, "loss": 0.2, "delay": 0.2, "pose": "urban", "false_alarm": 0.1},
}


def test_each_condition_sets_what_its_name_says_and_nothing_else():
    assert {name: each.settings for name, each in CONDITIONS.items()} == {
        name: {**USUAL, **values} for name, values in SETS.items()
    }
    assert all(name == each.name and each.reason for name, each in CONDITIONS.items())


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_nominal_is_every_default(scenario: str):
    assert setup_from({"scenario": scenario, **CONDITIONS["nominal"].options(radio_config("dsrc"))}) == setup_from(
        {"scenario": scenario}
    )


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("name", CONDITIONS)
def test_an_environment_meets_what_is_set(name: str, scenario: str):
    condition = CONDITIONS[name]
    simulation = Simulation(setup_from({"scenario": scenario, **condition.options(radio_config("cv2x"))}))
    found = []
    for seed in range(4):
        simulation.start(seed)
        found.append(len(simulation.agents))
    assert simulation.setup.traffic == condition.traffic
    assert simulation.setup.pose == POSE_PRESETS[SETS[name].get("pose", "exact")]
    assert simulation.setup.sensor == SensorConfig(
        false_alarm=SETS[name].get("false_alarm", 0.0), partial=SETS[name].get("partial", 0.0)
    )
    radio = simulation.setup.radio
    assert radio.rate == radio_config("cv2x").rate
    assert (radio.loss, radio.burst, radio.delay) == tuple(
        usual if (value := SETS[name].get(each)) is None else value
        for each, usual in (("loss", 0.05), ("burst", 1.0), ("delay", 0.0))
    )
    if name == "alone":
        assert set(found) == {1}
    if name == "one-collaborator":
        assert set(found) == {2}
    if name == "penetration-100":
        assert found == [len(_eligible(simulation, seed)) for seed in range(4)]
    assert min(found) > 1 or not condition.has_witness


def _eligible(simulation: Simulation, seed: int) -> set[int]:
    simulation.start(seed)
    return set(range(len(simulation.scene.placements))) - set(simulation.scene.hidden)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({}, "light traffic; a witness is always connected"),
        ({"traffic": "none", "collaborators": 0}, "no traffic; nobody but the ego is connected"),
        ({"penetration": 0.0}, "light traffic; nobody but the ego is connected"),
        ({"penetration": 0.05}, "light traffic; each vehicle connected by itself with probability 0.05"),
        ({"collaborators": 1}, "light traffic; a witness is always connected, 1 collaborator in all"),
        ({"loss": 0.4, "burst": 5}, "light traffic; a witness is always connected; 40 % of the messages lost; "
                                    "losses in runs of 5"),
        ({"traffic": "dense", "delay": 0.3}, "dense traffic; a witness is always connected; messages 0.3 s late"),
        ({"pose": "urban", "false_alarm": 0.1, "partial": 1.0, "class_error": 0.05},
         "light traffic; a witness is always connected; positions: urban; false alarms at 10 % of what is seen; "
         "detections 100 % drawn to what is seen of a vehicle; 5 % of the classes wrong"),
    ],
)  # fmt: skip
def test_the_words_say_who_is_connected_and_what_differs(settings: dict[str, Any], words: str):
    condition = Condition("mine", "a test", **settings)
    assert condition.words == words
    assert condition.has_witness == ("a witness is always connected" in words)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"penetration": 1.5}, "penetration must be a number from 0 to 1, got 1.5"),
        ({"traffic": "lihgt"}, "traffic must be one of none, light, dense, got 'lihgt'; did you mean light?"),
        ({"collaborators": 1.5}, "collaborators must be a whole number from 0 to 20, got 1.5"),
        ({"collaborators": 1, "penetration": 0.5}, "leave out collaborators, got 1"),
        ({"loss": 2.0}, "radio loss must be a number from 0 to 1, got 2.0"),
        ({"delay": 9.0}, "radio delay must be"),
        ({"pose": "ubran"}, "unknown pose 'ubran': choose one of exact, rtk, white, standard, urban, denied"),
        ({"partial": 2.0}, "sensor partial must be a number from 0 to 1, got 2.0"),
        ({"penetratoin": 0.5}, "unknown condition setting penetratoin=0.5"),
        ({"reason": ""}, "condition reason must be a text, got ''"),
    ],
)
def test_an_impossible_condition_is_refused_in_one_line(settings: dict[str, Any], reason: str):
    with pytest.raises(ValueError, match=re.escape(reason)) as caught:
        Condition(**{"name": "mine", "reason": "a test", **settings})
    assert "\n" not in str(caught.value)


def test_numbers_are_kept_as_pythons_own():
    assert [type(Condition("mine", "a test", loss=1).loss), Condition("mine", "a test", burst=2).burst] == [float, 2.0]


def test_a_misspelt_name_is_refused_with_the_nearest_one():
    assert condition_named("alone") is CONDITIONS["alone"]
    with pytest.raises(ValueError, match=r"'alnoe': choose among nominal, .* or all; did you mean alone"):
        condition_named("alnoe")


def test_a_radio_keeps_all_that_a_condition_does_not_name():
    usual = RadioConfig(rate=1e5, loss=0.2, delay=0.1, range=50.0)
    assert CONDITIONS["nominal"].radio(usual) == usual
    assert CONDITIONS["delay-500"].radio(usual) == RadioConfig(rate=1e5, loss=0.2, delay=0.5, range=50.0)
