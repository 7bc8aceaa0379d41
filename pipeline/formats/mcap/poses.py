"""The poses on one topic: its messages put together, in order, and refused where they are no motion of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.formats.mcap.channels import LoggedBlock
from pipeline.formats.mcap.rejection_reasons import rejection

Clock = Literal["header", "log"]
LONGEST_S = 30 * 86_400  # from the first pose to the last; also what float seconds still resolve to a nanosecond
FARTHEST = 1e6  # rad or m; a position beyond it is a mistake in the file, and would make MuJoCo overflow
LISTED = 32  # names in a message


def poses(topic: str, blocks: Sequence[LoggedBlock], names: tuple[str, ...]) -> tuple[IntArray, FloatArray, Clock]:
    """The poses of the joints `names`, in the order in which the file has them, exact repeats left out.

    Args:
        topic: named in messages.
        blocks: the topic's messages with positions; those that name none of the joints are skipped.
        names: K joints.

    Returns:
        (M,) strictly increasing ns and (M, K) finite positions, M >= 2, and which clock the times are of.

    Raises:
        RecordingError: joints-missing, too-few-messages, not-finite, out-of-range or time-not-increasing.
    """
    used = [block for block in blocks if not set(names).isdisjoint(block.states.names)]
    _require_joints(topic, used, names)
    _require_two(topic, sum(len(block.log_ns) for block in used), names)
    time_ns, positions, clock = _in_order(used, names)
    _check_positions(topic, positions, names)
    time_ns, positions = _without_repeats(time_ns, positions)
    _require_two(topic, len(time_ns), names)
    _check_times(topic, time_ns, clock)
    return time_ns, positions, clock


def listed(names: Sequence[str]) -> str:
    """Names as a message lists them: the first ones, and how many more there are."""
    more = len(names) - LISTED
    return ", ".join([*names[:LISTED], *([f"and {more} more"] if more > 0 else [])])


def _require_joints(topic: str, blocks: Sequence[LoggedBlock], names: tuple[str, ...]) -> None:
    for block in blocks:
        missing = [name for name in names if name not in block.states.names]
        if missing:
            raise rejection(
                "joints-missing",
                f"A message on {topic} lacks {listed(missing)}; it has {listed(block.states.names)}.",
            )


def _require_two(topic: str, count: int, names: tuple[str, ...]) -> None:
    if count < 2:
        raise rejection("too-few-messages", f"Topic {topic} has {count} pose of {listed(names)}; 2 or more are needed.")


def _in_order(blocks: Sequence[LoggedBlock], names: tuple[str, ...]) -> tuple[IntArray, FloatArray, Clock]:
    """Times and positions as the file has them; by header stamps if every message has one that is not zero."""
    log_ns = np.concatenate([block.log_ns for block in blocks])
    stamp_ns = np.concatenate([block.states.stamp_ns for block in blocks])
    positions = np.concatenate([_columns(block, names) for block in blocks])
    order = np.argsort(np.concatenate([block.place for block in blocks]), kind="stable")
    clock: Clock = "header" if (stamp_ns > 0).all() else "log"
    return (stamp_ns if clock == "header" else log_ns)[order], positions[order], clock


def _columns(block: LoggedBlock, names: tuple[str, ...]) -> FloatArray:
    if block.states.names == names:
        return block.states.positions
    return block.states.positions[:, [block.states.names.index(name) for name in names]]


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


def _without_repeats(time_ns: IntArray, positions: FloatArray) -> tuple[IntArray, FloatArray]:
    """Without those that have the time and the pose of the one before them."""
    fresh = np.concatenate([[True], (np.diff(time_ns) != 0) | (positions[1:] != positions[:-1]).any(axis=1)])
    return time_ns[fresh], positions[fresh]


def _check_times(topic: str, time_ns: IntArray, clock: Clock) -> None:
    step_ns = np.diff(time_ns)
    if (step_ns <= 0).any():
        row = int((step_ns <= 0).argmax())
        raise rejection(
            "time-not-increasing",
            f"Pose {row + 2} on {topic} comes {step_ns[row] / 1e9:g} s after the pose before it by its {clock} time; "
            "times must increase.",
        )
    span_s = (int(time_ns[-1]) - int(time_ns[0])) / 1e9
    if span_s > LONGEST_S:
        raise rejection(
            "out-of-range",
            f"The poses on {topic} span {span_s / 86_400:.4g} days by their {clock} time; one demonstration takes at most "
            f"{LONGEST_S / 86_400:g}.",
        )
