"""A demonstrations: what was driven comes back frame by frame, under any radio, and what is damaged is refused."""

import hashlib
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cad_env.envs.single import CADEnv
from cad_env.envs.vector import CADVectorEnv
from cad_env.files import FileError
from cad_env.rules.expert import Expert
from cad_env.types import BRAKE, Observation
from policies.stgraph.features import WAY_POINTS
from policies.stgraph.network import StGraphNet
from policies.stgraph.policy import StGraphPolicy
from policies.stgraph.spec import SPEC
from policies.training import demonstrations as demonstrations
from policies.training.array_file import write_arrays
from policies.training.demonstrations import (
    Demonstrations,
    ReplayError,
    joined,
    read_shard,
    record,
    replay,
    write_shard,
)

MADE_WITH = {"scenario": "left_turn"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demonstrations")


@pytest.fixture(scope="module")
def recorded(folder: Path) -> Demonstrations:
    return joined(record(folder, CADVectorEnv(4, radio="none"), None, range(6), lambda n: None))


def seen(simulation: object, observation: Observation) -> Observation:
    return observation


@pytest.mark.parametrize("radio", ["dsrc", "none"])
def test_a_replay_shows_every_frame_as_the_expert_met_it(recorded: Demonstrations, radio: str) -> None:
    env, expert = CADEnv(radio=radio), Expert()
    looks, labels = replay(recorded, CADVectorEnv(3, radio=radio), seen)
    mine = np.flatnonzero(np.repeat(recorded.seed, recorded.length) == 3)
    observation, info = env.reset(seed=3)
    for frame in mine:
        for name, value in observation.items():
            np.testing.assert_array_equal(looks[frame][name], value, err_msg=name)
        label = expert.act(env.truth())
        assert labels[frame] == label
        observation, *_, info = env.step(label)
    assert info["outcome"] == "success"


def test_frames_are_the_observations_that_were_replayed(recorded: Demonstrations) -> None:
    envs = CADVectorEnv(4)
    looks, _ = replay(recorded, envs, seen)
    frames = SPEC.frames(*replay(recorded, envs, SPEC.look))
    chosen = np.array([7, 0, 7, len(frames) - 1])
    for name, values in frames.batch(chosen).items():
        half_a_centimetre = 0.0051 if name in ("tracks", "route") else 0.0
        wanted = np.stack([looks[k][name] for k in chosen])
        if name == "route":  # of which the network reads how far aside some points are
            values, wanted = values[:, WAY_POINTS, 1], wanted[:, WAY_POINTS, 1]
        if name == "tracks":  # where there is no node there is nothing to keep
            wanted = wanted * frames.batch(chosen)["mask"][..., None]
        np.testing.assert_allclose(values, wanted, rtol=0, atol=half_a_centimetre, err_msg=name)
    assert len(frames) == recorded.length.sum()
    assert 0.0 < (frames.label == BRAKE).mean() < 0.3


def test_joined_frames_keep_their_order(recorded: Demonstrations) -> None:
    frames = SPEC.frames(*replay(recorded, CADVectorEnv(4), SPEC.look))
    both = frames.joined([frames])
    assert len(both) == 2 * len(frames)
    last = np.array([len(frames) - 1])
    np.testing.assert_array_equal(both.batch(last + len(frames))["tracks"], frames.batch(last)["tracks"])


def test_a_frame_without_any_node_is_kept() -> None:
    observation, _ = CADEnv().reset(seed=0)
    nothing = {**observation, "mask": np.zeros_like(observation["mask"])}
    looks = [SPEC.look(None, one) for one in (nothing, observation)]  # type: ignore[arg-type]
    frames = SPEC.frames(looks, [0, 0])
    assert not frames.batch(np.array([0]))["mask"].any()
    np.testing.assert_array_equal(frames.batch(np.array([1]))["mask"][0], observation["mask"])


def test_an_episode_that_goes_another_way_is_an_error(recorded: Demonstrations) -> None:
    with pytest.raises(ReplayError, match="does not end as it was recorded"):
        replay(recorded, CADVectorEnv(2, scenario="street_crossing"), seen)
    with pytest.raises(ReplayError, match="episode 2 does"):
        replay(replace(recorded, outcome=np.where(recorded.seed == 2, 2, recorded.outcome)), CADVectorEnv(2), seen)


@pytest.mark.parametrize("mixing", [0.0, 0.5, 1.0])
def test_whoever_drives_the_label_is_the_experts_and_mixing_is_its_share(mixing: float, tmp_path: Path) -> None:
    policy = StGraphPolicy(StGraphNet(seed=1), threshold=0.0)  # it always brakes, the expert does not
    driven = joined(record(tmp_path, CADVectorEnv(2), policy, range(2), lambda n: None, mixing))
    braked = driven.action == BRAKE
    assert (driven.label == BRAKE).mean() < 0.5
    assert {0.0: braked.all(), 0.5: 0.3 < braked.mean() < 0.8, 1.0: (driven.action == driven.label).all()}[mixing]


def test_a_second_recording_reads_the_shards_of_the_first(
    folder: Path, recorded: Demonstrations, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drive(*_: object) -> Iterator[Demonstrations]:
        raise AssertionError("an episode was driven again")

    monkeypatch.setattr(demonstrations, "_drive", drive)
    again = joined(record(folder, CADVectorEnv(2, radio="ideal"), None, range(6), lambda n: None))
    np.testing.assert_array_equal(again.action, recorded.action)


def test_what_has_ended_of_a_shard_survives_and_is_not_driven_again(
    recorded: Demonstrations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driven: list[int] = []

    def watched(batch: object, seeds: list[int], decide: object) -> Iterator[tuple[int, int]]:
        for episode, place in played(batch, seeds, decide):
            driven.append(seeds[episode])
            yield episode, place
            if len(driven) == 4:
                raise KeyboardInterrupt

    played = demonstrations.play_episodes
    monkeypatch.setattr(demonstrations, "play_episodes", watched)
    monkeypatch.setattr(demonstrations, "KEPT_EVERY", 0.0)
    with pytest.raises(KeyboardInterrupt):
        record(tmp_path, CADVectorEnv(2, radio="none"), None, range(6), lambda n: None)
    again = joined(record(tmp_path, CADVectorEnv(2, radio="none"), None, range(6), lambda n: None))
    assert sorted(driven) == list(range(6))
    for name in ("seed", "length", "outcome", "action", "label"):
        np.testing.assert_array_equal(getattr(again, name), getattr(recorded, name), err_msg=name)
    assert [path.name for path in tmp_path.iterdir()] == ["shard_00000.npz"]


def test_a_shard_that_another_process_finishes_meanwhile_is_no_error(
    folder: Path, recorded: Demonstrations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = tmp_path / "shard_00000.begun.npz"
    begun.write_bytes((folder / "shard_00000.npz").read_bytes())
    reads = demonstrations.read_shard

    def finished_first(path: Path, made_with: Any) -> Demonstrations:
        if path == begun:
            begun.unlink()
        return reads(path, made_with)

    monkeypatch.setattr(demonstrations, "read_shard", finished_first)
    again = joined(record(tmp_path, CADVectorEnv(2, radio="none"), None, range(6), lambda n: None))
    np.testing.assert_array_equal(again.action, recorded.action)
    begun.write_bytes(b"left by a kill between the last two steps")
    record(tmp_path, CADVectorEnv(2, radio="none"), None, range(6), lambda n: None)
    assert not begun.exists()


def test_shards_of_other_episodes_or_settings_are_refused(folder: Path, recorded: Demonstrations) -> None:
    with pytest.raises(FileError, match="holds other episodes"):
        record(folder, CADVectorEnv(1), None, range(5), lambda n: None)
    with pytest.raises(FileError, match="has traffic 'light', not 'dense'"):
        record(folder, CADVectorEnv(1, traffic="dense"), None, range(6), lambda n: None)


@pytest.mark.parametrize("damage", ["truncated", "altered", "empty", "text", "missing"])
def test_a_damaged_shard_is_refused_with_its_name(damage: str, recorded: Demonstrations, tmp_path: Path) -> None:
    path = tmp_path / "shard_00000.npz"
    write_shard(path, recorded, MADE_WITH)
    whole = path.read_bytes()
    middle = len(whole) // 2
    broken = {
        "truncated": whole[:middle],
        "altered": whole[:middle] + bytes(32) + whole[middle + 32 :],
        "empty": b"",
        "text": b"not a zip",
    }
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(broken[damage])
    with pytest.raises(FileError, match="shard_00000") as error:
        read_shard(path, MADE_WITH)
    assert "\n" not in str(error.value)


def refusal(path: Path) -> str:
    """What is said of a shard, behind its path."""
    with pytest.raises(FileError) as caught:
        read_shard(path, MADE_WITH)
    said = str(caught.value)
    assert said.startswith(f"{path}: ")
    assert len(said.splitlines()) == 1
    return said.removeprefix(f"{path}: ")


def sealed(path: Path, archive: bytes) -> Path:
    """A file with the right checksum, as another tool might make it."""
    path.write_bytes(archive + hashlib.sha256(archive).digest())
    return path


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("label", lambda part: part[:-1], "its arrays do not fit together, or label"),
        ("length", lambda part: part[:-1], "its arrays do not fit together, or length"),
        ("length", lambda part: -part, "its arrays do not fit together, or length"),
        ("length", lambda part: part + 2**62, "its arrays do not fit together, or length"),
        ("outcome", lambda part: 0 * part, "its arrays do not fit together, or outcome"),
        ("outcome", lambda part: part + 7, "its arrays do not fit together, or outcome"),
        ("outcome", lambda part: part[:-1], "its arrays do not fit together, or outcome"),
        ("action", lambda part: part + 2, "its arrays do not fit together, or action"),
        ("seed", lambda part: -1 - part, "its arrays do not fit together, or seed"),
        ("seed", lambda part: 0 * part, "its arrays do not fit together, or seed"),
        ("seed", lambda part: part[0], "seed must be a row of int64, got int64 of shape ()"),
        ("seed", lambda part: part.astype(float), "seed must be a row of int64, got float64 of shape (6,)"),
        ("length", lambda part: part.astype(str), "length must be a row of int64, got <U21 of shape (6,)"),
        ("action", lambda part: part[None], "action must be a row of int8, got int8 of shape (1, "),
    ],
)
def test_a_shard_that_was_put_together_wrongly_is_refused_with_the_array(
    name: str, change: Callable[[Any], Any], reason: str, recorded: Demonstrations, tmp_path: Path
) -> None:
    arrays = {**vars(recorded), name: change(getattr(recorded, name))}
    text = json.dumps({"format": 3, "episodes": 6, **MADE_WITH})
    write_arrays(tmp_path / "shard.npz", text, arrays)
    assert refusal(tmp_path / "shard.npz").startswith(reason)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * 3000, "its text: not JSON of at most 64 levels"),
        ("", "its text: not JSON"),
        ("[1]", "its text must be a JSON object, got list"),
        ('{"episodes": %s}' % ("9" * 400), "has format None, not 3: delete it"),
        ('{"format": 3, "episodes": %s}' % ("9" * 400), "has episodes 999"),
        ('{"format": 3, "format": 3}', "its text: not JSON with every key once: 'format'"),
    ],
)
def test_a_shard_that_does_not_say_what_it_is_is_refused(
    text: str, reason: str, recorded: Demonstrations, tmp_path: Path
) -> None:
    write_arrays(tmp_path / "shard.npz", text, vars(recorded))
    assert refusal(tmp_path / "shard.npz").startswith(reason)


