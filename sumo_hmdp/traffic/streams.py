"""Random streams by name: each has its own, so what one thing draws never depends on how much another does."""

import zlib

import numpy as np


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """Return the generator of one named stream of a run.

    Args:
        seed: of the run.
        names: what is drawn, and for whom; texts count by their CRC-32, which is the same on every machine.
    """
    keys = tuple(name if isinstance(name, int) else zlib.crc32(name.encode()) for name in names)
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=keys))
