"""What runs is what is recorded: a command computes with the code of the project it stands in, or not at all.

DVC records the hashes of the code in the project's folder. But `lessbench` may have been installed from another
checkout: that of a git worktree, or of the temporary folders that `dvc exp run --queue` and `--temp` run in.
"""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

import pipeline
from pipeline.errors import StageError

RUNNING = Path(pipeline.__file__).resolve().parent
SWITCHED = "LESSBENCH_SWITCHED"  # names the folder whose code was switched to, so that this happens once
EXPERIMENTS = Path(".dvc") / "tmp" / "exps"  # where DVC runs experiments that it does not run in place


def require_own_code(root: Path) -> None:
    """Go on only if the project in `root` has no other code than that which is running.

    Where DVC has started the command, as a stage of this very project, it begins anew with the project's own code:
    whoever runs `dvc repro` there runs the commands of its dvc.yaml anyway. Code of a folder that somebody merely
    stands in is not run.

    Raises:
        StageError: it has, and DVC has not started the command.
    """
    own = root / "pipeline"
    if not (own / "__init__.py").is_file() or own.resolve() == RUNNING:
        return
    if _started_by_dvc(root) and os.environ.get(SWITCHED) != str(root):
        found_first = os.pathsep.join(filter(None, [str(root), os.environ.get("PYTHONPATH")]))
        environment = os.environ | {"PYTHONPATH": found_first, SWITCHED: str(root)}
        os.execve(sys.executable, [sys.executable, "-m", "pipeline", *sys.argv[1:]], environment)  # noqa: S606
    command = shlex.join(["lessbench", *sys.argv[1:]])
    raise StageError(
        f"{root} has a pipeline/ of its own, and this lessbench runs that of {RUNNING.parent}, so DVC would record its "
        f"results under the wrong code; if you trust that folder, type `PYTHONPATH={shlex.quote(str(root))} {command}`"
    )


def _started_by_dvc(root: Path) -> bool:
    """Whether this is a stage of the project; of an experiment's, DVC names the folder that it was started from."""
    named = os.environ.get("DVC_ROOT")
    if not named:
        return False
    started_in, here = Path(named).resolve(), root.resolve()
    return here == started_in or here.is_relative_to(started_in / EXPERIMENTS)
