"""Labelled random streams. Every result has its own stream, so adding one changes no other.

Labels are purposes, positions and content. Names of files, tasks or people are no labels, as users may change them.
"""

from __future__ import annotations

import hashlib
import json

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ArgumentError


def content_key(*arrays: FloatArray) -> str:
    """A label made from the content of arrays: the SHA-256 of their numbers, rounded to six decimals.

    They are rounded because the last bits may depend on how the numbers were computed.
    """
    rounded = [np.round(np.asarray(array, dtype=np.float64), 6) + 0.0 for array in arrays]  # -0.0 becomes 0.0
    return hashlib.sha256(b"".join(values.astype("<f8").tobytes() for values in rounded)).hexdigest()


def child_rng(seed: int, *labels: str | int) -> np.random.Generator:
    """The random generator for `labels` under `seed`. It does not depend on what else is drawn, or in which order.

    The labels are hashed (SHA-256 of their JSON, so ("a", 1) and ("a", "1") differ) into the entropy of a
    `SeedSequence`. Streams of different labels are independent for every practical purpose.

    Args:
        seed: the project's seed, >= 0.
        labels: what the stream is for, such as a purpose, a set size and a set number.

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
