"""Motions as recordings: one MCAP file each, as a ROS 2 driver's bag holds them."""

from __future__ import annotations

from pathlib import Path

from pipeline.formats.mcap.writer import METADATA, write_joint_states
from pipeline.formats.motions.named_motions import MotionSet

TOPIC = "/joint_states"
_LONGEST = 200  # of a file's name without its ending, bytes


def write_mcap(folder: Path, motions: MotionSet) -> None:
    """Write NAME.mcap for each motion: CDR `sensor_msgs/msg/JointState` on `TOPIC`, stamped with its own times.

    Metadata record `demonstration` says whose it is. So the folder can be a task's `recordings`.
    """
    taken: set[str] = set()
    for motion in motions.motions:
        stem = file_name(motion.name, taken)
        about = {"participant": motion.participant, "demonstration_id": motion.name, **motion.about}
        write_joint_states(
            folder / f"{stem}.mcap", motion.begin_ns + motion.time_ns, motions.joints, motion.positions,
            topic=TOPIC, metadata={METADATA: about, "export": {"task": motions.task}},
        )  # fmt: skip


def file_name(name: str, taken: set[str]) -> str:
    """A name for a file, the same where that is one that every system takes, and different from those taken before."""
    plain = "".join(letter if letter.isalnum() or letter in "-_.+=@ " else "_" for letter in name)
    plain = plain.encode()[:_LONGEST].decode(errors="ignore").strip(" ").lstrip(".") or "motion"
    stem, number = plain, 1
    while stem.casefold() in taken:
        number += 1
        stem = f"{plain} ({number})"
    taken.add(stem.casefold())
    return stem
