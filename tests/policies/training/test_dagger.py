"""Training: batches are balanced, the loss falls, and a run that was stopped resumes as if it had not been."""

import csv
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch

from cad_env.envs.vector import CADVectorEnv
from cad_env.files import FileError
from cad_env.scenarios import SCENARIOS
from cad_env.scoring.rollout import Episode
from cad_env.types import BRAKE, Policy
from policies.model_folder import load_model
from policies.spec import Frames
from policies.stgraph.network import StGraphNet
from policies.stgraph.spec import SPEC
from policies.training.cloning import Worth, balanced, drive_episodes, fit, load_state, save_state
from policies.training.config import TrainingConfig
from policies.training.dagger import train_network
from policies.training.demonstrations import joined, record, replay
from policies.training.validation_log import Log

NAMES = tuple(SCENARIOS)[:2]
TINY = TrainingConfig(
    scenarios=NAMES, episodes=6, dagger_rounds=1, dagger_episodes=2, steps=8, segments=2, validation=1,
    final_validation=1, batch=16,
)  # fmt: skip


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Frames]:
    folder = tmp_path_factory.mktemp("frames")
    found = {}
    for name in NAMES:
        envs = CADVectorEnv(6, scenario=name)
        recorded = joined(record(folder / name, envs, None, range(6), lambda n: None))
        found[name] = SPEC.frames(*replay(recorded, envs, SPEC.look))
    return found


def test_every_scenario_has_its_share_of_a_batch_and_a_third_of_it_brakes() -> None:
    labels = {"long": np.array([BRAKE] * 5 + [0] * 95), "short": np.array([0] * 8 + [BRAKE])}
    batches = balanced(labels, TrainingConfig(batch=60, brake_share=0.3), np.random.default_rng(0))
    for _ in range(20):
        for name, chosen in next(batches).items():
            assert len(chosen) == 30
            assert (labels[name][chosen] == BRAKE).sum() == 9


def test_a_scenario_with_frames_of_one_kind_cannot_be_balanced() -> None:
    labels = {"mixed": np.arange(10) % 2, "calm": np.zeros(10)}
    with pytest.raises(ValueError, match="calm must hold frames of both kinds"):
        next(balanced(labels, TrainingConfig(NAMES, batch=4, brake_share=0.5), np.random.default_rng(0)))


def test_the_loss_falls(frames: dict[str, Frames]) -> None:
    network = StGraphNet(seed=0)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-2)
    rng, config = np.random.default_rng(0), TrainingConfig(batch=32, learning_rate=1e-2)
    first = fit(SPEC, network, optimiser, frames, config, range(5), 60, rng, lambda n: None)
    fit(SPEC, network, optimiser, frames, config, range(5, 55), 60, rng, lambda n: None)
    last = fit(SPEC, network, optimiser, frames, config, range(55, 60), 60, rng, lambda n: None)
    assert last < 0.9 * first


def test_fewer_failures_are_worth_more_and_then_less_time() -> None:
    assert Worth(1, 0, 20.0) < Worth(2, 0, 10.0)
    assert Worth(1, 0, 10.0) < Worth(1, 0, 20.0)


def test_ten_needless_brakes_are_worse_than_a_failure() -> None:
    assert Worth(1, 0, 10.0) < Worth(0, 11, 10.0)
    assert Worth(0, 9, 10.0) < Worth(1, 0, 10.0)


def test_a_saved_state_goes_on_as_if_it_had_not_stopped(frames: dict[str, Frames], tmp_path: Path) -> None:
    def weights(stop: bool) -> torch.Tensor:
        network = StGraphNet(seed=0)
        optimiser = torch.optim.Adam(network.parameters())
        for part in range(2):
            if stop and part:
                save_state(tmp_path / "state.safetensors", network, optimiser, 0.25)
                network = StGraphNet(seed=5)
                optimiser = torch.optim.Adam(network.parameters())
                assert load_state(tmp_path / "state.safetensors", network, optimiser) == 0.25
            rng = np.random.default_rng(part)
            fit(
                SPEC,
                network,
                optimiser,
                frames,
                TrainingConfig(batch=16),
                range(3 * part, 3 * part + 3),
                6,
                rng,
                lambda n: None,
            )
        return torch.cat([value.flatten() for value in network.state_dict().values()])

    torch.testing.assert_close(weights(stop=True), weights(stop=False), rtol=0, atol=0)


