"""`lessbench watch`: the posterior as people demonstrate, recording by recording, before any stage is run again.

The alternatives, their scales and their bandwidth are those of the task's tables, and so is the explored choice space;
the demonstrations are those of the folder and nothing else. The answer is that of `dvc repro` on the same recordings
with these alternatives and this choice space, whose bound on effort the recordings may move.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.commands.serve import Live, claimed, interrupted
from pipeline.commands.watch.belief import Belief, as_data, believed, in_words
from pipeline.commands.watch.kept import write_tables
from pipeline.commands.watch.setting import read_setting
from pipeline.commands.watch.shown import arrival, shown
from pipeline.errors import RecordingError, StageError, WorkbenchError
from pipeline.formats.files.atomic import folder_written_whole
from pipeline.formats.mcap.folder_watcher import Arrivals, News
from pipeline.formats.recordings.folders import Bag
from pipeline.stages.ingest import SAME
from pipeline.terminal import plain, say
from pipeline.views.rerun.live_recording import Watched
from pipeline.workspace.demonstrations import LONGEST_NAME, NAMED_BY, demonstration
from pipeline.workspace.project import Project, recorded_run

FOLDER = "watch"  # in the task's folder of datasets: what is kept when watching ends
LOOK_S = 0.5
_json_lines: ContextVar[bool] = ContextVar("json_lines", default=False)


@dataclass(frozen=True)
class Until:
    """When watching ends, besides Ctrl-C and SIGTERM.

    Attributes:
        demonstrations: once so many are in use.
        idle_s: once nothing has come for so long.
    """

    demonstrations: int | None = None
    idle_s: float | None = None


def run(
    project: Project, folder: Path | None, name: str | None, until: Until, live: Live | None, as_json: bool = False
) -> None:
    """Watch a folder until told to end, then keep what was found in `datasets/<task>/watch`.

    With `as_json` each line that is printed is a JSON object, for programs.

    Raises:
        StageError: it is not clear which task is meant, or its tables cannot be used.
        TableError: a table is missing or not what it should be.
    """
    _json_lines.set(as_json)
    name, folder = which_task(project, folder, name)
    address = None if live is None else claimed(live)
    with recorded_run(project, "watch", name) as record:
        setting = read_setting(project, name)
        belief = Belief(setting, project.params.infer.models)
        target = project.datasets / name / FOLDER
        try:
            with folder_written_whole(target) as partial:
                with shown(partial, belief, address) as recording:
                    _tell(
                        "watching",
                        f"watching {folder}{'' if folder.is_dir() else ' (not there yet)'} for {name}: "
                        f"{len(setting.raw):,} alternatives{belief.over}, {len(setting.thetas)} thetas x "
                        f"{len(setting.betas)} betas; Ctrl-C ends",
                    )
                    session = Session(belief, Arrivals(folder), recording)
                    session.follow(until)
                if not belief.rows:
                    raise _NothingToKeep
                write_tables(partial, project, belief, session.rejected, folder)
        except _NothingToKeep:
            _tell("end", "no demonstration came, so nothing was kept")
            record.produced = "nothing: no demonstration came"
            return
        record.produced = ", ".join(session.counts())
        _tell("end", f"{record.produced}; kept in {project.shown(target)}", kept=project.shown(target))
        _tell(
            "note",
            f"these posteriors come without a verdict; `lessbench answer {name}` has the verdict on the task's own "
            "demonstrations",
        )


class _NothingToKeep(Exception):
    """Leaves what an earlier run kept where it is."""


def which_task(project: Project, folder: Path | None, name: str | None) -> tuple[str, Path]:
    """The task and the folder, each of which may say the other.

    Raises:
        StageError: neither does.
    """
    tasks = project.params.tasks
    if name is not None:
        return name, folder or project.path(project.params.task(name).recordings)
    own = {key: project.path(task.recordings).resolve() for key, task in tasks.items()}
    mine = [key for key, path in own.items() if folder is not None and path == folder.resolve()]
    if len(mine) == 1 or len(tasks) == 1:
        found = mine[0] if mine else next(iter(tasks))
        return found, folder or own[found]
    said = "no folder was given" if folder is None else f"{folder} is not the folder of recordings of exactly one task"
    raise StageError(f"{said}; say which task is meant with --task: {', '.join(tasks)}")


@dataclass(frozen=True, eq=False)
class Session:
    """A folder that is followed, and what has become of its recordings.

    Attributes:
        belief: what the demonstrations so far say.
        arrivals: what comes into the folder and goes.
        recording: in which it is shown.
        rejected: by name of file, its row of rejected.parquet.
    """

    belief: Belief
    arrivals: Arrivals
    recording: Watched
    rejected: dict[str, dict[str, str]] = field(default_factory=dict)

    def follow(self, until: Until) -> None:
        """Take recordings as they come, and forget those that go, until it is time to end."""
        for path in self._files(until):
            self._take(path)

    def counts(self) -> list[str]:
        """How many demonstrations are in use, and how many files are not."""
        used, unused = self.belief.rows, self.rejected
        unfinished = [one.name for one in self.arrivals.open if one.name not in unused and one.stem not in used]
        return [
            f"{len(used)} demonstration{'s' * (len(used) != 1)}",
            *([f"{len(unused)} not used"] if unused else []),
            *([f"{len(unfinished)} never closed ({', '.join(unfinished)})"] if unfinished else []),
        ]

    def _files(self, until: Until) -> Iterator[Path]:
        """The recordings to take, one by one, until it is time to end."""
        last = time.monotonic()
        with interrupted() as stop:
            while True:
                news = self.arrivals.look()
                if news.whole or news.gone:
                    last = time.monotonic()
                self._forget(news)
                for path in news.whole:
                    yield path
                    if stop.is_set() or self._enough(until):
                        return
                for path in news.waiting:
                    waits = f"{path.name}: not read yet, as it is not closed; its recorder may still be writing"
                    _tell("waits", waits, file=path.name)
                if until.idle_s is not None and time.monotonic() - last >= until.idle_s:
                    return
                if stop.wait(LOOK_S):
                    return

    def _enough(self, until: Until) -> bool:
        return until.demonstrations is not None and len(self.belief.rows) >= until.demonstrations

    def _take(self, path: Path) -> None:
        belief, known = self.belief, path.stem in self.belief.rows
        try:
            row = demonstration(Bag(path.stem, (path,)), belief.setting.intake)
            row.pop(NAMED_BY)
            _refuse_copy(row, belief)
            belief.take(row)
        except WorkbenchError as error:
            self._reject(path, error)
            return
        self.rejected.pop(path.name, None)
        self.recording.show(arrival(row, belief))
        line = f"{len(belief.rows):>3} {path.name}{' again' if known else ''}: {'; '.join(in_words(belief))}"
        _tell("taken", line, file=path.name, demonstrations=len(belief.rows), models=as_data(belief))

    def _reject(self, path: Path, error: WorkbenchError) -> None:
        reason, detail = (
            (error.reason, error.detail) if isinstance(error, RecordingError) else ("no-likelihood", str(error))
        )
        name = plain(path.name, LONGEST_NAME + 60)
        self.rejected[path.name] = {"source": name, "reason": reason, "detail": detail}
        _tell("rejected", f"{name}: not used ({reason}): {detail.rstrip('.')}", file=name, reason=reason, detail=detail)
        self._drop(path)

    def _forget(self, news: News) -> None:
        for path in news.gone:
            if self._drop(path):
                belief = self.belief
                line = f"{len(belief.rows):>3} {path.name} is gone: {'; '.join(in_words(belief))}"
                _tell("gone", line, file=path.name, demonstrations=len(belief.rows), models=as_data(belief))

    def _drop(self, path: Path) -> bool:
        """Forget the demonstration of a file, if there is one."""
        if path.stem not in self.belief.rows:
            return False
        self.belief.drop(path.stem)
        self.recording.remove(path.stem, self.belief.on_map(), believed(self.belief))
        return True


def _refuse_copy(row: dict[str, Any], belief: Belief) -> None:
    for key, other in belief.rows.items():
        at_once = (row["start_time_ns"], row["duration_s"]) == (other["start_time_ns"], other["duration_s"])
        if key != row["demonstration_id"] and at_once and np.abs(row["waypoints"] - other["waypoints"]).max() <= SAME:
            detail = f"It holds the same recording as {other['source']}, which is used; one is one demonstration."
            raise RecordingError("copy", detail)


def _tell(event: str, line: str, **more: object) -> None:
    """Say a line, or for programs what happened, as a JSON object on one line."""
    say(json.dumps({"event": event, "said": line, **more}) if _json_lines.get() else line)
