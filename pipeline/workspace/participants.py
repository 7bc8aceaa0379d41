"""Who made a recording, and for which task, where the recording does not say so itself.

The recording's own metadata come first, then the table `participants.csv` in the folder of recordings (columns `file`,
`participant` and, if wanted, `task`), then the name of the file, by the task's `reading.file_name`.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

from pipeline.errors import few_of
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.formats.recordings.folders import PARTICIPANTS

LARGEST_BYTES = 4 << 20
KEYS = ("participant", "task")
_PLACES = re.compile(r"(\{participant\}|\{task\}|\*)")


@dataclass(frozen=True)
class Participants:
    """What stands in participants.csv: by file, or demonstration, what it says of it."""

    by_file: Mapping[str, Mapping[str, str]] = field(default_factory=lambda: MappingProxyType({}))

    def of(self, *names: str) -> Mapping[str, str]:
        """What is said of a recording that has these names, of the first that is listed."""
        return next((self.by_file[name] for name in names if name in self.by_file), {})

    def unknown(self, names: set[str]) -> list[str]:
        """What is listed and has none of these names."""
        return [name for name in self.by_file if name not in names]


def participants_in(folder: Path | None) -> Participants:
    """What participants.csv in a folder says; nothing if there is none.

    Raises:
        RecordingError: bad-metadata.
    """
    path = None if folder is None else folder / PARTICIPANTS
    if path is None or not path.is_file():
        return Participants()
    about = path.stat()
    return _read(path, about.st_size, about.st_mtime_ns)


@lru_cache(maxsize=4)
def _read(path: Path, size: int, _: int) -> Participants:
    if size > LARGEST_BYTES:
        raise rejection("bad-metadata", f"{PARTICIPANTS} has more than {LARGEST_BYTES >> 20} MB.")
    try:
        text = path.read_bytes().decode("utf-8-sig")
        first = text.partition("\n")[0]
        rows = list(csv.reader(io.StringIO(text), delimiter=max(",;\t", key=first.count)))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise rejection("bad-metadata", f"{PARTICIPANTS} cannot be read as CSV in UTF-8 ({error}).") from error
    heads = [cell.strip().lower() for cell in rows[0]] if rows else []
    if "file" not in heads or "participant" not in heads:
        raise rejection(
            "bad-metadata",
            f"{PARTICIPANTS} has the columns {few_of(heads, 10) or 'none'}; needed are file and participant, and task "
            "if wanted.",
        )
    found: dict[str, dict[str, str]] = {}
    for number, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        cells = dict(zip(heads, (cell.strip() for cell in row), strict=False))
        file = cells.get("file", "")
        if not file:
            raise rejection("bad-metadata", f"Row {number} of {PARTICIPANTS} names no file.")
        if file in found:
            raise rejection("bad-metadata", f"Row {number} of {PARTICIPANTS} names {file!r} again; keep one.")
        found[file] = {key: cells[key] for key in KEYS if cells.get(key)}
    return Participants(found)


def by_file_name(name: str, pattern: str) -> Mapping[str, str] | None:
    """What the name of a file says by a pattern, of which each place reaches to the next text; None if it does not fit.

    Args:
        name: without its ending.
        pattern: texts and the places `{participant}`, `{task}` and `*`.
    """
    found: dict[str, str] = {}
    pieces = _PLACES.split(pattern)  # text, place, text, place, ..., text
    if not name.startswith(pieces[0]):
        return None
    rest = name[len(pieces[0]) :]
    for number, (place, text) in enumerate(zip(pieces[1::2], pieces[2::2], strict=True), 1):
        least = 0 if place == "*" else 1
        if 2 * number + 1 == len(pieces):
            at = len(rest) - len(text) if rest.endswith(text) else -1
        else:
            at = rest.find(text, least)
        if at < least:
            return None
        if place != "*":
            found[place.strip("{}")] = rest[:at]
        rest = rest[at + len(text) :]
    return None if rest else found
