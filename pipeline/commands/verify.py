"""Whether everything is still what it says it is: hashes recomputed, recordings read again, a seeded sample replayed.

Nothing is read whole but the files that are hashed: of a table only what the sample needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import polars as pl

from pipeline import params
from pipeline.commands.recomputation import Recomputation, infer_posteriors, replay_trajectories
from pipeline.errors import StageError, TableError, WorkbenchError
from pipeline.formats.parquet.checked.content_digest import content_digest
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.formats.recordings.folders import read_folder
from pipeline.replay.scene import model_hash, scene_files
from pipeline.stages.ingest import collect
from pipeline.stages.registry import STAGES, Scope, Stage, parameters, table_makers
from pipeline.trajectories.random_streams import child_rng
from pipeline.vocabulary import STUDIES
from pipeline.workspace.demonstrations import Intake
from pipeline.workspace.outputs import file_md5, output_hash
from pipeline.workspace.project import Project, recorded_runs
from pipeline.workspace.provenance import content_hash
from pipeline.workspace.scenes import load_task_scene


@dataclass
class Verified:
    """What was looked at, and every sentence about something that is no longer as it was."""

    tables: int = 0
    outputs: int = 0
    files: int = 0
    trajectories: int = 0
    posteriors: int = 0
    drift: list[str] = field(default_factory=list)

    def lines(self, name: str) -> list[str]:
        """One line per drift; if there is none, one that says what was looked at."""
        if self.drift:
            return [f"drift: {sentence}" for sentence in self.drift]
        if not self.tables:
            return [f"{name}: as they were written"]
        return [
            f"{name}: {self.tables} tables as they were made; {self.outputs} other outputs, {self.files} input hashes, "
            f"{self.trajectories} trajectories and {self.posteriors} posteriors checked again"
        ]


def verify(project: Project, name: str, sample: int) -> Verified:
    """Look at the tables of the task `name`, or of the studies.

    Args:
        project: whose tables.
        name: a task, or `studies`.
        sample: how many trajectories and how many posteriors are computed again.

    Raises:
        StageError: there is no table yet.
    """
    found = Verified()
    if name != STUDIES:
        project.params.task(name)
    made = {table: stage for table, stage in table_makers(name).items() if project.table(name, table).is_file()}
    if not made:
        raise StageError(f"{project.datasets / name}: there are no tables to verify; make them with `dvc repro`")
    known = _Known(project, name)
    recorded = _recorded(project)
    _check_outputs(found, project, name, recorded)
    with TaskTables(project.tables(name, made)) as tables:
        for table, stage in made.items():
            _check_table(found, known, tables, table, stage, recorded)
        if name != STUDIES and sample:
            rng, task = child_rng(project.params.seed, "verify"), Recomputation(project, tables, found.drift)
            if {"features", "alternatives", "demonstrations"} <= made.keys():
                found.trajectories += _guarded(found, lambda: replay_trajectories(task, name, sample, rng))
            if "demonstrations" in made:
                _guarded(found, lambda: _ingested_again(found, project, name, tables["demonstrations"]))
            if {"posteriors", "densities", "scales", "features", "demonstrations"} <= made.keys():
                found.posteriors += _guarded(found, lambda: infer_posteriors(task, sample, rng))
    return found


class _Known:
    """Hashes of what is there now, each computed once."""

    def __init__(self, project: Project, name: str) -> None:
        self.project, self.name = project, name
        self._hashes: dict[Path, str] = {}
        self.recordings: list[Path] = []
        outside: list[Path] = []
        self.model: str | None = None
        if name != STUDIES:
            task = project.params.task(name)
            scene = load_task_scene(project, task)
            self.model = model_hash(scene)
            there = read_folder(project.path(task.recordings), Intake.of(project, name).columns)
            self.recordings = sorted({file for bag in there.bags for file in bag.files})
            given = project.params.sample.given
            outside = [*scene_files(scene.path), *self.recordings, *([project.path(given)] if given else [])]
        self._outside = {project.shown(path): path for path in outside}

    def hash(self, shown: str) -> str | None:
        """Of an input as provenance names it; None if it is not there."""
        path = self._outside.get(shown, self.project.root / shown)
        if path not in self._hashes and path.is_file():
            self._hashes[path] = content_hash(path)
        return self._hashes.get(path)


def _check_table(
    found: Verified, known: _Known, tables: TaskTables, table: str, stage: Stage, recorded: dict[str, str]
) -> None:
    project = known.project
    path = project.table(known.name, table)
    shown = project.shown(path)
    found.tables += 1
    try:
        about = tables[table].provenance
    except TableError as error:
        found.drift.append(str(error))
        return
    try:
        rows = tables[table]
        unchanged = content_digest(rows.arrow_schema, rows.batches()) == rows.content
    except TableError as error:
        found.drift.append(str(error))
        return
    if not unchanged:
        found.drift.append(f"{shown}: its rows are not those that were written, by their checksum")
    parameters_now = params.fingerprint(project.params, parameters(stage.name, known.name))
    for what, then, now in (
        ("other parameters than params.yaml has now (`dvc status` names them)", about.get("parameters"),
         parameters_now),
        (f"{about.get('program')}; this is lessbench {version('lessbench')}", about.get("program"),
         f"lessbench {version('lessbench')}"),
        (f"the seed {about.get('seed')}; params.yaml has {project.params.seed}", about.get("seed"),
         project.params.seed),
        (f"MuJoCo {about.get('mujoco')}; this is {version('mujoco')}", about.get("mujoco"), version("mujoco")),
        ("another scene model than the task has now", about.get("model"), known.model),
    ):  # fmt: skip
        if then != now and (then is not None or what.startswith("other")):
            found.drift.append(f"{shown}: was made with {what}")
    inputs: dict[str, str] = about.get("inputs", {})  # type: ignore[assignment]
    for name, digest in inputs.items():
        now = known.hash(name)
        found.files += 1
        if now is None:
            found.drift.append(f"{shown}: was made from {name}, which is not there any more")
        elif now != digest:
            found.drift.append(f"{shown}: {name} has changed since it was made")
    if table == "demonstrations":
        new = [file.name for file in known.recordings if project.shown(file) not in inputs]
        found.drift += [f"{shown}: was made without the recording {name}" for name in new]
    if shown in recorded and recorded[shown] != file_md5(path):
        found.drift.append(f"{shown}: is not the file that `dvc repro` wrote")


def _guarded(found: Verified, replay: Callable[[], int]) -> int:
    """A table that can no longer be read, or does not fit the others, is drift and not the end."""
    try:
        return replay()
    except WorkbenchError as error:
        found.drift.append(str(error))
    except (pl.exceptions.PolarsError, OSError) as error:
        found.drift.append(f"a table cannot be read ({' '.join(str(error).split())}); make it again with `dvc repro`")
    return 0


def verify_project(project: Project) -> Verified:
    """Look at what is made from all tasks together: the catalog and the report."""
    found = Verified()
    _check_outputs(found, project, None, _recorded(project))
    return found


def _check_outputs(found: Verified, project: Project, name: str | None, recorded: Mapping[str, str]) -> None:
    """Compare what stages wrote beside their tables, and which tables are there, with the records of their runs.

    Args:
        found: what is found is added to it.
        project: whose files.
        name: a task, or `studies`; None for what is made from all together.
        recorded: by path, the hashes in dvc.lock.
    """
    written = dict[str, set[str]]()
    for place, digest in (*recorded.items(), *(one for run in recorded_runs(project) for one in _wrote(run))):
        written.setdefault(place, set()).add(digest)
    for stage in STAGES:
        if not _concerns(stage, project, name):
            continue
        task = name or ""
        others = [path.format(task=task) for path in (*stage.outputs, *stage.metrics)]
        tables = [project.shown(project.table(task, table)) for table in stage.makes]
        for shown in (*others, *tables):
            path = project.root / shown
            if not path.exists():
                if shown in written:
                    found.drift.append(f"{shown}: is not there any more; make it again with `dvc repro`")
            elif shown in others:
                found.outputs += 1
                if shown not in written:
                    found.drift.append(f"{shown}: there is no record of how it was written; make it with `dvc repro`")
                elif output_hash(path) not in written[shown]:
                    found.drift.append(f"{shown}: is not what was written; make it again with `dvc repro`")


def _concerns(stage: Stage, project: Project, name: str | None) -> bool:
    if stage.scope is Scope.SIMULATED:
        return name in project.params.simulate.weights
    return stage.scope is {None: Scope.PROJECT, STUDIES: Scope.STUDIES}.get(name, Scope.TASK)


def _wrote(run: Mapping[str, object]) -> list[tuple[str, str]]:
    wrote = run.get("wrote")
    return [(str(path), str(digest)) for path, digest in wrote.items()] if isinstance(wrote, dict) else []


def _ingested_again(found: Verified, project: Project, name: str, table: OpenTable) -> int:
    """Read the recordings again, and compare the demonstrations with those of the table."""
    again = collect(project.path(project.params.task(name).recordings), Intake.of(project, name))
    rows = again.demonstrations() if again.rows else pl.DataFrame(schema={"demonstration_id": pl.String})
    kept, shown = table.read(), project.shown(table.path)
    for key in sorted({*kept["demonstration_id"], *rows["demonstration_id"]}):
        before, now = kept.filter(demonstration_id=key), rows.filter(demonstration_id=key)
        if before.height != now.height:
            there = "is not among them" if now.is_empty() else "is among them, and not in the table"
            found.drift.append(f"{shown}: when the recordings are read again, {key!r} {there}")
            continue
        for column in kept.columns:
            if not before[column].equals(now[column].cast(before[column].dtype), null_equal=True):
                found.drift.append(f"{shown}: {column} of {key!r} is another when the recordings are read again")
                break
    return rows.height


def _recorded(project: Project) -> dict[str, str]:
    """The hash of every file and folder that `dvc repro` recorded, by path."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    path = project.root / "dvc.lock"
    if not path.is_file():
        return {}
    try:
        stages = YAML(typ="safe").load(path.read_text(encoding="utf-8"))["stages"].values()
        return {out["path"]: out["md5"] for stage in stages for out in stage["outs"]}
    except (YAMLError, TypeError, KeyError):
        raise StageError(f"{path}: cannot be read; repair it with `lessbench recover`") from None
