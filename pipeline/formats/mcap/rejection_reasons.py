"""Why a recording cannot be used: the closed set of codes in `rejected.parquet`, column `reason`."""

from __future__ import annotations

from typing import Literal, get_args

from pipeline.errors import RecordingError
from pipeline.terminal import plain

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
    "out-of-range",  # a position is beyond what any joint reaches, or the times beyond what one demonstration takes
    "too-few-messages",  # fewer than two poses
    "time-not-increasing",  # two different poses at one time, or time runs backwards
    "reserved-name",  # the file or its participant has a name that tables cannot use or use for something else
    "bad-metadata",  # what the recording says of itself is not what it may say
    "does-not-move",  # the arm never leaves its first pose (found while trimming, pipeline.trajectories.timebase)
]
REASONS: tuple[Reason, ...] = get_args(Reason)
LONGEST_DETAIL = 2000  # characters


def rejection(reason: Reason, detail: str) -> RecordingError:
    """The error for one of the `REASONS`, with a sentence for a person; what it quotes from a file is made harmless."""
    return RecordingError(reason, plain(detail, LONGEST_DETAIL))
