"""Frames on the disk are those that a replay gives, and whatever else is there is made anew."""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cad_env.envs.vector import CADVectorEnv
from policies.registry import spec_named
from policies.spec import Frames
from policies.training import frame_cache as kept_frames
from policies.training.cloning import fit
from policies.training.config import TrainingConfig
from policies.training.dagger import train_network
from policies.training.demonstrations import Demonstrations, joined, record, replay
from policies.training.frame_cache import frames_of

KEPT = ("compressed", "point_transformer")
POINTS = spec_named("compressed")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Demonstrations:
    return joined(
        record(tmp_path_factory.mktemp("shards"), CADVectorEnv(2, radio="none"), None, range(2), lambda n: None)
    )


def scenes(spec: Any, network: Any, **options: Any) -> CADVectorEnv:
    return CADVectorEnv(2, **{"radio": "ideal", **spec.replayed(network), **options})


def assert_same(found: Frames, wanted: Frames) -> None:
    assert type(found) is type(wanted)
    for name, value in vars(wanted).items():
        other = getattr(found, name)
        assert type(other) is type(value)
        if isinstance(value, np.ndarray):
            assert (other.dtype, other.shape, other.tobytes()) == (value.dtype, value.shape, value.tobytes())
        else:
            assert other == value


@pytest.fixture
def made(recorded: Demonstrations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., bool]:
    """Whether frames had to be made by a replay, whose answer is always the same."""
    network = POINTS.build(POINTS.config_type(), seed=0)
    answer = replay(recorded, scenes(POINTS, network), POINTS.look)
    wanted, calls = POINTS.frames(*answer), list[Demonstrations]()

    def replayed(of: Demonstrations, envs: CADVectorEnv, look: object) -> Any:
        calls.append(of)
        return answer

    monkeypatch.setattr(kept_frames, "replay", replayed)

    def asked(
        of: Demonstrations = recorded, seed: int = 0, knobs: Any = None, folder: Path = tmp_path, **envs: Any
    ) -> bool:
        calls.clear()
        network = POINTS.build(POINTS.config_type(**(knobs or {})), seed)
        assert_same(frames_of(folder, of, scenes(POINTS, network, **envs), POINTS, network), wanted)
        return bool(calls)

    return asked


@pytest.mark.parametrize("name", KEPT)
def test_kept_frames_are_those_of_a_replay_to_the_last_byte(
    name: str, recorded: Demonstrations, tmp_path: Path
) -> None:
    spec = spec_named(name)
    network = spec.build(spec.config_type(), seed=0)
    envs = scenes(spec, network)
    wanted = spec.frames(*replay(recorded, envs, spec.look))
    for _ in range(2):
        assert_same(frames_of(tmp_path, recorded, envs, spec, network), wanted)
    (path,) = tmp_path.glob("*/*.npz")
    assert path.parent.name.startswith(f"{name}_")


@pytest.mark.parametrize("name", ["stgraph", "command"])
def test_what_is_replayed_fast_is_not_kept(name: str, recorded: Demonstrations, tmp_path: Path) -> None:
    spec = spec_named(name)
    network = spec.build(spec.config_type(), seed=0)
    assert len(frames_of(tmp_path, recorded, scenes(spec, network), spec, network)) == recorded.length.sum()
    assert not list(tmp_path.iterdir())


def test_other_weights_and_knobs_that_nothing_is_looked_at_with_share_frames(made: Callable[..., bool]) -> None:
    assert made()
    assert not made()
    assert not made(seed=1)
    assert not made(knobs={"width": 8, "neighbours": 4, "pooled_width": 8, "mlp_width": 8})


@pytest.mark.parametrize(
    "other",
    [
        {"radio": "cv2x"}, {"depth": 1}, {"sensor": {"range": 60.0}}, {"traffic": "none"}, {"penetration": 0.5},
        {"scenario": "overtaking"}, {"knobs": {"channels": 64}}, {"knobs": {"levels": 1}},
    ],
    ids=str,
)  # fmt: skip
def test_whatever_is_seen_otherwise_has_frames_of_its_own(other: dict[str, Any], made: Callable[..., bool]) -> None:
    assert made()
    assert made(**other)
    assert not made(**other)
    assert not made()


