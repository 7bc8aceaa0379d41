from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from pipeline.formats.mcap.folder_watcher import PATIENCE, Arrivals
from pipeline.formats.mcap.joint_states import write_joint_states


@pytest.fixture
def recording(tmp_path: Path) -> bytes:
    path = tmp_path / "elsewhere" / "one.mcap"
    write_joint_states(
        path, np.arange(1, 50) * 10_000_000, ["a"], np.linspace(0, 1, 49)[:, None], topic="/joints", metadata={}
    )
    return path.read_bytes()


def looks(arrivals: Arrivals, count: int) -> list[str]:
    """Names of what was found whole in so many looks."""
    return [path.name for _ in range(count) for path in arrivals.look().whole]


def test_a_closed_file_is_seen_once_on_the_second_look(tmp_path: Path, recording: bytes) -> None:
    arrivals = Arrivals(tmp_path / "folder")
    assert looks(arrivals, 2) == []
    arrivals.folder.mkdir()
    for name in ("b.mcap", "a.mcap", "notes.txt"):
        (arrivals.folder / name).write_bytes(recording)
    assert looks(arrivals, 1) == []
    assert looks(arrivals, 5) == ["a.mcap", "b.mcap"]
    assert arrivals.open == ()


def test_a_growing_file_is_not_taken_even_when_it_looks_closed(tmp_path: Path, recording: bytes) -> None:
    arrivals, path = Arrivals(tmp_path), tmp_path / "one.mcap"
    path.write_bytes(recording)
    arrivals.look()
    path.write_bytes(recording + recording)
    assert looks(arrivals, 1) == []
    assert looks(arrivals, 1) == ["one.mcap"]


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.999])
def test_a_file_that_is_not_closed_waits_and_is_told_once(tmp_path: Path, recording: bytes, share: float) -> None:
    arrivals, path = Arrivals(tmp_path), tmp_path / "one.mcap"
    path.write_bytes(recording[: int(share * len(recording))])
    told = [arrivals.look() for _ in range(3 * PATIENCE)]
    assert [news.whole for news in told] == [()] * len(told)
    assert [news.waiting for news in told if news.waiting] == [(path,)]
    assert arrivals.open == (path,)
    path.write_bytes(recording)
    assert looks(arrivals, 3) == ["one.mcap"]


def test_what_will_never_be_a_recording_is_not_waited_for(tmp_path: Path) -> None:
    arrivals = Arrivals(tmp_path)
    (tmp_path / "text.mcap").write_text("not a recording at all")
    (tmp_path / "folder.mcap").mkdir()
    os.mkfifo(tmp_path / "pipe.mcap")
    assert looks(arrivals, 4) == ["folder.mcap", "pipe.mcap", "text.mcap"]


def test_a_change_is_seen_again_and_a_removal_is_said(tmp_path: Path, recording: bytes) -> None:
    arrivals, path = Arrivals(tmp_path), tmp_path / "one.mcap"
    path.write_bytes(recording)
    assert looks(arrivals, 3) == ["one.mcap"]
    os.utime(path, ns=(1, 1))
    assert looks(arrivals, 4) == ["one.mcap"]
    path.unlink()
    assert [arrivals.look().gone for _ in range(2)] == [(path,), ()]
    path.write_bytes(recording)
    assert looks(arrivals, 3) == ["one.mcap"]