def test_the_learning_rate_falls_once_over_all_rounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rates: list[float] = []

    def watched(spec: Any, network: Any, optimiser: torch.optim.Adam, *others: Any) -> float:
        advance = others[-1]
        return fit(
            spec, network, optimiser, *others[:-1],
            lambda n: (advance(n), rates.append(optimiser.param_groups[0]["lr"])),
        )  # fmt: skip

    monkeypatch.setattr("policies.training.dagger.fit", watched)
    train_network(TINY, tmp_path, lambda work: None)
    assert len(rates) == TINY.steps_of(0) + TINY.steps_of(1) == 12
    assert rates == sorted(rates, reverse=True)
    assert rates[0] == pytest.approx(TINY.learning_rate)
    assert rates[-1] < 0.05 * TINY.learning_rate


class StoppedError(Exception):
    """As good as a Ctrl-C."""


def test_a_run_stopped_anywhere_ends_in_the_same_model(tmp_path: Path) -> None:
    told: list[float] = []
    train_network(TINY, tmp_path / "whole", told.append)
    assert sum(told) == pytest.approx(TINY.work())
    whole = load_model(tmp_path / "whole")
    for stop_at in (0.2, 0.5, 0.9):
        done = 0.0

        def advance(work: float, limit: float = stop_at * TINY.work()) -> None:
            nonlocal done
            done += work
            if done > limit:
                raise StoppedError

        with pytest.raises(StoppedError):
            train_network(TINY, tmp_path / "stopped", advance)
    train_network(TINY, tmp_path / "stopped", lambda work: None)
    stopped = load_model(tmp_path / "stopped")
    assert stopped.threshold == whole.threshold
    for name, value in whole.network.state_dict().items():
        torch.testing.assert_close(stopped.network.state_dict()[name], value, rtol=0, atol=0)
    assert (tmp_path / "stopped/metrics.csv").read_text() == (tmp_path / "whole/metrics.csv").read_text()


def test_metrics_have_a_row_for_every_checkpoint_and_scenario(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    train_network(TINY, folder, lambda work: None)
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    wanted = [(turn, segment, name) for turn in "01" for segment in "01" for name in NAMES]
    assert [(row["round"], row["segment"], row["scenario"]) for row in rows] == wanted


@pytest.mark.parametrize("torn", ["metrics.csv", "finalists.csv"])
def test_a_torn_row_is_driven_again_and_nothing_else_is_done_twice(
    torn: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train_network(TINY, tmp_path, lambda work: None)
    model, before = (tmp_path / "config.json").read_bytes(), (tmp_path / torn).read_text()
    (tmp_path / torn).write_text(before[:-9])
    (tmp_path / "config.json").unlink()
    driven: list[range] = []

    def watched(policy: Policy, envs: CADVectorEnv, seeds: range, advance: Any) -> list[Episode]:
        driven.append(seeds)
        return drive_episodes(policy, envs, seeds, advance)

    monkeypatch.setattr("policies.training.dagger.drive_episodes", watched)
    monkeypatch.setattr("policies.training.dagger.fit", None)
    monkeypatch.setattr("policies.training.frame_cache.replay", None)
    train_network(TINY, tmp_path, lambda work: None)
    assert len(driven) == 1
    assert (tmp_path / torn).read_text() == before
    assert (tmp_path / "config.json").read_bytes() == model


def test_stopped_in_the_first_scenario_of_a_validation_it_fits_nothing_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train_network(TINY, tmp_path / "whole", lambda work: None)
    rounds = TINY.dagger_rounds + 1
    last = rounds * TINY.segments  # the validation after the last segment
    begun: list[range] = []

    def stopping(policy: Policy, envs: CADVectorEnv, seeds: range, advance: Any) -> list[Episode]:
        begun.append(seeds)
        if len(begun) == (last - 1) * len(NAMES) + 1:
            raise StoppedError
        return drive_episodes(policy, envs, seeds, advance)

    monkeypatch.setattr("policies.training.dagger.drive_episodes", stopping)
    with pytest.raises(StoppedError):
        train_network(TINY, tmp_path / "stopped", lambda work: None)
    monkeypatch.setattr("policies.training.dagger.fit", None)
    monkeypatch.setattr("policies.training.frame_cache.replay", None)
    train_network(TINY, tmp_path / "stopped", lambda work: None)
    for name in ("metrics.csv", "finalists.csv"):
        assert (tmp_path / "stopped" / name).read_text() == (tmp_path / "whole" / name).read_text()


def test_the_best_checkpoint_fails_least_over_all_scenarios_and_is_quickest_then(tmp_path: Path) -> None:
    log = Log(tmp_path / "metrics.csv")

    def add(segment: int, scenario: str, failures: int, time: float) -> None:
        found = {**dict.fromkeys(Log.COLUMNS, 0), "segment": segment, "threshold": 0.5}
        log.add({**found, "scenario": scenario, "condition": "nominal", "failures": failures, "mean_time": time})

    for segment, failures, times in ((0, (0, 5), (9.0, 9.0)), (1, (2, 2), (9.0, 12.0)), (2, (4, 0), (9.0, 11.0))):
        for name, few, time in zip(("one", "two"), failures, times, strict=True):
            add(segment, name, few, time)
    assert log.ranked() == [(0, 2, 0.5), (0, 1, 0.5), (0, 0, 0.5)]
    assert Log(tmp_path / "metrics.csv").ranked() == log.ranked()
    log.forget(0, 0)
    add(0, "one", 0, 9.0)
    add(0, "two", 0, 9.0)
    assert log.ranked()[0] == (0, 0, 0.5)
    assert len(log.rows) == 6


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("episodes", 0), ("steps", 1), ("dagger_rounds", -1), ("dagger_rounds", 50), ("radio", "dsrk"),
        ("thresholds", ()), ("thresholds", (0.5, 0.5)),
    ],
)  # fmt: skip
def test_an_impossible_config_is_refused_with_the_name_and_the_value(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=rf"{name}.* {re.escape(repr(value))}(:|$)"):
        TrainingConfig(**{name: value})  # type: ignore[arg-type]


