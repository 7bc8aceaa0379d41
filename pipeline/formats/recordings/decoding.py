"""How the messages of a channel are read, from what the channel declares, where they are no JointState of ROS."""

from __future__ import annotations

from mcap.records import Channel, Schema

from pipeline.formats.mcap.channels import Decoding
from pipeline.formats.recordings.described_states import json_states, protobuf_states
from pipeline.formats.recordings.trajectories import SCHEMAS, planned


def decoding_of(channel: Channel, schema: Schema | None) -> Decoding | None:
    """See `pipeline.formats.mcap.channels.DecodingOf`."""
    encoding = channel.message_encoding
    if encoding == "json":
        return json_states(channel.topic)
    if schema is None:
        return None
    if encoding == "protobuf" and schema.encoding == "protobuf":
        return protobuf_states(channel.topic, schema.name, schema.data)
    if encoding in ("cdr", "ros1") and schema.name in SCHEMAS:
        return planned(channel.topic, encoding, schema.encoding, schema.data)
    return None
