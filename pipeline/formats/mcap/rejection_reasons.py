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
    "unsupported-encoding",  # a message is neither plain CDR nor ROS 1
    "too-large",  # reading on would cost more memory or time than the limits allow
    "no-joint-states",  # no readable JointState channel, or not on the topic asked for
    "ambiguous-topic",  # several topics could be meant
    "joints-missing",  # a joint that is asked for is not recorded
    "not-finite",  # a position is NaN or infinite
    "out-of-range",  # a position is beyond what any joint reaches, or the times beyond what one demonstration takes
    "too-few-messages",  # fewer than two poses
    "time-not-increasing",  # time runs backwards, by more than a late message
    "reserved-name",  # the file or its participant has a name that tables cannot use or use for something else
    "bad-metadata",  # what the recording says of itself is not what it may say
    "does-not-move",  # the arm never leaves its first pose (found while trimming, pipeline.trajectories.timebase)
    "beyond-limits",  # a joint is where its limits in the scene do not let it be
    "gap",  # nothing was recorded for a while in which the arm moved
    "jump",  # a joint is elsewhere from one sample to the next
    "too-fast",  # a joint moves faster than arms do
    "several-motions",  # the arm comes back and leaves again, or rests for long: more than one demonstration
    "far-ends",  # it starts or ends elsewhere than the task's alternatives
    "another-task",  # what the recording says of itself names another task
    "incomplete-bag",  # a part of a split recording is missing or cannot be used
    "same-name",  # two recordings would have the same demonstration_id
    "not-read",  # a file or folder that may hold recordings, in a form that is not read
    "copy",  # the same motion as another recording of the folder, which is used
    "not-a-recording",  # another file in the folder, such as a note
]
REASONS: tuple[Reason, ...] = get_args(Reason)
SET_ASIDE: frozenset[Reason] = frozenset({"copy", "not-a-recording"})
"""Of what is said and stops nothing, as no demonstration is missing."""
LONGEST_DETAIL = 2000  # characters


def rejection(reason: Reason, detail: str) -> RecordingError:
    """The error for one of the `REASONS`, with a sentence for a person; what it quotes from a file is made harmless."""
    return RecordingError(reason, plain(detail, LONGEST_DETAIL))
