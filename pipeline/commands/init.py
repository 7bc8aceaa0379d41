"""`lessbench init`: a project of one's own, where there is no copy of the repository."""

from __future__ import annotations

import shutil
from pathlib import Path

import pipeline
from pipeline.errors import StageError
from pipeline.params import FILE

BEGINNING = (FILE, "datasets/robots", "datasets/scenes", "datasets/studies/human_choice", "examples/carry_mug")
"""What a project begins with. It lies beside the code, in the repository and in a wheel."""


def init(folder: Path) -> list[str]:
    """Make a project in a new or empty folder, whole or not at all.

    Returns:
        what to say of it.

    Raises:
        StageError: the folder has something in it, or cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise StageError(f"{folder}: has something in it, so nothing was written; name a new folder")
    source = Path(pipeline.__file__).resolve().parents[1]
    partial = folder.with_name(f".{folder.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        for name in BEGINNING:
            (partial / name).parent.mkdir(parents=True, exist_ok=True)
            if (source / name).is_dir():
                shutil.copytree(source / name, partial / name)
            else:
                shutil.copy(source / name, partial / name)
        partial.replace(folder)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise StageError(f"{folder}: cannot be written ({(error.strerror or str(error)).lower()})") from None
    return [
        f"{folder}: a project, with an arm at a table and recordings to try in examples/carry_mug.",
        "Add a task with `lessbench new-task`, compute it with `lessbench run TASK`, and ask `lessbench answer TASK`.",
    ]
