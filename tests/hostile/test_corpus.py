"""The corpus of malformed files: this reader ends as it says there, the official one agrees where nothing is wrong."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader

from pipeline.formats.mcap.joint_states import REASONS, inspect_recording
from tests.hostile.corpus import Malformed, corpus, write

FILES = {one.name: one for one in corpus()}


@pytest.mark.parametrize("one", FILES.values(), ids=list(FILES))
def test_this_reader_ends_as_the_corpus_says(tmp_path: Path, one: Malformed) -> None:
    path = tmp_path / "one.mcap"
    path.write_bytes(one.content)

    report = inspect_recording(path)

    assert one.here in (*REASONS, "accept")
    assert (report.reason or "accept") == one.here
    if report.recording is not None:
        assert one.messages is not None
        assert len(report.recording.time_ns) in one.messages


@pytest.mark.parametrize("name", [name for name, one in FILES.items() if one.strict == "accept"])
def test_the_official_reader_takes_those_that_are_sound(name: str) -> None:
    messages = list(NonSeekingReader(io.BytesIO(FILES[name].content), validate_crcs=True).iter_messages())

    assert len(messages) == 4


def test_the_files_are_the_same_in_every_run(tmp_path: Path) -> None:
    assert write(tmp_path / "a") == write(tmp_path / "b") == len(FILES)

    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()
    assert sum(file.stat().st_size for file in (tmp_path / "a").iterdir()) < 200_000
