"""Where a project's files are, and what every stage does around its own work: a record of the run."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from pipeline import params
from pipeline.errors import ParameterError
from pipeline.formats.files.atomic import written_whole
from pipeline.formats.files.links import keep_inside
from pipeline.formats.files.lock import held
from pipeline.formats.files.parent_process import end_with_parent
from pipeline.params import Params, Task
from pipeline.terminal import note
from pipeline.workspace.outputs import output_hash
from pipeline.workspace.progress import say_done

RUNS = ".lessbench/runs"
LOCKS = ".lessbench/locks"
SCRATCH = ".lessbench/scratch"  # what the parts of one stage share; nothing outlives the stage
TABLES = "datasets/{task}/tables"
KEPT_LOCK = ".lessbench/dvc.lock"  # as it was when the last stage began


@dataclass(frozen=True)
class Project:
    """A folder with a params.yaml; every path in the parameters is relative to it.

    Attributes:
        root: the folder.
        overlay: a file of parameters that are different from those in params.yaml, or None.
    """

    root: Path
    overlay: Path | None = None

    def __post_init__(self) -> None:
        """Let nothing be written through a link that leads out of the folder."""
        keep_inside(self.root)

    @cached_property
    def params(self) -> Params:
        """The checked parameters.

        Raises:
            ParameterError: see `pipeline.params.load`.
        """
        return params.load(self.root / params.FILE, self.overlay)

    @cached_property
    def own_tasks(self) -> dict[str, str]:
        """Files of the tasks that do not stand in params.yaml, by the name of the task."""
        return params.own_tasks(self.root)

    @property
    def datasets(self) -> Path:
        """Inputs that are kept and everything that is derived."""
        return self.root / "datasets"

    @property
    def catalog(self) -> Path:
        """The DuckDB database of all tables."""
        return self.datasets / "catalog.duckdb"

    def table(self, task: str, name: str) -> Path:
        """The Parquet file of table `name` of a task or of `studies`."""
        return self.root / table_path(task, name)

    def scene_record(self, task: str) -> Path:
        """What the stage `scene` found in the scene of a task."""
        return self.datasets / task / "scene.json"

    def tables(self, task: str, names: Iterable[str]) -> dict[str, Path]:
        """The Parquet files of some tables of a task or of `studies`, by name."""
        return {name: self.table(task, name) for name in names}

    def figures(self, task: str) -> Path:
        """The folder of the figures of a task or of `studies`."""
        return self.datasets / task / "figures"

    def metrics(self, task: str) -> Path:
        """The headline numbers of a task or of `studies`."""
        return self.datasets / task / "metrics.json"

    def path(self, given: str) -> Path:
        """A path of params.yaml."""
        return self.root / given

    def named(self, path: Path) -> str:
        """How params.yaml names a path: from the project's folder if it is inside, else in full."""
        full = path.resolve()
        return full.relative_to(self.root).as_posix() if full.is_relative_to(self.root) else str(full)

    def shown(self, path: Path) -> str:
        """A file as provenance names it: from the project's folder if it is inside, else by its name."""
        return path.relative_to(self.root).as_posix() if path.is_relative_to(self.root) else path.name


def table_path(task: str, name: str) -> str:
    """Where in a project the table `name` of a task or of `studies` is."""
    return f"{TABLES.format(task=task)}/{name}.parquet"


def find_project(start: Path, overlay: Path | None = None) -> Project:
    """The project that the folder `start` is in: it or the nearest folder above that has a params.yaml.

    Args:
        start: where to begin.
        overlay: see `Project`.

    Raises:
        ParameterError: there is none.
    """
    for folder in (start, *start.parents):
        if (folder / params.FILE).is_file():
            return Project(folder, overlay)
    raise ParameterError(f"{start}: neither here nor in a folder above is a {params.FILE}; run this inside a project")


@dataclass
class Run:
    """What a stage says about its run; `produced` is one phrase for the summary.

    `wrote` has, by path within the project, the hashes of what it wrote beside its tables.
    """

    stage: str
    task: str
    produced: str = ""
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)
    wrote: dict[str, str | None] = field(default_factory=dict)


@contextmanager
def recorded_run(project: Project, stage: str, task: str, writes: Sequence[Path] = ()) -> Iterator[Run]:
    """Run a stage alone, time it and keep a record of it for `lessbench summary`; nothing is kept when it fails.

    Args:
        project, stage, task: what is run.
        writes: files and folders that it writes beside its tables; their hashes are kept for `lessbench verify`.

    Raises:
        StageError: the same stage is running elsewhere, or a file cannot be written.
    """
    run = Run(stage, task)
    end_with_parent()
    with held(project.root / LOCKS / f"{stage}@{task}", f"{stage} {task}", project.root):
        _keep_dvc_lock(project)
        begin = time.perf_counter()
        yield run
        run.seconds = time.perf_counter() - begin
        run.wrote = {project.shown(path): output_hash(path) for path in writes}
        with written_whole(project.root / RUNS / f"{stage}@{task}.json") as stream:
            stream.write(json.dumps({**run.__dict__, "finished": time.time()}).encode())
    say_done(f"{stage} {task}", run.produced, run.seconds)
    for remark in run.notes:
        note(f"{stage} {task}: {remark}")


def _keep_dvc_lock(project: Project) -> None:
    """DVC rewrites dvc.lock in place after every stage; while a stage runs it is whole (see `lessbench recover`)."""
    lock = project.root / "dvc.lock"
    if os.environ.get("DVC_ROOT") == str(project.root) and lock.is_file():
        with written_whole(project.root / KEPT_LOCK) as stream:
            stream.write(lock.read_bytes())


def recorded_runs(project: Project) -> list[Mapping[str, object]]:
    """The last run of every stage, in the order in which they finished."""
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((project.root / RUNS).glob("*.json"))]
    return sorted(runs, key=lambda run: float(run["finished"]))


__all__ = ["ParameterError", "Project", "Run", "Task", "find_project", "recorded_run", "recorded_runs"]
