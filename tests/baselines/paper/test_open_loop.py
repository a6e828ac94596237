"""Methods are asked at every frame of the expert's episodes, and what they answer is kept whole."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.evaluation.job import job_of
from baselines.evaluation.settings import Settings
from baselines.methods import method_named
from baselines.paper.open_loop import OpenEpisode, OpenLoop, at_threshold, measure, read_open_loop, write_open_loop
from baselines.paper.open_metrics import average_precision, open_score, ranking, ratios
from cad_env.envs.single import CADEnv
from cad_env.files import FileError
from cad_env.rules.expert import Expert
from cad_env.scoring.rollout import rollout

SEEDS = range(800_000, 800_003)
EPISODE = OpenEpisode(800_000, True, "0011", "0110", (0.1, 0.7, 0.9, 0.2), 8, 2400, 400)
OTHER = replace(EPISODE, seed=800_001, brake_probability=None)
LOOP = OpenLoop("left_turn", "stgraph", "dsrc", (EPISODE, OTHER), "0123456789abcdef")


SETTINGS = Settings(scenario=("left_turn",), method=("expert",))


def asked(name: str) -> OpenLoop:
    return measure(method_named(name), SETTINGS, "left_turn", SEEDS)


def test_whoever_is_asked_the_expert_drives() -> None:
    expert, going, braking, own = (asked(n) for n in ("expert", "always-go", "always-brake", "planner-own"))
    assert [episode.labels for episode in expert.episodes] == [episode.answers for episode in expert.episodes]
    for loop in (going, braking, own):
        assert [episode.labels for episode in loop.episodes] == [episode.labels for episode in expert.episodes]
    assert all(set(episode.answers) == {"0"} for episode in going.episodes)
    assert all(set(episode.answers) == {"1"} for episode in braking.episodes)
    assert sum(episode.messages for episode in own.episodes) == 0
    alone = rollout(CADEnv(), Expert(), SEEDS[0])
    assert expert.episodes[0].labels == "".join(map(str, alone.action.tolist()))


def test_a_control_is_asked_from_the_start_of_every_episode() -> None:
    loop = asked("blind-1")
    assert len(loop.episodes) == len(SEEDS)
    for episode in loop.episodes:
        assert episode.answers == "1" * 10 + "0" * (len(episode.labels) - 10)


def test_a_network_answers_as_it_drives_and_says_how_sure_it_is() -> None:
    loop = asked("stgraph")
    seen = []
    episode = rollout(CADEnv(), Expert(), SEEDS[1], watch=lambda env, observation, action: seen.append(observation))
    policy = job_of(SETTINGS, "left_turn", "stgraph").policy
    found = loop.episodes[1]
    assert found.answers == "".join(str(policy.act(observation)) for observation in seen)
    assert found.brake_probability is not None
    assert len(set(found.brake_probability)) > 10
    assert (found.messages, found.bytes) == (episode.messages_sent.sum(), episode.bytes_sent.sum())
    assert found.largest == episode.largest_message.max()
    assert loop.radio == "dsrc"


def test_another_threshold_gives_the_answers_of_a_driver_that_has_it() -> None:
    sure = replace(LOOP, episodes=LOOP.episodes[:1])
    assert [at_threshold(sure, limit).episodes[0].answers for limit in (0.0, 0.2, 0.7, 1.0)] == [
        "1111", "0111", "0110", "0000",
    ]  # fmt: skip
    assert at_threshold(sure, 0.7).episodes[0].counts() == (1, 1, 1, 1)
    with pytest.raises(ValueError, match=r"stgraph gives no P\(brake\)"):
        at_threshold(LOOP, 0.5)


def test_it_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "open" / "0" / "left_turn_stgraph.json"
    write_open_loop(path, LOOP)
    assert read_open_loop(path) == LOOP
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("change", [
    {"labels": "002"}, {"labels": ""}, {"answers": "0"}, {"seed": -1}, {"hazard": 1}, {"messages": 1.5},
    {"brake_probability": [0.5]}, {"brake_probability": [2.0] * 4}, {"brake_probability": 0.5}, {"more": 1},
    {"labels": None}, {"labels": 7}, {"labels": [0]}, {"answers": None}, {"seed": "7"}, {"bytes": 10**400},
    {"largest": -1}, {"brake_probability": [[]] * 4}, {"brake_probability": [10**400] * 4},
])  # fmt: skip
def test_an_altered_episode_is_refused_in_one_line(tmp_path: Path, change: dict[str, object]) -> None:
    path = tmp_path / "x.json"
    write_open_loop(path, LOOP)
    data = json.loads(path.read_text())
    data["episodes"][0] |= change
    path.write_text(json.dumps(data))
    with pytest.raises(FileError, match=f"^{path}: .*({next(iter(change))}|keys)") as caught:
        read_open_loop(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", [
    "", "[]", "{}", '{"scenario": 1, "method": "", "radio": "", "made_with": "", "episodes": [1]}',
    '{"scenario": "", "method": "", "radio": "", "made_with": "", "episodes": []}',
    '{"scenario": "", "method": "", "radio": "", "episodes": [1]}',
    "[" * 3000, '{"scenario": "a", "scenario": "b"}',
])  # fmt: skip
def test_what_is_no_measurement_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(ValueError, match=r"x\.json: "):
        read_open_loop(tmp_path / "x.json")


def test_a_measurement_that_does_not_know_its_model_is_refused_with_the_way_out(tmp_path: Path) -> None:
    write_open_loop(tmp_path / "x.json", LOOP)
    data = json.loads((tmp_path / "x.json").read_text())
    del data["made_with"]
    (tmp_path / "x.json").write_text(json.dumps(data))
    with pytest.raises(ValueError, match=r"x\.json: it is of an older format, .* delete it"):
        read_open_loop(tmp_path / "x.json")


def test_counts_by_hand() -> None:
    assert EPISODE.counts() == (1, 1, 1, 1)
    calm = replace(EPISODE, labels="0000", answers="0000", brake_probability=None)
    assert calm.counts() == (0, 0, 0, 4)
    assert np.isnan(ratios(np.array(calm.counts(), float))).tolist() == [True, False, True, True, False]


def test_average_precision_is_the_mean_precision_at_each_hit() -> None:
    rng = np.random.default_rng(0)
    scores, labels, each = rng.random(60), rng.integers(0, 2, 60), np.arange(60)
    ranked = labels[np.argsort(-scores)]
    at_hits = [ranked[: k + 1].mean() for k in range(60) if ranked[k]]
    assert average_precision(ranking(scores, labels, each), np.ones(60)) == pytest.approx(np.mean(at_hits))
    weights = rng.integers(0, 4, 60)
    repeated = ranking(*(np.repeat(part, weights) for part in (scores, labels, each)))
    weighed = average_precision(ranking(scores, labels, each), weights.astype(float))
    assert weighed == pytest.approx(average_precision(repeated, np.ones(60)))
    same = ranking(np.full(60, 0.5), labels, each)
    assert average_precision(same, np.ones(60)) == pytest.approx(labels.mean())
    assert np.isnan(average_precision(ranking(scores, np.zeros(60, int), each), np.ones(60)))


def test_a_score_counts_frames_and_draws_episodes() -> None:
    other = replace(EPISODE, seed=800_001, labels="1100", answers="1100", brake_probability=(0.9, 0.8, 0.1, 0.2))
    loop = replace(LOOP, episodes=(EPISODE, other))
    score = open_score({0: loop, 1: loop}, np.random.default_rng(0))
    assert (score.training_seeds, score.episodes, score.frames, score.brake_share) == (2, 2, 8, 0.5)
    assert score.ad is not None
    assert score.ear is not None
    assert (score.ad.value, score.ear.value) == (0.75, 0.75)
    assert (score.ad.low, score.ad.high) == (0.5, 1.0)  # two episodes: both the one, or both the other
    assert score.ad_spread == (0.75, 0.75)
    assert score.bytes_per_message == 300
    assert score.average_precision is not None
    assert 0.0 < score.average_precision.low <= score.average_precision.value <= score.average_precision.high <= 1.0


def test_who_has_no_probability_has_no_average_precision() -> None:
    assert open_score({0: LOOP}, np.random.default_rng(0)).average_precision is None


def test_training_seeds_are_compared_on_what_all_have() -> None:
    short = replace(LOOP, episodes=LOOP.episodes[1:])
    assert open_score({0: LOOP, 1: short}, np.random.default_rng(0)).episodes == 1
    with pytest.raises(ValueError, match="no held-out episode in common"):
        open_score({0: short, 1: replace(LOOP, episodes=LOOP.episodes[:1])}, np.random.default_rng(0))