def test_other_episodes_and_other_code_have_frames_of_their_own(
    made: Callable[..., bool], recorded: Demonstrations, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert made()
    assert made(replace(recorded, label=1 - recorded.label))
    assert not made()
    monkeypatch.setattr(kept_frames, "_code_of", lambda module: "edited")
    assert made()


@pytest.mark.parametrize("name", KEPT)
def test_scenes_to_replay_in_and_frames_depend_on_no_other_knob_than_is_told(name: str) -> None:
    spec = spec_named(name)
    asked = set[str]()

    class Noting(spec.config_type):  # type: ignore[misc,name-defined]
        def __getattribute__(self, knob: str) -> Any:
            asked.add(knob)
            return super().__getattribute__(knob)

    network = spec.build(spec.config_type(), seed=0)
    network.config = Noting(**asdict(spec.config_type()))
    asked.clear()
    cloud = spec.replayed(network)["cloud"]
    cloud.codec.encode([np.ones((5, 3))])
    assert asked & set(asdict(spec.config_type())) == set(spec.looked_with(spec.config_type()))


def test_a_damaged_or_foreign_file_is_made_anew(made: Callable[..., bool], tmp_path: Path) -> None:
    assert made()
    (path,) = tmp_path.glob("*/*.npz")
    whole, chance = path.read_bytes(), np.random.default_rng(0)
    assert made(radio="cv2x")
    (foreign,) = (other for other in tmp_path.glob("*/*.npz") if other != path)
    flipped = [bytearray(whole) for _ in range(20)]
    for damaged in flipped:
        damaged[chance.integers(len(whole))] ^= 1 << int(chance.integers(8))
    for content in (b"", b"PK", whole[: len(whole) // 2], whole + b"x", foreign.read_bytes(), *flipped):
        path.write_bytes(content)
        assert made()
        assert path.read_bytes() == whole
        assert not made()


def test_a_folder_that_cannot_be_written_costs_only_time(made: Callable[..., bool], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert made(folder=tmp_path / "file")
    assert made(folder=tmp_path / "file")


def test_a_full_disk_leaves_nothing_behind(
    made: Callable[..., bool], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    assert made()
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def tiny(name: str, **changes: Any) -> TrainingConfig:
    return TrainingConfig(
        scenarios=("left_turn",), radio="ideal", episodes=6, dagger_rounds=0, steps=3, validation=1, final_validation=1,
        segments=1, thresholds=(0.5,), batch=6, spec=name,
        network=spec_named(name).config_type(mlp_width=8), **changes,
    )  # fmt: skip


@pytest.mark.parametrize("name", KEPT)
def test_further_seeds_replay_nothing_of_the_expert_and_end_in_the_same_model(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("first", "second"):
        train_network(tiny(name), tmp_path / folder, lambda work: None, tmp_path / "demonstrations")
        monkeypatch.setattr(kept_frames, "replay", None)
    for file in ("model.safetensors", "metrics.csv"):
        assert (tmp_path / "second" / file).read_bytes() == (tmp_path / "first" / file).read_bytes()
    train_network(tiny(name, seed=1), tmp_path / "third", lambda work: None, tmp_path / "demonstrations")


def test_a_restart_replays_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = replace(tiny("compressed"), dagger_rounds=1, dagger_episodes=1)

    def stopping(*given: Any) -> float:
        if given[5].start > 0:
            raise KeyboardInterrupt
        return fit(*given)

    with monkeypatch.context() as patched:
        patched.setattr("policies.training.dagger.fit", stopping)
        with pytest.raises(KeyboardInterrupt):
            train_network(config, tmp_path, lambda work: None)
    monkeypatch.setattr(kept_frames, "replay", None)
    train_network(config, tmp_path, lambda work: None)
    assert len(list(tmp_path.glob("dagger_rounds/left_turn/frames/compressed_*/*.npz"))) == 1
