"""Results to compare: those of a project's folder, or those that DVC keeps of a revision or an experiment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from pipeline.errors import StageError
from pipeline.params import FILE, OWN_TASKS
from pipeline.workspace.project import Project, table_path

MOST_BYTES = 1 << 30  # of one file that is taken out of DVC's cache


@contextmanager
def version(project: Project, named: str, tables: tuple[str, ...]) -> Iterator[Project]:
    """The project in another version, to be read.

    Args:
        project: this one.
        named: `.` for this one as it is; a folder with a project; a YAML file with other parameters for this project;
            else a git revision or the name of a DVC experiment, of which parameters and tables are taken out of DVC's
            cache.
        tables: which tables of every task are wanted, as far as they are there.

    Raises:
        StageError: it is none of these.
    """
    path = Path(named)
    if named == ".":
        yield project
    elif path.is_dir():
        if not (path / FILE).is_file():
            raise StageError(
                f"{named}: is no project, as it has no {FILE}; name a project, a revision or an experiment"
            )
        yield project if path.resolve() == project.root else Project(path.resolve())
    elif path.is_file():
        yield Project(project.root, path.resolve())
    else:
        with TemporaryDirectory(prefix="lessbench-") as folder:
            _take_out(project, named, tables, Path(folder))
            yield Project(Path(folder))


def _take_out(project: Project, revision: str, tables: tuple[str, ...], folder: Path) -> None:
    from dvc.api import DVCFileSystem
    from dvc.exceptions import DvcException
    from dvc.scm import SCMError

    try:
        files = DVCFileSystem(str(project.root), rev=revision)
        _take(files, FILE, folder)
        if not (folder / FILE).is_file():
            raise FileNotFoundError(f"it has no {FILE}")
        if files.exists(OWN_TASKS):
            for found in files.ls(OWN_TASKS, detail=False):
                _take(files, str(found), folder)
        for task in Project(folder).params.tasks:
            for name in tables:
                with suppress(FileNotFoundError):  # DVC knows of it, and has not kept it
                    _take(files, table_path(task, name), folder)
    except (DvcException, SCMError, OSError) as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise StageError(
            f"{revision!r} is no folder or file here, and no git revision or DVC experiment that can be read ({said})"
        ) from error


def _take(files: object, name: str, folder: Path) -> None:
    """Copy one file, if the version has it and DVC has kept it."""
    within = PurePosixPath(name.lstrip("/"))
    if ".." in within.parts or not files.exists(str(within)):  # type: ignore[attr-defined]
        return
    if (size := files.info(str(within)).get("size") or 0) > MOST_BYTES:  # type: ignore[attr-defined]
        raise StageError(f"{name}: has {size:,} bytes, allowed are {MOST_BYTES:,}")
    (folder / within).parent.mkdir(parents=True, exist_ok=True)
    files.get_file(str(within), str(folder / within))  # type: ignore[attr-defined]
