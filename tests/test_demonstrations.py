"""Recording the expert: what goes in comes out, and what is damaged is refused."""

from pathlib import Path

import numpy as np
import pytest

from cad_env.env import CADEnv
from cad_env.planner import Expert
from cad_env.types import BRAKE
from policies import demonstrations
from policies.demonstrations import Frames, ShardError, frames_of, join, read_shard, record, write_shard


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demonstrations")


@pytest.fixture(scope="module")
def frames(folder: Path) -> Frames:
    return record(folder, [CADEnv()], Expert(), range(6), lambda n: None)


def test_a_batch_is_the_observations_that_were_recorded(frames: Frames) -> None:
    env, expert = CADEnv(), Expert()
    observation, _ = env.reset(seed=3)
    seen, labels = [], []
    for _ in range(40):
        seen.append(observation)
        labels.append(expert.act(env.truth()))
        observation, *_ = env.step(labels[-1])
    mine = np.flatnonzero(frames.seed == 3)[:40]
    batch = frames.batch(mine)
    for name, values in batch.items():
        np.testing.assert_array_equal(values, np.stack([one[name] for one in seen]), err_msg=name)
    np.testing.assert_array_equal(frames.label[mine], labels)


def test_frames_in_any_order_and_twice(frames: Frames) -> None:
    chosen = np.array([7, 0, 7, len(frames) - 1])
    batch = frames.batch(chosen)
    for row, frame in enumerate(chosen):
        alone = frames.batch(np.array([frame]))
        np.testing.assert_array_equal(batch["tracks"][row], alone["tracks"][0])


def test_every_episode_is_labelled_by_the_expert_and_brakes_are_rare(frames: Frames) -> None:
    assert set(frames.seed) == set(range(6))
    assert 0.0 < (frames.label == BRAKE).mean() < 0.3


def test_joined_recordings_keep_their_frames(frames: Frames) -> None:
    both = join([frames, frames])
    assert len(both) == 2 * len(frames)
    last = np.array([len(frames) - 1])
    np.testing.assert_array_equal(both.batch(last + len(frames))["tracks"], frames.batch(last)["tracks"])


def test_a_second_recording_reads_the_shards_of_the_first(
    folder: Path, frames: Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drive(*_: object) -> Frames:
        raise AssertionError("an episode was driven again")

    monkeypatch.setattr(demonstrations, "_drive", drive)
    again = record(folder, [CADEnv()], Expert(), range(6), lambda n: None)
    np.testing.assert_array_equal(again.position, frames.position)


def test_shards_of_other_episodes_are_refused(folder: Path, frames: Frames) -> None:
    with pytest.raises(ShardError, match="holds other episodes"):
        record(folder, [CADEnv()], Expert(), range(5), lambda n: None)


@pytest.mark.parametrize("damage", ["truncated", "altered", "empty", "text", "missing"])
def test_a_damaged_shard_is_refused_with_its_name(damage: str, frames: Frames, tmp_path: Path) -> None:
    path = tmp_path / "shard_00000.npz"
    write_shard(path, frames)
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
    with pytest.raises(ShardError, match="shard_00000") as error:
        read_shard(path)
    assert "\n" not in str(error.value)


def test_a_shard_whose_arrays_do_not_fit_is_refused(frames: Frames, tmp_path: Path) -> None:
    path = tmp_path / "shard.npz"
    write_shard(path, Frames(**{**vars(frames), "slot": frames.slot[:-1]}))
    with pytest.raises(ShardError, match="do not fit"):
        read_shard(path)


def test_a_frame_without_any_node_is_kept() -> None:
    env = CADEnv()
    observation, _ = env.reset(seed=0)
    nothing = {**observation, "mask": np.zeros_like(observation["mask"])}
    frames = frames_of([nothing, observation], [0, 0], [0, 0])
    assert not frames.batch(np.array([0]))["mask"].any()
    np.testing.assert_array_equal(frames.batch(np.array([1]))["mask"][0], observation["mask"])
