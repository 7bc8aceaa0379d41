"""The two timelines of a recording: the clock of the replay, and how many demonstrations have come in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

TIMELINE = "replay"
DEMONSTRATIONS = "demonstrations"


def at(recording: rr.RecordingStream, time_s: float, step: int) -> None:
    """Set the time of what is logged next, on both timelines.

    Args:
        recording: the recording that is logged to.
        time_s: s, on the clock.
        step: number of demonstrations that have come in.
    """
    recording.set_time(TIMELINE, duration=time_s)
    recording.set_time(DEMONSTRATIONS, sequence=step)


def columns(time_s: ArrayLike, step: ArrayLike) -> list[rr.TimeColumn]:
    """The same for many rows at once, (M,) each, or one step for all."""
    time_s = np.asarray(time_s, dtype=np.float64)
    steps = np.broadcast_to(np.asarray(step, dtype=np.int64), time_s.shape)
    return [rr.TimeColumn(TIMELINE, duration=time_s), rr.TimeColumn(DEMONSTRATIONS, sequence=steps)]
