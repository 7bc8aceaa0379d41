"""What reading one recording may cost, and the meter that counts it."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.formats.mcap.rejection_reasons import rejection

FILTER = "keep only the joint states with `mcap filter --include-topic-regex`"


@dataclass(frozen=True)
class Limits:
    """What reading one file may cost.

    Attributes:
        stored_bytes: longest file, which is read to its end for its checksum, holes in it included.
        record_bytes: longest record, as stored.
        chunk_bytes: longest chunk, inflated.
        total_bytes: all chunks and loose records together, inflated.
        ratio: inflated over stored size of a chunk that inflates to more than `ratio_floor_bytes`.
        declared_bytes: all schemas, channels and metadata records together.
        message_bytes: longest message that is decoded one by one, inflated.
        joint_states: messages on one JointState channel.
        joint_values: positions in all JointState messages together.
        steps: what is looked at one by one: a record that is unlike the one before it is 1 step, an opened chunk or a
            new layout of messages about as many as the time it takes.
    """

    stored_bytes: int = 1 << 30
    record_bytes: int = 64 << 20
    chunk_bytes: int = 64 << 20
    total_bytes: int = 1 << 30
    ratio: int = 1000
    ratio_floor_bytes: int = 4 << 20
    declared_bytes: int = 16 << 20
    message_bytes: int = 1 << 20
    joint_states: int = 2_000_000
    joint_values: int = 16_000_000
    steps: int = 1_000_000


class Meter:
    """Counts what reading one file costs, and refuses what goes beyond the limits."""

    def __init__(self, limits: Limits, remedy: str = FILTER) -> None:
        self.limits, self._remedy = limits, remedy
        self._inflated = self._declared = self._values = self._steps = 0

    def inflate(self, size: int) -> None:
        """Pay for `size` bytes of records."""
        self._inflated += size
        if self._inflated > self.limits.total_bytes:
            raise rejection(
                "too-large", f"The file inflates to more than {self.limits.total_bytes} bytes; {self._remedy}."
            )

    def declare(self, size: int) -> None:
        """Pay for a schema, channel or metadata record of `size` bytes."""
        self._declared += size
        if self._declared > self.limits.declared_bytes:
            raise rejection(
                "too-large",
                f"The file holds more than {self.limits.declared_bytes} bytes of schemas, channels and metadata; "
                f"{self._remedy}.",
            )

    def hold(self, values: int) -> None:
        """Pay for `values` positions that are kept."""
        self._values += values
        if self._values > self.limits.joint_values:
            raise rejection(
                "too-large",
                f"The file holds more than {self.limits.joint_values} joint positions; "
                "cut the recording to one demonstration.",
            )

    def step(self, count: int = 1) -> None:
        """Pay for `count` steps."""
        self._steps += count
        if self._steps > self.limits.steps:
            raise rejection(
                "too-large",
                f"The file takes more than {self.limits.steps} steps to read, for its many small or differing records; "
                f"{self._remedy}.",
            )
