"""Stage: the recordings of a task, of whatever origin, as demonstrations of T waypoints each."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from pipeline.errors import RecordingError, StageError, few_of
from pipeline.formats.mcap.joint_states import JointRecording, joined
from pipeline.formats.mcap.rejection_reasons import SET_ASIDE
from pipeline.formats.parquet.tables import write_table
from pipeline.formats.recordings.folders import PARTICIPANTS, Bag, read_folder, sequences, stem_of
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.registry import parameters
from pipeline.terminal import plain
from pipeline.workspace.demonstrations import LONGEST_NAME, NAMED_BY, Intake, demonstration_row, read_bag
from pipeline.workspace.participants import participants_in
from pipeline.workspace.people import one_spelling
from pipeline.workspace.progress import tracked
from pipeline.workspace.project import Project, recorded_run, table_path
from pipeline.workspace.provenance import provenance

REJECTED = {"source": pl.String, "reason": pl.String, "detail": pl.String}
NULLABLE = {
    "true_theta": pl.String, "lost": pl.String, "remarks": pl.String, "start_apart": pl.Float64,
    "start_apart_m": pl.Float64, "goal_apart": pl.Float64, "goal_apart_m": pl.Float64,
}  # fmt: skip
SAME = 1e-9  # rad or m; waypoints nearer than this are the same motion
TOUCHING_S = 0.5  # at most between two parts of a split recording, or five of its sampling intervals
MOST_NOTES = 5
OWN = "the recording's metadata record"


def run(project: Project, name: str) -> None:
    """Write demonstrations.parquet and rejected.parquet of the task `name`.

    Raises:
        StageError: there are no recordings, or some cannot be used and the parameters do not say to go on without
            them; rejected.parquet then lists all of these, and demonstrations.parquet stays as it was.
    """
    task, settings = project.params.task(name), project.params.ingest
    with recorded_run(project, "ingest", name) as record:
        intake = Intake.of(project, name)
        found = collect(project.path(task.recordings), intake)
        if not found.rows and not found.missing:
            raise StageError(
                f"{task.recordings}: there is no recording in this folder; tasks.{name}.recordings names it, and "
                "docs/recordings.md says what is read"
            )
        inputs = [*found.inputs, *scene_files(intake.scene.path)]
        stated = provenance(
            project, parameters("ingest", name), inputs, model=model_hash(intake.scene), hashes=found.hashes
        )
        write_table(project.table(name, "rejected"), "rejected", found.rejections(), stated)
        if found.missing and (settings.on_rejected == "stop" or not found.rows):
            raise StageError(_refusal(project, name, found))
        write_table(project.table(name, "demonstrations"), "demonstrations", found.demonstrations(), stated)
        record.produced = found.summary()
        record.notes += found.notes()


def collect(folder: Path, intake: Intake) -> Found:
    """What comes of the recordings in a folder."""
    found, there = Found(), read_folder(folder, intake.columns)
    intake = replace(intake, folder=folder)
    for one in there.unused:
        found.set_aside(one.source, one.reason, one.detail)
    _follow_participants(folder, there.bags, found)
    _read(tracked(_named_once(there.bags, found), f"ingest {intake.task}"), intake, found)
    return found


def _follow_participants(folder: Path, bags: Sequence[Bag], found: Found) -> None:
    """Refuse a participants.csv that cannot be used, and say what it names that is not there."""
    try:
        listed = participants_in(folder)
    except RecordingError as error:
        found.set_aside(PARTICIPANTS, error.reason, error.detail)
        return
    if not listed.by_file:
        return
    found.inputs.append(folder / PARTICIPANTS)
    names = {name for bag in bags for name in (bag.name, bag.source, bag.files[0].name, bag.files[0].stem)}
    if unknown := listed.unknown(names | {stem_of(parts) for parts in sequences(bags)}):
        detail = f"It names {few_of(unknown)}, and no recording of the folder is called so."
        found.set_aside(PARTICIPANTS, "not-a-recording", detail)


@dataclass
class Found:
    """What came of the recordings.

    Attributes:
        rows: of demonstrations.parquet.
        rejected: rows of rejected.parquet.
        missing: how many of these may be missing demonstrations.
        inputs: files of which a hash is kept; of a pipe, which would never end, there is none.
        hashes: of the bytes that were read, by file.
    """

    rows: list[dict[str, Any]] = field(default_factory=list)
    rejected: list[dict[str, str]] = field(default_factory=list)
    missing: int = 0
    inputs: list[Path] = field(default_factory=list)
    hashes: dict[Path, str] = field(default_factory=dict)
    _recorded: dict[str, dict[str, Any]] = field(default_factory=dict)
    _named_by: Counter[str] = field(default_factory=Counter)

    def set_aside(self, source: str, reason: str, detail: str) -> None:
        """Say that something is not used."""
        self.missing += reason not in SET_ASIDE
        self.rejected.append({"source": plain(source, LONGEST_NAME + 60), "reason": reason, "detail": detail})

    def reject(self, source: str, files: Iterable[Path], error: RecordingError) -> None:
        """Say that a recording is not used."""
        files = tuple(files)
        self.set_aside(source, error.reason, error.detail)
        self.inputs += files if error.reason != "unreadable" else []

    def take(self, row: dict[str, Any], recording: JointRecording) -> None:
        """Use a demonstration, unless the same recording is used already."""
        self.inputs += recording.hashes
        self.hashes |= recording.hashes
        named_by = row.pop(NAMED_BY)
        first = self._recorded.setdefault(_content(recording), row)
        if first is not row:
            others = (
                f", and says that it is of {row['participant']!r}" if row["participant"] != first["participant"] else ""
            )
            detail = (
                f"It holds the same recording as {first['source']}, which is used{others}; one is one demonstration."
            )
            self.set_aside(row["source"], "copy", plain(detail, 4 * LONGEST_NAME))
            _remark(first, f"the same recording is also in {row['source']}{others}")
            return
        for other in self.rows:
            if np.abs(row["waypoints"] - other["waypoints"]).max() <= SAME:
                _remark(row, f"moves as {other['source']} does, at other times (remove one if it is a copy)")
        self.rows.append(row)
        self._named_by[named_by.partition(" '")[0]] += 1

    def rejections(self) -> pl.DataFrame:
        """The table of what is not used, in the order of the names."""
        return pl.DataFrame(sorted(self.rejected, key=lambda row: row["source"]), REJECTED)

    def demonstrations(self) -> pl.DataFrame:
        """The table of the demonstrations, of which there is at least one."""
        names = one_spelling([row["participant"] for row in self.rows])
        for row, participant in zip(self.rows, names, strict=True):
            if row["participant"] != participant:
                _remark(row, f"participant {row['participant']!r} is taken for {participant!r}, who is spelt otherwise")
            row["participant"] = participant
        table = pl.DataFrame(self.rows, schema_overrides=NULLABLE)
        return table.with_columns(waypoints=pl.Series(np.stack([row["waypoints"] for row in self.rows])))

    def summary(self) -> str:
        """One phrase for the record of the run."""
        salvaged = sum(row["salvaged"] for row in self.rows)
        remarked = sum(row["remarks"] is not None for row in self.rows)
        aside = len(self.rejected) - self.missing
        return ", ".join(
            [
                f"{len(self.rows)} demonstrations",
                *([f"{salvaged} of them salvaged"] if salvaged else []),
                *([f"{remarked} of them with remarks"] if remarked else []),
                *([f"{self.missing} rejected"] if self.missing else []),
                *([f"{aside} set aside"] if aside else []),
            ]
        )

    def people(self) -> str:
        """A sentence on how many people there are, and what says whose a recording is."""
        people = list(dict.fromkeys(one_spelling([row["participant"] for row in self.rows])))
        ways = [
            f"{by} ({count})" if len(self._named_by) > 1 else by for by, count in sorted(self._named_by.items()) if by
        ]
        alone = self._named_by[""]
        if not ways:
            return (
                f"Participants: {len(people)}, one for each recording, as nothing says whose one is; metadata, a table "
                f"{PARTICIPANTS} or --reading 'file_name={{participant}}_*' can."
            )
        by_itself = f"; {alone} that nothing names are participants of their own" if alone else ""
        return f"Participants: {len(people)} ({few_of(people)}), by {', '.join(ways)}{by_itself}."

    def notes(self) -> list[str]:
        """What is odd about the recordings together, and about each."""
        clocks = sorted({row["clock"] for row in self.rows})
        mixed = (
            [
                f"times are of different clocks: {', '.join(_counted(self.rows, clock) for clock in clocks)}; set "
                "ingest.clock"
            ]
            if len(clocks) > 1
            else []
        )
        aside = [f"{row['source']}: {row['detail']}" for row in self.rejected if row["reason"] in SET_ASIDE]
        said = [f"{row['source']}: {row['remarks']}" for row in self.rows if row["remarks"] is not None]
        more = len(aside) + len(said) - MOST_NOTES
        listed = [*aside, *said][:MOST_NOTES]
        named_by = {by: count for by, count in sorted(self._named_by.items()) if by}
        people = (
            [f"participants are named by {', '.join(f'{by} ({count})' for by, count in named_by.items())}"]
            if set(named_by) - {OWN}
            else []
        )
        return [
            *mixed,
            *people,
            *listed,
            *(
                [f"and {more} more remarks, in the column remarks of demonstrations.parquet and in rejected.parquet"]
                if more > 0
                else []
            ),
        ]


def _counted(rows: list[dict[str, Any]], clock: str) -> str:
    return f"{clock} of {sum(row['clock'] == clock for row in rows)}"


def _remark(row: dict[str, Any], remark: str) -> None:
    row["remarks"] = remark if row["remarks"] is None else f"{row['remarks']}; {remark}"


def _content(recording: JointRecording) -> str:
    """A hash of what was recorded, whatever the file is called and however it is compressed."""
    return hashlib.sha256(recording.time_ns.tobytes() + recording.positions.tobytes()).hexdigest()


def _named_once(bags: Iterable[Bag], found: Found) -> list[Bag]:
    """The bags but for those whose demonstrations would have the name of another."""
    taken: dict[str, Bag] = {}
    for bag in bags:
        first = taken.setdefault(bag.name, bag)
        if first is not bag:
            detail = f"{first.source} would be the same demonstration, {bag.name!r}; rename one of the files."
            found.set_aside(bag.source, "same-name", detail)
    return list(taken.values())


def _read(bags: Iterable[Bag], intake: Intake, found: Found) -> None:
    for run_of in sequences(list(bags)):
        parts: list[tuple[Bag, JointRecording]] = []
        for bag in run_of:
            try:
                recording = read_bag(bag, intake)
            except RecordingError as error:
                found.reject(bag.source, bag.files, error)
                _finish(parts, intake, found)
                continue
            if parts and not _continues(parts[-1][1], recording, intake):
                _finish(parts, intake, found)
            parts.append((bag, recording))
        _finish(parts, intake, found)


def _continues(before: JointRecording, after: JointRecording, intake: Intake) -> bool:
    """Whether one recording begins when and where another ends, so that both are parts of one."""
    alike = (before.topic, before.clock) == (after.topic, after.clock)
    wait_s = (int(after.time_ns[0]) - int(before.time_ns[-1])) / 1e9
    usual_s = float(np.median(np.diff(before.time_ns))) / 1e9
    moved = np.abs(after.positions[0] - before.positions[-1])
    moved = np.where(intake.scene.continuous, np.abs(moved - 2 * np.pi * np.rint(moved / (2 * np.pi))), moved)
    return alike and 0 < wait_s <= min(TOUCHING_S, 5 * usual_s) and bool((moved <= intake.settings.jump_rad).all())


def _finish(parts: list[tuple[Bag, JointRecording]], intake: Intake, found: Found) -> None:
    """Make one demonstration of recordings that follow each other, and forget them."""
    if not parts:
        return
    files = [file for bag, _ in parts for file in bag.files]
    try:
        recording = joined([recording for _, recording in parts])
        found.take(demonstration_row(stem_of([bag for bag, _ in parts]), recording, intake), recording)
    except RecordingError as error:
        found.reject(parts[0][0].source, files, error)
    parts.clear()


def _refusal(project: Project, name: str, found: Found) -> str:
    wrong = [row for row in found.rejected if row["reason"] not in SET_ASIDE]
    first = wrong[0]
    others = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
    total = len(wrong) + len(found.rows)
    remedy = "mend or remove them, or set ingest.on_rejected to continue" if found.rows else "mend or remove them"
    return (
        f"{len(wrong)} of {total} recordings in {project.params.task(name).recordings} cannot be used: "
        f"{first['source']} ({first['reason']}): {first['detail'].rstrip('.')}{others}; all are listed in "
        f"{table_path(name, 'rejected')}; {remedy}"
    )
