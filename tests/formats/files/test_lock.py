"""A lock admits one process, names it, and never harms a file that it is pointed at."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pipeline.errors import StageError
from pipeline.formats.files import lock
from pipeline.formats.files.lock import held

HOLD = """
import sys, time
from pathlib import Path
from pipeline.formats.files.lock import held
with held(Path(sys.argv[1]), "density table", Path(sys.argv[2])):
    print("held", flush=True)
    time.sleep(300)
"""


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(lock, "_PATIENCE_S", 0.3)
    (tmp_path / "project").mkdir()
    return tmp_path / "project" / "locks" / "density@table"


@contextmanager
def held_elsewhere(path: Path) -> Iterator[int]:
    command = [sys.executable, "-c", HOLD, path, path.parents[1]]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "held\n"
            yield process.pid
        finally:
            process.kill()


def take(path: Path) -> None:
    with held(path, "density table", path.parents[1]):
        assert int(path.read_text()[:10]) == os.getpid()


def test_a_second_process_is_refused_and_told_who_holds_it(path: Path) -> None:
    with held_elsewhere(path) as holder:
        expected = (
            f"density table: is being run by the process {holder} already; wait .* `kill {holder}`, and run it again"
        )
        with pytest.raises(StageError, match=expected):
            take(path)
        path.write_text("\x1b[2J is no number")
        with pytest.raises(StageError, match="run by another process already; wait until that has ended, and run it"):
            take(path)


def test_it_is_let_go_when_its_holder_is_killed(path: Path) -> None:
    with held_elsewhere(path) as holder:
        os.kill(holder, signal.SIGKILL)
        take(path)
    take(path)


def test_it_is_let_go_after_an_error(path: Path) -> None:
    with pytest.raises(KeyError), held(path, "density table", path.parents[1]):
        raise KeyError
    take(path)


def test_a_file_in_its_place_is_not_cut(path: Path) -> None:
    path.parent.mkdir()
    path.write_text("1234567890\n" + "notes " * 1000)
    take(path)
    assert path.read_text()[10:] == "\n" + "notes " * 1000


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda path, other: path.symlink_to(other), "a link leads from here out of the project; remove the link"),
        (lambda path, _: path.symlink_to(path.parent / "beside"), "remove the link and run it again"),
        (lambda path, _: path.symlink_to(path), "remove the link and run it again"),
        (lambda path, other: path.hardlink_to(other), "remove it, for it is also a file of another name"),
    ],
)
def test_a_link_is_refused_and_what_it_leads_to_is_unchanged(path: Path, make: object, why: str) -> None:
    other = path.parents[2] / "thesis.tex"
    other.write_text("years of work")
    path.parent.mkdir()
    make(path, other)  # type: ignore[operator]
    with pytest.raises(StageError, match=why):
        take(path)
    assert other.read_text() == "years of work"
    assert not (path.parent / "beside").exists()
    path.unlink()
    take(path)


def test_a_folder_that_leads_out_of_the_project_is_refused(path: Path) -> None:
    elsewhere = path.parents[2] / "elsewhere"
    elsewhere.mkdir()
    path.parent.symlink_to(elsewhere)
    with pytest.raises(StageError, match="out of the project"):
        take(path)
    assert not list(elsewhere.iterdir())
