"""What a codec is given of a cloud: all of it, or what it says that it reads."""

from collections.abc import Sequence

import numpy as np
import pytest
from scenes import started, steps

from cad_env.lidar.cast import cast
from cad_env.lidar.config import CloudConfig
from cad_env.lidar.points import KEPT, RawPoints, Reads, thinned
from cad_env.simulation import cloud_exchange as sharing
from cad_env.simulation.batch import SceneBatch
from cad_env.simulation.setup import setup_from

RAYS = {"azimuths": 128, "beams": 16}


class Listening:
    """A codec of raw points that keeps what it was given."""

    width, most = 0, KEPT

    def __init__(self) -> None:
        self.given: list[np.ndarray] = []

    def encode(self, clouds: Sequence[np.ndarray]) -> list[bytes]:
        self.given = [cloud.copy() for cloud in clouds]
        return RawPoints().encode(clouds)

    def decode(self, payload: bytes) -> np.ndarray:
        return RawPoints().decode(payload)


class Choosing(Listening):
    """One that says what it reads."""

    def __init__(self, reads: Reads) -> None:
        super().__init__()
        self.reads = reads


def test_a_codec_that_says_nothing_is_given_every_return_in_metres():
    codec = Listening()
    simulation = started(3, cloud=CloudConfig(codec=codec, **RAYS), radio="ideal")
    for _ in steps(simulation, 3):
        wanted = [simulation.sharing.cloud(v).tobytes() for v in range(len(simulation.agents))]
        assert [cloud.tobytes() for cloud in codec.given] == wanted


@pytest.mark.parametrize("reads", [Reads(), Reads(centimetres=True), Reads(thinned=40), Reads(thinned=KEPT)])
def test_a_codec_is_given_what_it_reads_and_the_ego_is_shown_the_same_if_that_is_everything(reads: Reads):
    codec = Choosing(reads)
    simulation, plain = (
        started(3, cloud=CloudConfig(codec=one, **RAYS), radio="ideal") for one in (codec, RawPoints())
    )
    for _ in zip(steps(simulation, 5), steps(plain, 5), strict=True):
        clouds = [simulation.sharing.cloud(v) for v in range(len(simulation.agents))]
        if reads.thinned:
            clouds = [thinned(cloud, reads.thinned) for cloud in clouds]
        elif reads.centimetres:
            clouds = [np.floor(cloud * 100.0 + 0.5).astype(np.int16) for cloud in clouds]
        assert [cloud.tobytes() for cloud in codec.given] == [cloud.tobytes() for cloud in clouds]
        assert {cloud.dtype for cloud in codec.given} == {clouds[0].dtype}
        if not reads.thinned:
            assert simulation.observation(0)["cloud"].tobytes() == plain.observation(0)["cloud"].tobytes()


@pytest.mark.parametrize("codec", [RawPoints(), Listening(), Choosing(Reads(thinned=KEPT)), Choosing(Reads(thinned=9))])
def test_training_data_are_thinned_from_all_points_whatever_the_codec_reads(codec: object):
    simulation = started(3, cloud=CloudConfig(codec=codec, **RAYS), radio="ideal", sensor={"noise": 1.0})
    for _ in steps(simulation, 4):
        for v, own in enumerate(simulation.clouds):
            assert own.thinned.tobytes() == thinned(simulation.sharing.cloud(v), KEPT).tobytes()
        simulation.clouds[0].thinned[:] = 0.0
        assert simulation.clouds[0].thinned.any()


def test_codecs_that_read_differently_go_side_by_side():
    clouds = [CloudConfig(codec=one, **RAYS) for one in (Choosing(Reads(thinned=40)), Listening(), RawPoints())]
    together = SceneBatch([setup_from({"cloud": cloud, "radio": "ideal"}) for cloud in clouds])
    alone = [started(k, cloud=cloud, radio="ideal") for k, cloud in enumerate(clouds)]
    for k in range(3):
        together.start(k, k)
    for _ in zip(*(steps(one, 3) for one in alone), strict=True):
        for k, one in enumerate(alone):
            assert together.observation(k)["cloud"].tobytes() == one.observation(0)["cloud"].tobytes()
        together.step(np.arange(3), np.zeros(3, np.int64))


def test_a_cloud_that_is_sent_and_learned_from_is_cast_once_a_step(monkeypatch: pytest.MonkeyPatch):
    casts = []
    monkeypatch.setattr(sharing, "cast", lambda *given: casts.append(given) or cast(*given))
    simulation = started(3, cloud=CloudConfig(codec=Choosing(Reads(thinned=KEPT)), **RAYS), radio="ideal")
    for step, _ in enumerate(steps(simulation, 4)):
        assert len(simulation.clouds) > 1
        assert len(casts) == (step + 1) * len(simulation.agents)


def test_what_raw_points_cannot_say_is_not_said_wrongly():
    simulation = started(0, cloud=RAYS, radio="none")
    simulation._sensor = simulation._sensor._replace(noise=2000.0)  # beyond any that a SensorConfig allows
    with pytest.raises(ValueError, match=r"coordinates of a cloud must be from -327\.67 to 327\.67 m"):
        simulation.start(0)
