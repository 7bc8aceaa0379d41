"""What people chose, in one CSV file that grows by whole lines, each on the disk before anybody is thanked."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from pipeline.errors import SurveyError
from pipeline.survey.assignment import Assignment

COLUMNS = (
    "participant", "trial", "choice", "group", "counted", "offered", "mirrored", "chosen_at", "seconds", "screen_width",
    "screen_height",
)  # fmt: skip
MOST_BYTES = 500_000_000


class ChoicesFile:
    """The file of choices, and beside it the file `.visits` that says who was shown what.

    Both are read when they are opened, so that a server that was stopped goes on where it was. A last line that was cut
    off when the machine failed is taken away: whoever sent it has not been thanked, and their page sends it again.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.visits_path = path.with_name(path.name + ".visits")
        self.chosen: dict[str, dict[str, str]] = {}
        """Choice by trial, by participant."""
        self.assigned: dict[str, Assignment] = {}
        """What each participant was shown."""
        self._read_choices()
        self._read_visits()

    def assign(self, participant: str, given: Assignment) -> None:
        """Keep what a participant is shown."""
        self._append(self.visits_path, json.dumps({"participant": participant, **asdict(given)}))
        self.assigned[participant] = given

    def choose(self, row: Mapping[str, object]) -> None:
        """Keep a choice, a value for each of COLUMNS; a second one by the same participant in the same trial is none.

        Raises:
            SurveyError: it cannot be written.
        """
        participant, trial = str(row["participant"]), str(row["trial"])
        if trial in self.chosen.get(participant, {}):
            return
        self._append(self.path, _line([row[name] for name in COLUMNS]))
        self.chosen.setdefault(participant, {})[trial] = str(row["choice"])

    def _read_choices(self) -> None:
        if not self.path.exists():
            self._append(self.path, _line(COLUMNS))
        header = _first_line(self.path)
        if header != _line(COLUMNS):
            raise SurveyError(f"{self.path}: is no file of this survey (its columns are {header!r}); name another file")
        for row in csv.DictReader(io.StringIO(_whole_lines(self.path))):
            self.chosen.setdefault(row["participant"], {})[row["trial"]] = row["choice"]

    def _read_visits(self) -> None:
        if not self.visits_path.exists():
            return
        for number, line in enumerate(_whole_lines(self.visits_path).splitlines(), 1):
            try:
                row = json.loads(line)
                given = Assignment(tuple(map(str, row["trials"])), bool(row["mirrored"]), int(row["turn"]))
                self.assigned[str(row["participant"])] = given
            except (ValueError, KeyError, TypeError):
                raise SurveyError(
                    f"{self.visits_path}: line {number} is not what this survey writes; move the file away, and people "
                    "who come back are shown what is then due"
                ) from None

    def _append(self, path: Path, line: str) -> None:
        data = f"{line}\n".encode()
        try:
            flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
            descriptor = os.open(path, flags, 0o600)
            try:
                end = os.fstat(descriptor).st_size
                if end > MOST_BYTES:
                    raise SurveyError(f"{path}: is larger than {MOST_BYTES:,} bytes; name another file")
                if os.write(descriptor, data) != len(data):
                    os.ftruncate(descriptor, end)
                    raise SurveyError(f"{path}: cannot be written whole; free some space")
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise SurveyError(f"{path}: cannot be written ({(error.strerror or str(error)).lower()})") from None


def _first_line(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return stream.readline(1000).decode("utf-8", "backslashreplace").rstrip("\n")
    except OSError as error:
        raise SurveyError(f"{path}: cannot be read ({(error.strerror or str(error)).lower()})") from None


def _whole_lines(path: Path) -> str:
    """The text of a file up to its last line end; what is after it is taken away."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise SurveyError(f"{path}: is larger than {MOST_BYTES:,} bytes; name another file")
        data = path.read_bytes()
        end = data.rfind(b"\n") + 1
        if end != len(data):
            os.truncate(path, end)
        return data[:end].decode("utf-8")
    except OSError as error:
        raise SurveyError(f"{path}: cannot be read ({(error.strerror or str(error)).lower()})") from None
    except UnicodeDecodeError:
        raise SurveyError(f"{path}: is no text in UTF-8; name another file") from None


def _line(cells: object) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="").writerow(cells)  # type: ignore[arg-type]
    return stream.getvalue()
