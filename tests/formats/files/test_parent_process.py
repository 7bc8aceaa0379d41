"""A stage ends when the run that started it is gone, whether DVC started it through a shell or not."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

STAGE = """
import sys, time
from pathlib import Path
from pipeline.errors import StageError
from pipeline.formats.files.parent_process import end_with_parent, require_parent
require_parent()
print("begun", flush=True)
if sys.argv[1] == "watched":
    end_with_parent()
sys.stdin.readline()
try:
    require_parent()
except StageError as error:
    print(error, flush=True)
time.sleep(60 if sys.argv[1] == "watched" else 0)
"""
RUN = """
import subprocess, sys
subprocess.run(sys.argv[2] if sys.argv[1] == "shell" else sys.argv[2:], shell=sys.argv[1] == "shell")
"""


@pytest.mark.parametrize("way", ["shell", "direct"])
@pytest.mark.parametrize("kind", ["watched", "asked"])
def test_a_stage_notices_that_its_run_is_gone(tmp_path: Path, way: str, kind: str) -> None:
    program = tmp_path / "stage.py"
    program.write_text(STAGE)
    command = [sys.executable, str(program), kind]
    if way == "shell":
        command = [f"{shlex.join(command)}; true"]  # a second command: the shell stays
    with subprocess.Popen(
        [sys.executable, "-c", RUN, way, *command], env=os.environ | {"DVC_STAGE": "x"}, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as run:  # fmt: skip
        assert run.stdin is not None
        assert run.stdout is not None
        assert run.stdout.readline() == "begun\n"
        run.kill()
        run.wait()
        if kind == "asked":
            run.stdin.write("go on\n")
            run.stdin.flush()
        said = run.stdout.read()  # until the stage has ended
    assert "the `dvc repro` that started this stage has ended" in said
