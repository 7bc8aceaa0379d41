"""Which of a recording's JointState topics has the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.formats.mcap.channels import LoggedBlock
from pipeline.formats.mcap.poses import LISTED, listed
from pipeline.formats.mcap.rejection_reasons import rejection

USUAL_NAME = "joint_states"  # of what a driver measured, by ROS's custom
FULLER = 2  # times as many messages


@dataclass(frozen=True)
class Choice:
    """A topic, and why it was chosen if there were several; the reason is a phrase."""

    topic: str
    remark: str | None = None


def choose_topic(by_topic: Mapping[str, Sequence[LoggedBlock]], joints: Sequence[str] | None) -> Choice:
    """The topic that has all `joints`; of several, the one named `.../joint_states`, else the one clearly fuller.

    Raises:
        RecordingError: ambiguous-topic or joints-missing.
    """
    names = {topic: joint_names(blocks) for topic, blocks in by_topic.items()}
    fitting = sorted(topic for topic in names if names[topic] and set(joints or ()) <= set(names[topic]))
    if not fitting and joints is None:
        fitting = sorted(names)
    if len(fitting) == 1:
        return Choice(fitting[0])
    if not fitting:
        found = "; ".join(f"{topic}: {listed(names[topic]) or 'none'}" for topic in sorted(names)[:LISTED])
        raise rejection("joints-missing", f"No topic has all of {listed(joints or ())}; recorded are {found}.")
    counts = {topic: sum(len(block.log_ns) for block in by_topic[topic] if block.states.names) for topic in fitting}
    usual = [topic for topic in fitting if topic.rsplit("/", 1)[-1] == USUAL_NAME]
    most, next_most = sorted(fitting, key=lambda topic: -counts[topic])[:2]
    if len(usual) == 1:
        chosen, why = usual[0], f"for its name, .../{USUAL_NAME}"
    elif counts[most] >= FULLER * counts[next_most]:
        chosen, why = most, f"as it has {counts[most]:,} messages and no other more than {counts[next_most]:,}"
    else:
        fit = "hold all joints" if joints else "hold joint states"
        raise rejection(
            "ambiguous-topic",
            f"The topics {listed(fitting)} {fit}; name the one to use in ingest.topic of params.yaml.",
        )
    others = listed([topic for topic in fitting if topic != chosen])
    return Choice(chosen, f"{chosen} is read {why}, and not {others} (ingest.topic names another)")


def joint_names(blocks: Sequence[LoggedBlock]) -> tuple[str, ...]:
    """All joints of some messages, in the order in which they come."""
    return tuple(dict.fromkeys(name for block in blocks for name in block.states.names))
