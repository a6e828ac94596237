"""Counter-based chance: the published words, the right moments, and streams that leave each other alone."""

import math
import warnings

import numpy as np
import pytest

from cad_env.numerics.jit import compiled
from cad_env.numerics.philox import generator, normals_and_uniform, philox, stream_key, uniform
from cad_env.types import Floats, Ints

ONES = 0xFFFFFFFF

# The known answers that Random123, the generator's reference implementation, publishes: counter, key, words.
KNOWN = (
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((ONES, ONES, ONES, ONES), (ONES, ONES), (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
)


@compiled
def draw(key: Ints, count: int) -> Floats:
    """(count, 4): a uniform number, then two normal and a uniform one."""
    drawn = np.empty((count, 4))
    for a in range(count):
        drawn[a, 0] = uniform(key, a, 1, 2, 3)
        drawn[a, 1], drawn[a, 2], drawn[a, 3] = normals_and_uniform(key, a, 1, 2, 3)
    return drawn


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_philox_gives_the_published_words(counter: tuple[int, ...], key: tuple[int, int], words: tuple[int, ...]):
    assert tuple(int(word) for word in philox(np.array(key, np.uint64), *counter)) == words


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_plain_python_gives_the_same_words_without_overflow(counter, key, words):
    plain = getattr(philox, "py_func", philox)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tuple(int(word) for word in plain(np.array(key, np.uint64), *counter)) == words


def test_numbers_have_the_moments_of_their_distributions():
    count = 100_000
    flat, first, second, also_flat = draw(stream_key(0, "moments"), count).T
    for sample in (flat, also_flat):
        assert sample.min() > 0.0
        assert sample.max() < 1.0
        assert abs(sample.mean() - 0.5) < 5 * math.sqrt(1 / 12 / count)
        assert abs(sample.var() - 1 / 12) < 5 * math.sqrt(1 / 180 / count)
    for sample in (first, second):
        assert abs(sample.mean()) < 5 / math.sqrt(count)
        assert abs(sample.var() - 1.0) < 5 * math.sqrt(2 / count)
        assert abs((sample**4).mean() - 3.0) < 5 * math.sqrt(96 / count)


def test_what_one_counter_draws_is_uncorrelated():
    drawn = draw(stream_key(0, "pairs"), 100_000)[:, 1:]
    off_diagonal = np.corrcoef(drawn.T)[np.triu_indices(3, 1)]
    assert np.abs(off_diagonal).max() < 5 / math.sqrt(100_000)


@pytest.mark.parametrize("changed", range(4))
def test_every_part_of_the_counter_counts(changed: int):
    key, counter = stream_key(0, "radio"), [7, 1, 2, 0]
    before = uniform(key, *counter)
    counter[changed] += 1
    assert uniform(key, *counter) != before


def test_streams_of_two_names_or_seeds_are_uncorrelated():
    streams = [draw(stream_key(seed, name), 20_000)[:, 0] for seed, name in ((0, "radio"), (0, "sense"), (1, "radio"))]
    assert np.abs(np.corrcoef(streams)[np.triu_indices(3, 1)]).max() < 5 / math.sqrt(20_000)


def test_a_generator_of_one_name_is_not_moved_by_another():
    alone = generator(3, "traffic").random(4)
    generator(3, "sense").random(100)
    assert (generator(3, "traffic").random(4) == alone).all()
    assert (generator(3, "sense").random(4) != alone).all()
    assert (generator(4, "traffic").random(4) != alone).all()


def test_a_stream_key_is_two_words_of_32_bits():
    key = stream_key(0, "radio")
    assert key.shape == (2,)
    assert key.dtype == np.uint64
    assert key.max() < 2**32
