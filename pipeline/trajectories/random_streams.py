"""Labelled random streams: every result has its own, so adding one changes no other.

Labels are purposes, positions and content, never the names of files, tasks or people, which may be changed at will.
"""

from __future__ import annotations

import hashlib
import json

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError


def content_key(*arrays: FloatArray) -> str:
    """A label for a stream that belongs to some numbers, whatever they are called: SHA-256 of them to six decimals.

    Rounded, so that the last bits, which differ between ways to compute the same, do not count.
    """
    rounded = [np.round(np.asarray(array, dtype=np.float64), 6) + 0.0 for array in arrays]  # -0 is 0
    return hashlib.sha256(b"".join(values.astype("<f8").tobytes() for values in rounded)).hexdigest()


def child_rng(seed: int, *labels: str | int) -> np.random.Generator:
    """The generator that belongs to `labels` under `seed`, whatever else is drawn, in whatever order.

    The labels are hashed (SHA-256 of their JSON, so ("a", 1) and ("a", "1") differ) into the entropy of a
    `SeedSequence`. Streams of different labels are independent for every practical purpose.

    Args:
        seed: the project's seed, >= 0.
        labels: what the stream is for, such as task, sampler, set size and set number.

    Raises:
        ArgumentError: the seed is negative, or a label is neither a string nor an integer.
    """
    if seed < 0:
        raise ArgumentError(f"seed is {seed}; it must be an integer >= 0.")
    for label in labels:
        if not isinstance(label, str | int):
            raise ArgumentError(f"labels has {label!r}; a label must be a string or an integer.")
    digest = hashlib.sha256(json.dumps(labels).encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))