def test_what_is_no_archive_of_these_arrays_is_refused(recorded: Demonstrations, tmp_path: Path) -> None:
    path = tmp_path / "shard.npz"
    alone = io.BytesIO()
    np.save(alone, recorded.seed)
    assert refusal(sealed(path, alone.getvalue())).startswith("not an archive of arrays: ")
    assert refusal(sealed(path, b"")).startswith("not an archive of arrays: ")
    objects = io.BytesIO()
    np.savez(objects, text=np.array("{}"), seed=np.array([{}, []], object))
    assert refusal(sealed(path, objects.getvalue())).startswith("not an archive of arrays: ")
    empty = io.BytesIO()
    np.savez(empty, seed=recorded.seed)
    assert refusal(sealed(path, empty.getvalue())) == "text must be one text"
    write_arrays(path, "{}", {"seed": recorded.seed})
    assert refusal(path).startswith("must hold the arrays seed, length, outcome, action, label, got seed")


def test_an_archive_that_is_cut_or_altered_below_its_checksum_is_refused(
    recorded: Demonstrations, tmp_path: Path
) -> None:
    path = tmp_path / "shard.npz"
    write_shard(path, recorded, MADE_WITH)
    archive = path.read_bytes()[:-32]
    rng = np.random.default_rng(0)
    for _ in range(300):
        altered = bytearray(archive[: rng.integers(1, len(archive) + 1)] if rng.random() < 0.3 else archive)
        for place in rng.integers(0, len(altered), 3):
            altered[place] = rng.integers(256)
        try:
            found = read_shard(sealed(path, bytes(altered)), MADE_WITH)
        except FileError as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017
        else:
            assert found.seed.shape == recorded.seed.shape
