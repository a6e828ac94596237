"""The nouns and the knobs: frozen, with the defaults that the documents name, and checked when they are made."""

import dataclasses
import math
import re

import numpy as np
import pytest
from scenes import boxes
from stages import detect, nodes_and_edges

import cad_env
from cad_env.checks import ConfigError
from cad_env.config import (
    POSE_PRESETS,
    RADIO_PRESETS,
    PoseConfig,
    RadioConfig,
    SensorConfig,
    UnknownNameError,
    check_keywords,
    check_names,
    pose_config,
    radio_config,
)
from cad_env.numerics.philox import stream_key
from cad_env.pipeline.graph_arrays import as_graph, empty_graph_arrays, row_of, slide
from cad_env.simulation.setup import Setup, setup_from
from cad_env.types import BRAKE, FRAMES, GO, MAX_TRACKS, STEP, Command, Graph, Policy

RANGES = [
    (SensorConfig, "sensor", "range", 1.0, 500.0),
    (SensorConfig, "sensor", "noise", 0.0, 10.0),
    (SensorConfig, "sensor", "miss", 0.0, 1.0),
    (SensorConfig, "sensor", "gnss_noise", 0.0, 50.0),
    (SensorConfig, "sensor", "gnss_yaw_noise", 0.0, math.pi),
    (SensorConfig, "sensor", "false_alarm", 0.0, 1.0),
    (SensorConfig, "sensor", "partial", 0.0, 1.0),
    (SensorConfig, "sensor", "class_error", 0.0, 1.0),
    (PoseConfig, "pose", "bias", 0.0, 50.0),
    (PoseConfig, "pose", "yaw_bias", 0.0, math.pi),
    (PoseConfig, "pose", "bias_time", 0.1, 1e4),
    (PoseConfig, "pose", "noise", 0.0, 50.0),
    (PoseConfig, "pose", "yaw_noise", 0.0, math.pi),
    (PoseConfig, "pose", "outage", 0.0, 0.99),
    (PoseConfig, "pose", "outage_time", 0.1, 1e3),
    (PoseConfig, "pose", "start", 0.0, 50.0),
    (PoseConfig, "pose", "scale", 0.0, 0.2),
    (PoseConfig, "pose", "yaw_rate", 0.0, 0.1),
    (RadioConfig, "radio", "rate", 0.0, 1e12),
    (RadioConfig, "radio", "loss", 0.0, 1.0),
    (RadioConfig, "radio", "delay", 0.0, 1.4),
    (RadioConfig, "radio", "range", 0.0, 1e6),
    (RadioConfig, "radio", "burst", 1.0, 1e4),
]


@pytest.mark.parametrize(("kind", "what", "name", "low", "high"), RANGES)
def test_a_knob_takes_its_range_and_nothing_beyond(kind, what: str, name: str, low: float, high: float):
    for value in (low, high, 0.5 * (low + high)):
        assert getattr(kind(**{name: value}), name) == value
    for value in (low - 0.01, high * 1.01, math.nan, -math.inf, "1", None, True, [1.0], 1j):
        message = f"{what} {name} must be a number from {low:g} to {high:g}, got {value!r}"
        with pytest.raises(ValueError, match=re.escape(message)):
            kind(**{name: value})


def test_every_knob_is_checked():
    assert {(kind, name) for kind, _, name, _, _ in RANGES} == {
        (kind, field.name) for kind in (SensorConfig, RadioConfig, PoseConfig) for field in dataclasses.fields(kind)
    } - {(PoseConfig, "denied"), (PoseConfig, "placing")}


def test_a_switch_and_a_name_are_checked_too():
    with pytest.raises(ConfigError, match="pose denied must be"):
        PoseConfig(denied=2)
    with pytest.raises(ConfigError, match=r"pose placing must be one of .*; did you mean single[?]"):
        PoseConfig(placing="sinlge")
    with pytest.raises(UnknownNameError, match="unknown pose setting biass=1"):
        setup_from({"pose": {"biass": 1}})
    assert pose_config(PoseConfig(bias=2.0)) == setup_from({"pose": {"bias": 2.0}}).pose
    assert [name for name, pose in POSE_PRESETS.items() if pose.exact] == ["exact"]


@pytest.mark.parametrize("more", [{"cloud": {}}, {"share": lambda graph: graph}, {"sensor": {"gnss_noise": 1.0}}])
def test_poses_and_what_knows_nothing_of_them_exclude_each_other(more: dict):
    assert setup_from({"pose": "exact", **more}).pose.exact
    with pytest.raises(ValueError, match="leave out"):
        setup_from({"pose": "urban", **more})


def test_the_defaults_are_those_of_the_documents():
    assert SensorConfig() == SensorConfig(range=80.0, noise=0.2, miss=0.05, gnss_noise=0.0, gnss_yaw_noise=0.0)
    assert RadioConfig() == RadioConfig(rate=2e6, loss=0.05, delay=0.0, range=150.0)
    assert Setup() == setup_from({}) == setup_from({"scenario": "left_turn", "radio": "dsrc", "depth": 15})


@pytest.mark.parametrize(
    ("preset", "budget", "loss", "reach"),
    [
        ("none", 0.0, 0.0, 150.0), ("ideal", math.inf, 0.0, math.inf),
        ("dsrc", 25_000.0, 0.05, 150.0), ("cv2x", 90_000.0, 0.05, 150.0),
    ],
)  # fmt: skip
def test_presets_are_the_paper_s(preset: str, budget: float, loss: float, reach: float):
    radio = radio_config(preset)
    assert (radio.budget, radio.loss, radio.range, radio.delay) == (budget, loss, reach, 0.0)