def test_a_config_of_nothing_or_with_a_threshold_that_is_no_probability_is_refused() -> None:
    with pytest.raises(ValueError, match="scenarios must name at least one, each once, got ''"):
        TrainingConfig(scenarios=())
    with pytest.raises(ValueError, match=r"thresholds must be a number from 0 to 1, got 1\.5"):
        TrainingConfig(thresholds=(0.5, 1.5))


@pytest.mark.parametrize(("name", "value"), [("batch", 0), ("learning_rate", -1.0), ("brake_share", 1.5)])
def test_an_impossible_way_to_fit_is_refused_with_the_name_and_the_value(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} must be a (whole )?number .*got {value}"):
        TrainingConfig(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(("batch", "share", "scenarios"), [(4, 0.3, 3), (96, 0.0, 3), (96, 1.0, 3), (1, 0.5, 1)])
def test_a_batch_without_frames_of_both_kinds_is_refused_before_anything_is_recorded(
    batch: int, share: float, scenarios: int
) -> None:
    with pytest.raises(ValueError, match=f"batch={batch} with brake_share={share} must hold frames of both kinds"):
        TrainingConfig(scenarios=tuple(SCENARIOS)[:scenarios], batch=batch, brake_share=share)


def test_a_damaged_checkpoint_is_refused_with_its_name(tmp_path: Path) -> None:
    network = StGraphNet(seed=0)
    optimiser = torch.optim.Adam(network.parameters())
    path = tmp_path / "state.safetensors"
    save_state(path, network, optimiser, 0.25)
    whole = path.read_bytes()
    for broken in (b"", whole[:100], whole[:-4], b"not safetensors"):
        path.write_bytes(broken)
        with pytest.raises(FileError, match=r"state\.safetensors: not a checkpoint") as error:
            load_state(path, network, optimiser)
        assert "\n" not in str(error.value)


def trained_a_step(seed: int) -> tuple[StGraphNet, torch.optim.Adam]:
    """A network and its optimiser, which has moments of every parameter but the last."""
    network = StGraphNet(seed=seed)
    optimiser = torch.optim.Adam(network.parameters())
    *parameters, _ = network.parameters()
    sum(parameter.sum() for parameter in parameters).backward()  # type: ignore[union-attr]
    optimiser.step()
    return network, optimiser


def test_a_checkpoint_comes_back_with_the_optimisers_moments(tmp_path: Path) -> None:
    network, optimiser = trained_a_step(0)
    save_state(tmp_path / "state.safetensors", network, optimiser, 0.25)
    other, fresh = trained_a_step(1)
    assert load_state(tmp_path / "state.safetensors", other, fresh) == 0.25
    for index, moments in optimiser.state_dict()["state"].items():
        for name, value in moments.items():
            assert torch.equal(fresh.state_dict()["state"][index][name], value)
    assert fresh.state_dict()["state"].keys() == optimiser.state_dict()["state"].keys()
    assert str(other.state_dict()) == str(network.state_dict())


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"adam": None}, "it holds nothing of the optimiser"),
        ({"adam.0.exp_avg": torch.zeros(1)}, "adam.0.exp_avg must be torch.float32 of shape (12, "),
        ({"adam.0.step": torch.zeros(2)}, "adam.0.step must be torch.float32 of shape ()"),
        ({"adam.0.exp_avg": None}, "adam.0 must have step, exp_avg, exp_avg_sq"),
        ({"adam.99.step": torch.tensor(1.0)}, "adam.99.step is nothing of this optimiser"),
        ({"adam.x.step": torch.tensor(1.0)}, "adam.x.step is nothing of this optimiser"),
        ({"adam.0.rate": torch.tensor(1.0)}, "adam.0.rate is nothing of this optimiser"),
        ({"loss": None}, "loss must be one number"),
        ({"loss": torch.zeros(2)}, "loss must be one number"),
        ({"network": None}, "Missing key"),
        ({"network.more": torch.zeros(2)}, "Unexpected key"),
    ],
)
def test_a_checkpoint_without_or_with_other_parts_is_refused(
    change: dict[str, torch.Tensor | None], reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "state.safetensors"
    network, optimiser = trained_a_step(0)
    save_state(path, network, optimiser, 0.25)
    tensors = safetensors.torch.load(path.read_bytes())
    for name, value in change.items():
        tensors = {known: part for known, part in tensors.items() if known != name and not known.startswith(f"{name}.")}
        tensors |= {} if value is None else {name: value}
    path.write_bytes(safetensors.torch.save(tensors))
    with pytest.raises(FileError, match=re.escape(reason)) as error:
        load_state(path, network, optimiser)
    assert str(error.value).startswith(f"{path}: not a checkpoint of this network (")
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("column", "text", "reason"),
    [
        ("round", "first", "round must be a whole number from 0 to 1e+09, got 'first'"),
        ("round", "1.5", "round must be a whole number"),
        ("segment", "null", "segment must be a whole number from 0 to 1e+09, got 'null'"),
        ("failures", "[1]", "failures must be a whole number from 0 to 1e+09, got '[1]'"),
        ("failures", "true", "failures must be a whole number"),
        ("failures", "-1", "failures must be a whole number"),
        ("episodes", "9" * 400, "episodes must be a whole number from 0 to 1e+09, got '999"),
        ("mean_time", "", "mean_time must be a number from 0 to 1e+09, got ''"),
        ("mean_time", "nan", "mean_time must be a number"),
        ("threshold", "1.5", "threshold must be a number from 0 to 1, got '1.5'"),
        ("loss", "low", "loss must be a number"),
    ],
)
def test_a_damaged_value_in_a_log_is_refused_with_line_and_column(
    column: str, text: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "finalists.csv"
    log = Log(path)
    row = {**dict.fromkeys(Log.COLUMNS, 0), "scenario": "left_turn", "condition": "nominal", "threshold": 0.5}
    log.add(row)
    log.add({**row, column: text})
    with pytest.raises(FileError, match=re.escape(f"{path}: line 3: {reason}")) as error:
        Log(path)
    assert str(error.value).endswith("; delete the line to have it made again")


def test_a_log_comes_back_as_it_was(tmp_path: Path) -> None:
    log = Log(tmp_path / "metrics.csv")
    row = {**dict.fromkeys(Log.COLUMNS, 0), "scenario": "left_turn", "condition": "alone"}
    for threshold, loss in ((1, 0.25), (0.5, math.nan), (0, math.inf)):
        log.add({**row, "threshold": threshold, "loss": loss})
    before = (tmp_path / "metrics.csv").read_bytes()
    assert repr(Log(tmp_path / "metrics.csv").rows) == repr(log.rows)
    assert (tmp_path / "metrics.csv").read_bytes() == before


@pytest.mark.parametrize("data", [b"round,segment\n", b"", b"\0\n", b"\xff\n"])
def test_a_log_that_is_another_file_is_refused_and_kept(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    path.write_bytes(data)
    with pytest.raises(FileError, match=r"metrics\.csv: "):
        Log(path)
    assert path.read_bytes() == data
