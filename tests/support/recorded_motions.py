"""Motions of the small project's arm, and recordings of them in whatever way a test wants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer

from tests.support.joint_bags import JOINT_STATE, SCHEMA, payload

START, GOAL = np.array([-0.3, -0.6, 0.1]), np.array([0.3, 0.9, -0.2])  # rail (m), swing, bend (rad)
NAMES = ("rail", "swing", "bend")
BEGIN_NS, STEP_NS = 1_700_000_000 * 10**9, 10**7
TOPIC = "/arm/joints"


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a recorder saw: poses by joint name, and three times for each.

    Attributes:
        positions: (M, K).
        names: K joints.
        header_ns, log_ns: (M,); the publish time is the log time unless `publish_ns` is given.
        topic: of the messages.
        metadata: of the record `demonstration`.
        also: further topics.
    """

    positions: np.ndarray
    names: tuple[str, ...] = NAMES
    header_ns: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    log_ns: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    publish_ns: np.ndarray | None = None
    topic: str = TOPIC
    metadata: Mapping[str, str] = field(default_factory=dict)
    also: tuple[Recorded, ...] = ()

    def but(self, **changes: object) -> Recorded:
        """The same with changes."""
        return replace(self, **changes)

    def rows(self, which: object) -> Recorded:
        """Some of the samples, in the order given."""
        publish = None if self.publish_ns is None else self.publish_ns[which]
        return self.but(
            positions=self.positions[which],
            header_ns=self.header_ns[which],
            log_ns=self.log_ns[which],
            publish_ns=publish,
        )

    def later(self, by_ns: int) -> Recorded:
        """The same at another time."""
        return self.but(header_ns=self.header_ns + by_ns, log_ns=self.log_ns + by_ns)


def reach(bow: float = 0.1, samples: int = 280, step_ns: int = STEP_NS, idle: float = 0.2) -> Recorded:
    """From the scene's start to its goal, at rest for a share of the time before and after."""
    s = np.clip(np.linspace(-idle, 1 + idle, samples), 0, 1)[:, None]
    bell = s**3 * (10 - 15 * s + 6 * s**2)
    return timed(START + bell * (GOAL - START) + bow * np.sin(np.pi * bell), step_ns)


def timed(positions: np.ndarray, step_ns: int = STEP_NS) -> Recorded:
    """Poses one after another."""
    times = BEGIN_NS + step_ns * np.arange(len(positions))
    return Recorded(positions, header_ns=times, log_ns=times + 2_000_000)


def save(path: Path, recorded: Recorded, compression: CompressionType = CompressionType.ZSTD) -> Path:
    """Write it with the official writer, message by message."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start("ros2", "test")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", SCHEMA)
        channels: dict[str, int] = {}
        if recorded.metadata:
            writer.add_metadata("demonstration", dict(recorded.metadata))
        for one in (recorded, *recorded.also):
            if one.topic not in channels:
                channels[one.topic] = writer.register_channel(one.topic, "cdr", schema)
            publish = one.log_ns if one.publish_ns is None else one.publish_ns
            for row, header, log, sent in zip(one.positions, one.header_ns, one.log_ns, publish, strict=True):
                writer.add_message(channels[one.topic], int(log), payload(one.names, row, int(header)), int(sent))
        writer.finish()
    return path


def save_messages(path: Path, messages: Sequence[tuple[tuple[str, ...], np.ndarray, int]]) -> Path:
    """Write messages (names, positions, time) in their order on one topic."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        channel = writer.register_channel(TOPIC, "cdr", writer.register_schema(JOINT_STATE, "ros2msg", SCHEMA))
        for names, row, at in messages:
            writer.add_message(channel, at, payload(names, row, at), at)
        writer.finish()
    return path
