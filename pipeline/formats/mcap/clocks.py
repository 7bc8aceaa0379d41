"""Which of a recording's three clocks its times are of, and which samples that clock leaves out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray, IntArray
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.vocabulary import CLOCKS, Clock

SLIGHT = 2.0  # sampling intervals that a sample may come late; what comes later says that a clock was set
SLIGHT_NS = 50_000_000  # and no more than this
_RUNS = 0.5  # share of the steps in which a clock that is used moves


@dataclass(frozen=True)
class Timed:
    """The times of samples by one clock.

    Attributes:
        clock: which.
        time_ns: (n,) of the samples that are kept, strictly increasing.
        kept: (M,) which those are.
        dropped: how many samples are left out although their pose is not that of the sample before them.
        remarks: what is odd about the times, a phrase each.
    """

    clock: Clock
    time_ns: IntArray
    kept: BoolArray
    dropped: int
    remarks: tuple[str, ...]


def timed(topic: str, times: Mapping[Clock, IntArray], positions: FloatArray, asked: Clock | None) -> Timed:
    """Times of the samples (M,) by the first clock that runs, or by the one that is asked for.

    A clock runs if it moves in at least half of the steps from one sample to the next. Exact repeats, the same pose at
    the same time, are left out. So is a sample without a header stamp (0, unless the clock begins at 0), and one whose
    time repeats or goes back by no more than `SLIGHT` sampling intervals.

    Args:
        topic: for messages.
        times: (M,) ns by each clock, in the order of the file.
        positions: (M, J) the poses.
        asked: the clock to use whatever it says; None for the first that runs.

    Raises:
        RecordingError: time-not-increasing.
    """
    remarks: list[str] = []
    clock = asked or _first_running(times, positions, remarks)
    time_ns = times[clock]
    fresh = np.flatnonzero(_fresh(time_ns, positions))
    stamped = fresh[_stamped(time_ns[fresh])] if clock == "header" else fresh
    if len(stamped) < len(fresh):
        remarks.append(f"{len(fresh) - len(stamped)} samples without a header stamp are left out")
    ahead = _ahead(topic, clock, time_ns[stamped], stamped)
    late = int((~ahead).sum())
    if late:
        remarks.append(
            f"{late} of {len(fresh)} samples left out, as their {clock} time is no later than that of the sample before"
        )
    kept = np.zeros(len(time_ns), dtype=bool)
    kept[stamped[ahead]] = True
    return Timed(clock, time_ns[kept], kept, len(fresh) - int(kept.sum()), tuple(remarks))


def _first_running(times: Mapping[Clock, IntArray], positions: FloatArray, remarks: list[str]) -> Clock:
    for clock in CLOCKS:
        time_ns = times[clock][_fresh(times[clock], positions)]
        if len(time_ns) < 2 or clock == CLOCKS[-1] or (np.diff(time_ns) != 0).mean() >= _RUNS:
            break
    if clock == "publish" and np.array_equal(times["publish"], times["log"]):
        clock = "log"  # recorders that know no other write the same time twice
    if clock != "header":
        said = "are 0" if not times["header"].any() else "do not run"
        remarks.append(f"header stamps {said}, so {clock} times are used")
    return clock


def _fresh(time_ns: IntArray, positions: FloatArray) -> BoolArray:
    """(M,) whether a sample differs from the one before it in time or in pose."""
    return np.concatenate([[True], (np.diff(time_ns) != 0) | (positions[1:] != positions[:-1]).any(axis=1)])


def _stamped(time_ns: IntArray) -> BoolArray:
    """(n,) whether a sample has a header stamp: one that is not 0, or the 0 at which a simulation's clock begins."""
    stamped = time_ns > 0
    if len(time_ns) > 1 and time_ns[0] == 0 and 0 < time_ns[1] <= 5 * _interval(time_ns):
        stamped[0] = True
    return stamped


def _interval(time_ns: IntArray) -> float:
    """The median step forward, ns."""
    steps = np.diff(time_ns)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def _ahead(topic: str, clock: Clock, time_ns: IntArray, rows: IntArray) -> BoolArray:
    """(n,) whether a sample is later than all before it; `rows` says which samples these are.

    Raises:
        RecordingError: one is earlier by more than what is slight.
    """
    if not len(time_ns):
        return np.zeros(0, dtype=bool)
    latest = np.maximum.accumulate(time_ns)
    behind = np.concatenate([[0], latest[:-1] - time_ns[1:]])
    wrong = behind > min(SLIGHT * _interval(time_ns), SLIGHT_NS)
    if wrong.any():
        row = int(wrong.argmax())
        others = " or ".join(other for other in CLOCKS if other != clock)
        raise rejection(
            "time-not-increasing",
            f"Pose {rows[row] + 1} on {topic} is {behind[row] / 1e9:g} s earlier than a pose before it by its {clock} "
            "time, as if a clock was set or files were joined; keep one part, with `mcap filter --start ... --end "
            f"...`, or set ingest.clock to {others} if that one runs on.",
        )
    return np.concatenate([[True], behind[1:] < 0])
