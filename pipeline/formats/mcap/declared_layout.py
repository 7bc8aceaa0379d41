"""What the text of a schema says about the layout of JointState messages: the text decides, not the name.

A text is read as ROS writes it: lines of type and name, comments and constants left out, then the definitions of the
types it uses, each behind a line of `=` and a line `MSG: type`. IDL of ROS 2 is read as far as its structs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from pipeline.formats.mcap.rejection_reasons import rejection

Fields = list[tuple[str, str]]
"""Type and name of each field, in order."""

POSITION = "position"
USUAL = (POSITION, "velocity", "effort")
ENCODINGS = {"cdr": ("ros2msg", "ros2idl", "omgidl"), "ros1": ("ros1msg",)}
"""Encodings of messages that are read, and those of a schema that describes them."""
MOST_CHARACTERS = 100_000
MOST_ARRAYS = 16
_TIME = [("int32", "sec"), ("uint32", "nanosec")]
_SEPARATOR = re.compile(r"^=+\s*$", re.MULTILINE)
_STRUCT = re.compile(r"struct\s+(\w+)\s*\{([^{}]*)\}")
_IDL_TYPES = {
    "sequence<double>": "float64[]", "sequence<string>": "string[]", "long": "int32", "unsigned long": "uint32"
}  # fmt: skip


@dataclass(frozen=True)
class Declared:
    """How the numbers of a message follow each other.

    Attributes:
        arrays: names of the arrays of float64, in order, behind the header and the names of the joints.
        said: a remark, if the text leaves something open.
    """

    arrays: tuple[str, ...] = USUAL
    said: str | None = None

    @property
    def position(self) -> int:
        """Which of the arrays has the positions."""
        return self.arrays.index(POSITION)


def declared(topic: str, encoding: str, schema_encoding: str, text: bytes) -> Declared:
    """The layout that a schema declares.

    Args:
        topic: for messages.
        encoding: of the channel's messages, `cdr` or `ros1`.
        schema_encoding: of the schema.
        text: the schema's data.

    Raises:
        RecordingError: unsupported-encoding; the schema is in another language than the messages, or declares fields
            that are not read.
    """
    types = declared_types(topic, encoding, schema_encoding, text)
    if types is None:
        return Declared(said=f"the schema of {topic} has no text, so the usual fields of JointState are assumed")
    arrays = _arrays(types, encoding)
    if arrays is None:
        fields = ", ".join(f"{kind} {name}" for kind, name in types.get("", [])[:MOST_ARRAYS])
        raise rejection(
            "unsupported-encoding",
            f"The schema of topic {topic} declares a JointState of ({fields or 'no fields'}), and read is one of a "
            "header with stamp and frame_id, string[] name, and arrays float64[], position among them; convert the "
            "recording to sensor_msgs/msg/JointState.",
        )
    usual = arrays == USUAL
    return Declared(arrays, None if usual else f"the schema of {topic} puts {', '.join(arrays)} in this order")


def declared_types(
    topic: str, encoding: str, schema_encoding: str, text: bytes, root: str = "JointState"
) -> dict[str, Fields] | None:
    """The fields of each type that a schema defines, those of the messages themselves under the name ''.

    Args:
        topic, encoding, schema_encoding, text: as in `declared`.
        root: the messages' type, without its package.

    Returns:
        None if the schema has no text.

    Raises:
        RecordingError: unsupported-encoding or too-large.
    """
    if schema_encoding not in ENCODINGS[encoding]:
        raise rejection(
            "unsupported-encoding",
            f"Topic {topic} says that its messages are {encoding!r} and its schema {schema_encoding!r}; with "
            f"{encoding} goes {' or '.join(ENCODINGS[encoding])}, so one of the two is wrong.",
        )
    if not text.strip():
        return None
    if len(text) > MOST_CHARACTERS:
        raise rejection("too-large", f"The schema of topic {topic} has {len(text)} bytes; at most {MOST_CHARACTERS}.")
    plain = text.decode("utf-8", "replace")
    return dict(_idl(plain, root) if schema_encoding.endswith("idl") else _messages(plain))


def _arrays(types: dict[str, Fields], encoding: str) -> tuple[str, ...] | None:
    """The names of the arrays, or None if the fields are others than can be read."""
    root = types.get("", [])
    if [name for _, name in root[:2]] != ["header", "name"] or root[1][0] != "string[]":
        return None
    if not header_is_usual(root[0][0], types, encoding):
        return None
    rest = root[2:]
    names = tuple(name for _, name in rest)
    floats = all(kind == "float64[]" for kind, _ in rest)
    return names if floats and POSITION in names and len(set(names)) == len(names) <= MOST_ARRAYS else None


def header_is_usual(kind: str, types: dict[str, Fields], encoding: str) -> bool:
    """Whether a field of this type is the header that ROS has, as far as the text says."""
    if kind.split("/")[-1] != "Header":
        return False
    fields = fields_of(kind, types)
    if fields is None:  # a text without the definitions of the types it uses
        return True
    if encoding == "ros1":
        return fields == [("uint32", "seq"), ("time", "stamp"), ("string", "frame_id")]
    if len(fields) != 2 or fields[0][1] != "stamp" or fields[1] != ("string", "frame_id"):
        return False
    time = fields_of(fields[0][0], types)
    return fields[0][0].split("/")[-1] == "Time" and time in (None, _TIME)


def fields_of(kind: str, types: dict[str, Fields]) -> Fields | None:
    """The fields of a type, or None if the text does not define it."""
    last = kind.split("/")[-1]
    return next((fields for name, fields in types.items() if name and name.split("/")[-1] == last), None)


def _messages(text: str) -> Iterator[tuple[str, Fields]]:
    """Each definition of a text of ROS, the first under the name ''."""
    for place, part in enumerate(_SEPARATOR.split(text)):
        name = ""
        lines = [line.partition("#")[0].strip() for line in part.splitlines()]
        lines = [line for line in lines if line]
        if place:
            if not lines or not lines[0].startswith("MSG:"):
                continue
            name = lines.pop(0).removeprefix("MSG:").strip()
        yield name, [field for line in lines if (field := _field(line)) is not None]


def _field(line: str) -> tuple[str, str] | None:
    """Type and name of a line; None for a constant."""
    words = line.split(None, 2)
    if len(words) < 2:
        return line, ""
    if "=" in words[1] or (len(words) > 2 and words[2].startswith("=")):
        return None
    return words[0], words[1]


def _without_remarks(text: str) -> str:
    """IDL without comments and annotations, in one pass."""
    kept = []
    while text:
        before, found, text = text.partition("/*")
        kept.append(before)
        if found:
            text = text.partition("*/")[2]
    lines = "".join(kept).splitlines()
    return "\n".join(line.partition("//")[0] for line in lines if not line.lstrip().startswith("@"))


def _idl(text: str, root: str) -> Iterator[tuple[str, Fields]]:
    """Each struct of a text of IDL, `root` under the name ''."""
    for name, body in _STRUCT.findall(_without_remarks(text)):
        fields = []
        for statement in body.split(";"):
            words = statement.split()
            if words:
                kind = " ".join(words[:-1]).replace("::", "/")
                kind = re.sub(r"\s*([<>])\s*", r"\1", kind)
                fields.append((_IDL_TYPES.get(kind, kind), words[-1]))
        yield ("" if name.rstrip("_") == root else name.rstrip("_")), fields
