"""Chance without order: every random number is a function of a key and a counter.

Counter-based generation (Philox4x32-10: Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011)
gives each observer-target pair and each directed radio link a stream of its own. Adding a vehicle, a message or
a noise setting therefore never shifts the numbers that anything else draws, and the order of evaluation is free.
"""

import math
import zlib

import numpy as np

from cad_env.numerics.jit import compiled
from cad_env.types import Ints

_LOW = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(32)
_MULTIPLY_0 = np.uint64(0xD2511F53)
_MULTIPLY_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)
_TO_UNIT = 2.0**-32


def _sequence(seed: int, name: str) -> np.random.SeedSequence:
    return np.random.SeedSequence(entropy=seed, spawn_key=(zlib.crc32(name.encode()),))


def stream_key(seed: int, name: str) -> Ints:
    """The key, (2,) uint64 below 2**32, of the counter-based stream `name` of an episode seed."""
    return _sequence(seed, name).generate_state(2).astype(np.uint64)


def generator(seed: int, name: str) -> np.random.Generator:
    """A numpy generator for the named stream of an episode seed; streams of other names are independent of it."""
    return np.random.Generator(np.random.PCG64(_sequence(seed, name)))


@compiled
def philox(key: Ints, a: int, b: int, c: int, d: int) -> tuple[int, int, int, int]:
    """Four 32-bit words for the counter (a, b, c, d), each in [0, 2**32), under a (2,) uint64 key."""
    k0, k1 = np.uint64(key[0]), np.uint64(key[1])
    c0, c1, c2, c3 = np.uint64(a), np.uint64(b), np.uint64(c), np.uint64(d)
    for _ in range(10):
        product_0, product_1 = _MULTIPLY_0 * c0, _MULTIPLY_1 * c2
        c0, c1, c2, c3 = (
            (product_1 >> _SHIFT) ^ c1 ^ k0,
            product_1 & _LOW,
            (product_0 >> _SHIFT) ^ c3 ^ k1,
            product_0 & _LOW,
        )
        k0, k1 = (k0 + _WEYL_0) & _LOW, (k1 + _WEYL_1) & _LOW
    return c0, c1, c2, c3


@compiled
def uniform(key: Ints, a: int, b: int, c: int, d: int) -> float:
    """A uniform number in (0, 1) for the counter (a, b, c, d)."""
    word, _, _, _ = philox(key, a, b, c, d)
    return (float(word) + 0.5) * _TO_UNIT


@compiled
def normals_and_uniform(key: Ints, a: int, b: int, c: int, d: int) -> tuple[float, float, float]:
    """Two independent standard normal numbers (Box-Muller) and a uniform one in (0, 1) for the counter."""
    w0, w1, w2, _ = philox(key, a, b, c, d)
    radius = math.sqrt(-2.0 * math.log((float(w0) + 0.5) * _TO_UNIT))
    angle = 2.0 * math.pi * (float(w1) + 0.5) * _TO_UNIT
    return radius * math.cos(angle), radius * math.sin(angle), (float(w2) + 0.5) * _TO_UNIT