def test_unlimited_is_a_rate_and_a_range():
    assert RadioConfig(rate=math.inf, range=math.inf).budget == math.inf


@pytest.mark.parametrize(("delay", "steps"), [(0.0, 0), (0.01, 1), (0.1, 1), (0.11, 2), (0.3, 3), (0.7, 7), (1.4, 14)])
def test_a_delay_is_rounded_up_to_whole_steps(delay: float, steps: int):
    assert RadioConfig(delay=delay).delay_steps == steps


def test_presets_and_records_cannot_be_changed():
    with pytest.raises(TypeError):
        RADIO_PRESETS["dsrc"] = RadioConfig()
    for record in (RadioConfig(), SensorConfig(), PoseConfig(), Setup()):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(record, dataclasses.fields(record)[0].name, 1)


def test_names_are_checked_with_value_and_choices():
    check_names("thing", {"a": 1}, ["a", "b"])
    with pytest.raises(ValueError, match=re.escape("unknown thing c=[1]: choose among a, b")):
        check_names("thing", {"a": 1, "c": [1]}, ["b", "a"])


def test_a_misspelt_key_is_answered_with_the_nearest():
    with pytest.raises(ConfigError, match=re.escape("unknown thing rnage=1: choose among noise, range; did you mean ")):
        check_names("thing", {"rnage": 1}, ["range", "noise"])


@pytest.mark.parametrize("kind", [ConfigError, TypeError, UnknownNameError])
def test_an_unknown_keyword_is_what_python_and_what_our_users_expect(kind: type[Exception]):
    check_keywords({"a": 1}, ["a", "b"])
    said = "unknown option c=[1]: choose among a, b (__init__() got an unexpected keyword argument 'c')"
    with pytest.raises(kind, match=f"^{re.escape(said)}$"):
        check_keywords({"a": 1, "c": [1]}, ["b", "a"])


def test_an_unknown_keyword_is_answered_with_the_nearest():
    said = "unknown option rnage=1: choose among noise, range (__init__() got an unexpected keyword argument 'rnage')"
    with pytest.raises(UnknownNameError, match=f"^{re.escape(said)}; did you mean range[?]$"):
        check_keywords({"rnage": 1}, ["range", "noise"])


def test_actions_commands_and_times_are_the_paper_s():
    assert (GO, BRAKE) == (0, 1)
    assert (cad_env.GO, cad_env.BRAKE) == (GO, BRAKE)
    assert len(Command) == 6
    assert (FRAMES, STEP) == (15, 0.1)


def test_a_policy_is_a_protocol_and_no_base_class():
    assert set(Policy.__protocol_attrs__ if hasattr(Policy, "__protocol_attrs__") else dir(Policy)) >= {"reset", "act"}


def test_detections_say_nothing_of_who_was_detected():
    found = detect(boxes((0, 0, 0), (20, 5, 0)), 0, SensorConfig(miss=0.0), stream_key(0, "sense"), 2)
    assert [field.name for field in dataclasses.fields(found)] == ["time", "position", "kind"]
    assert found.position.shape == (1, 3)


def test_a_graph_s_rows_slide_into_the_past_and_go():
    rows = empty_graph_arrays()
    assert [row_of(rows, 7), row_of(rows, 9), row_of(rows, 7)] == [0, 1, 0]
    rows.mask[0, -1] = True
    rows.position[0, -1] = 1.0, 2.0, 3.0
    slide(rows)
    assert rows.used[0] == 1  # the row without a node has gone
    assert rows.mask[0].tolist() == [False] * 13 + [True, False]
    assert rows.position[0, -2].tolist() == [1.0, 2.0, 3.0]
    for _ in range(FRAMES - 1):
        slide(rows)
    assert rows.used[0] == 0


def test_a_full_graph_has_no_row_for_a_stranger():
    rows = empty_graph_arrays()
    assert [row_of(rows, 100 + k) for k in range(MAX_TRACKS)] == list(range(MAX_TRACKS))
    assert row_of(rows, 5) == -1
    assert row_of(rows, 103) == 3


def test_a_graph_holds_no_rubbish_where_its_mask_is_not_set():
    rows = empty_graph_arrays()
    rows.position[:] = 9.0
    row_of(rows, 4)
    rows.mask[0, 3] = True
    graph = as_graph(rows, 2, 1.5)
    assert (graph.sender, graph.time, graph.track.tolist()) == (2, 1.5, [4])
    assert graph.position.sum() == 27.0
    rows.position[:] = 0.0
    assert graph.position.sum() == 27.0


def test_edges_follow_from_the_nodes():
    mask = np.zeros((2, FRAMES), bool)
    mask[0, [12, 14]] = mask[1, 14] = True
    position = np.zeros((2, FRAMES, 3))
    position[1, 14] = 3.0, 4.0, 0.0
    spatial, distance, temporal, gap = nodes_and_edges(
        Graph(0, 0.0, np.array([0, 1]), position, mask, np.zeros(2, np.int8))
    )
    # Nodes in order: (0, 12), (0, 14), (1, 14).
    assert spatial.tolist() == [[1, 2], [2, 1]]
    assert distance.tolist() == [5.0, 5.0]
    assert temporal.tolist() == [[0, 1], [1, 0]]
    assert gap == pytest.approx([-0.2, 0.2])
