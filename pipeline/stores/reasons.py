"""Why a recording cannot be used: the closed set of codes in `rejected.parquet`, column `reason`."""

from __future__ import annotations

from typing import Literal, get_args

from pipeline.errors import RecordingError

Reason = Literal[
    "unreadable",  # the operating system would not give us the file
    "not-mcap",  # no MCAP magic at the start
    "truncated",  # the file ends before its own lengths say so
    "corrupt",  # a checksum, length, id or text contradicts the format
    "unsupported-compression",  # a chunk is neither plain, lz4 nor zstd
    "unsupported-encoding",  # a message is not plain CDR
    "too-large",  # reading on would cost more memory or time than the limits allow
    "no-joint-states",  # no readable JointState channel, or not on the topic asked for
    "ambiguous-topic",  # several topics could be meant
    "joints-missing",  # a joint that is asked for is not recorded, or not in every message
    "not-finite",  # a position is NaN or infinite
    "out-of-range",  # a position is beyond what any joint reaches
    "too-few-messages",  # fewer than two poses
    "time-not-increasing",  # two different poses at one time, or time runs backwards
    "reserved-name",  # the file is named like a word that tables use for something else
    "does-not-move",  # the arm never leaves its first pose (found while trimming, pipeline.trajectories.timebase)
]
REASONS: tuple[Reason, ...] = get_args(Reason)


def rejection(reason: Reason, detail: str) -> RecordingError:
    """The error for one of the `REASONS`, with a sentence for a person."""
    return RecordingError(reason, detail)
