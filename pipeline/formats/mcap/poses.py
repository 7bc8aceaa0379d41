"""The poses on one topic: its messages put together, in order, and refused where they are no motion of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.formats.mcap.channels import LoggedBlock
from pipeline.formats.mcap.clocks import timed
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.vocabulary import CLOCKS, Clock

LONGEST_S = 30 * 86_400  # from the first pose to the last; also what float seconds still resolve to a nanosecond
FARTHEST = 1e6  # rad or m; a position beyond it is a mistake in the file, and would make MuJoCo overflow
LISTED = 32  # names in a message


@dataclass(frozen=True, eq=False)
class Poses:
    """The poses of K joints in order of time.

    Attributes:
        time_ns: (M,) strictly increasing.
        positions: (M, K) finite, rad or m.
        clock: what `time_ns` is.
        dropped: how many poses were left out for their times.
        remarks: what is odd about them, a phrase each.
    """

    time_ns: IntArray
    positions: FloatArray
    clock: Clock
    dropped: int
    remarks: tuple[str, ...]


def poses(
    topic: str, blocks: Sequence[LoggedBlock], names: tuple[str, ...], clock: Clock | None = None, least: int = 2
) -> Poses:
    """The poses of the joints `names`, in the order in which the file has them, exact repeats left out.

    Joints that come in messages of their own are put together by name: a pose is complete with the first message after
    which every joint has been heard of since the pose before it.

    Args:
        topic: named in messages.
        blocks: the topic's messages with positions; those that name none of the joints are skipped.
        names: K joints.
        clock: see `timed`.
        least: how many poses are needed.

    Raises:
        RecordingError: joints-missing, too-few-messages, not-finite, out-of-range or time-not-increasing.
    """
    used = [block for block in blocks if not set(names).isdisjoint(block.states.names)]
    _require_joints(topic, blocks, names)
    _require(topic, sum(len(block.log_ns) for block in used), names, least)
    rows, positions, remarks = _complete(used, names)
    _require(topic, len(rows), names, least)
    _check_positions(topic, positions, names)
    times = {which: _gathered(used, which)[rows] for which in CLOCKS}
    found = timed(topic, times, positions, clock)
    _require(topic, len(found.time_ns), names, least)
    _check_span(topic, found.time_ns, found.clock)
    return Poses(found.time_ns, positions[found.kept], found.clock, found.dropped, (*remarks, *found.remarks))


def without_replaced(blocks: Sequence[LoggedBlock]) -> list[LoggedBlock]:
    """The poses of planned motions but for those that a later message replaces: those from its own first pose on."""
    if not blocks:
        return []
    stamps = np.concatenate([block.states.stamp_ns for block in blocks])
    order = _places(blocks)
    place = np.concatenate([block.place for block in blocks])[order]
    stamp_ns = stamps[order]
    firsts = np.flatnonzero(np.concatenate([[True], np.diff(place) != 0]))
    begins = np.minimum.reduceat(stamp_ns, firsts)
    # the earliest begin of any later message
    later = np.concatenate([np.minimum.accumulate(begins[::-1])[::-1][1:], [np.iinfo(np.int64).max]])
    kept = np.empty(len(order), dtype=bool)
    kept[order] = stamp_ns < np.repeat(later, np.diff([*firsts, len(order)]))
    rest, at = [], 0
    for block in blocks:
        rows = kept[at : at + len(block.place)]
        at += len(block.place)
        if rows.any():
            states = replace(block.states, stamp_ns=block.states.stamp_ns[rows], positions=block.states.positions[rows])
            rest.append(LoggedBlock(block.place[rows], block.log_ns[rows], block.publish_ns[rows], states))
    return rest


def listed(names: Sequence[str]) -> str:
    """Names as a message lists them: the first ones, and how many more there are."""
    more = len(names) - LISTED
    return ", ".join([*names[:LISTED], *([f"and {more} more"] if more > 0 else [])])


def _require_joints(topic: str, blocks: Sequence[LoggedBlock], names: tuple[str, ...]) -> None:
    there = dict.fromkeys(name for block in blocks for name in block.states.names)
    missing = [name for name in names if name not in there]
    if missing:
        raise rejection(
            "joints-missing", f"No message on {topic} has {listed(missing)}; they have {listed(list(there))}."
        )


def _require(topic: str, count: int, names: tuple[str, ...], least: int) -> None:
    if count < least:
        raise rejection(
            "too-few-messages",
            f"Topic {topic} has {count} pose{'s' * (count != 1)} of {listed(names)}; {least} or more are needed.",
        )


def _places(blocks: Sequence[LoggedBlock]) -> IntArray:
    return np.argsort(np.concatenate([block.place for block in blocks]), kind="stable")


def _gathered(blocks: Sequence[LoggedBlock], clock: Clock) -> IntArray:
    """(n,) ns of all messages in the order of the file, by one of the clocks."""
    columns = [
        block.states.stamp_ns if clock == "header" else block.publish_ns if clock == "publish" else block.log_ns
        for block in blocks
    ]
    return np.concatenate(columns)[_places(blocks)]


def _complete(blocks: Sequence[LoggedBlock], names: tuple[str, ...]) -> tuple[IntArray, FloatArray, tuple[str, ...]]:
    """Which messages complete a pose, the poses (M, K), and a remark if not all messages do."""
    order = _places(blocks)
    positions = np.concatenate([_columns(block, names) for block in blocks])[order]
    heard = [np.isin(names, block.states.names) for block in blocks]
    if all(joints.all() for joints in heard):
        return np.arange(len(order)), positions, ()
    has = np.concatenate([np.tile(joints, (len(block.log_ns), 1)) for joints, block in zip(heard, blocks, strict=True)])
    has = has[order]
    last = np.maximum.accumulate(np.where(has, np.arange(len(has))[:, None], -1), axis=0)
    rows, before = [], -1
    for row, oldest in enumerate(last.min(axis=1).tolist()):
        if oldest > before:
            rows.append(row)
            before = row
    complete = np.array(rows, dtype=np.intp)
    partial = int((~has.all(axis=1)).sum())
    remark = f"{partial} of {len(has)} messages have some of the joints only, so poses are put together by name"
    return complete, np.take_along_axis(positions, last[complete], axis=0), (remark,)


def _columns(block: LoggedBlock, names: tuple[str, ...]) -> FloatArray:
    """(k, K) positions, NaN for joints that the messages do not have."""
    if block.states.names == names:
        return block.states.positions
    there = [j for j, name in enumerate(names) if name in block.states.names]
    columns = np.full((len(block.log_ns), len(names)), np.nan)
    columns[:, there] = block.states.positions[:, [block.states.names.index(names[j]) for j in there]]
    return columns


def _check_positions(topic: str, positions: FloatArray, names: tuple[str, ...]) -> None:
    if not np.isfinite(positions).all():
        row, column = np.argwhere(~np.isfinite(positions))[0]
        raise rejection("not-finite", f"Pose {row + 1} on {topic} has {names[column]} at {positions[row, column]}.")
    if (np.abs(positions) > FARTHEST).any():
        row, column = np.argwhere(np.abs(positions) > FARTHEST)[0]
        raise rejection(
            "out-of-range",
            f"Pose {row + 1} on {topic} has {names[column]} at {positions[row, column]:g}; no joint goes beyond "
            f"{FARTHEST:g}.",
        )


def _check_span(topic: str, time_ns: IntArray, clock: Clock) -> None:
    span_s = (int(time_ns[-1]) - int(time_ns[0])) / 1e9
    if span_s > LONGEST_S:
        raise rejection(
            "out-of-range",
            f"The poses on {topic} span {span_s / 86_400:.4g} days by their {clock} time; one demonstration takes at "
            f"most {LONGEST_S / 86_400:g}.",
        )
