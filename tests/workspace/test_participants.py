"""Whose a recording is: its own metadata, participants.csv, the name of its file, in this order."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.commands.check import checked, report
from pipeline.errors import ParameterError, RecordingError, StageError
from pipeline.formats.mcap.joint_states import read_joint_states, write_joint_states
from pipeline.formats.parquet.tables import read_table
from pipeline.params import Reading
from pipeline.stages import ingest
from pipeline.workspace.participants import by_file_name, participants_in
from pipeline.workspace.project import Project, recorded_runs
from tests.support.gantry_project import record

Make = Callable[[dict[str, Any]], Project]


@pytest.mark.parametrize(
    ("pattern", "name", "found"),
    [
        ("{participant}_*", "P3_tea_1", {"participant": "P3"}),
        ("{participant}_{task}_*", "P3_sweep_1", {"participant": "P3", "task": "sweep"}),
        ("*_{participant}", "2026-03-01_Ann", {"participant": "Ann"}),
        ("demo-{participant}", "demo-0", {"participant": "0"}),
        ("{task}-{participant}.v1", "a-b-c.v1", {"task": "a", "participant": "b-c"}),
        ("{participant}", "P3", {"participant": "P3"}),
        ("{participant}_*", "P3", None),
        ("{participant}_*", "_tea", None),
        ("x{participant}", "P3", None),
        ("{participant}_end", "P3_end_more", None),
        ("{participant}a*a*a*a*a*a*b", "a" * 200, None),
    ],
)
def test_names_of_files_say_what_their_pattern_says(pattern: str, name: str, found: dict[str, str] | None) -> None:
    assert by_file_name(name, pattern) == found


@pytest.mark.parametrize("pattern", ["P3", "{who}_*", "{participant}{task}", "{participant}_{participant}", "*", "{}"])
def test_a_pattern_that_says_nothing_is_refused(pattern: str) -> None:
    with pytest.raises(ValueError, match=r"participant|place"):
        Reading(file_name=pattern)


def test_a_column_has_one_meaning_and_unknown_keys_are_named(make_project: Make, parameters: dict[str, Any]) -> None:
    for reading, said in (
        ({"time": "a", "id": "a"}, "two meanings"), ({"time": "t", "rate_hz": 5.0}, "both say when"),
        ({"unit": "degrees"}, "'deg'"), ({"tiem": "t"}, "did you mean 'time'"),
    ):  # fmt: skip
        parameters["tasks"]["sweep"]["reading"] = reading
        with pytest.raises(ParameterError, match=said):
            _ = make_project(parameters).params


def unsigned(path: Path) -> None:
    """Take out of a recording what it says of its participant."""
    found = read_joint_states(path)
    write_joint_states(path, found.time_ns, found.names, found.positions, topic=found.topic, metadata={})


@pytest.fixture
def make_unsigned(make_project: Make) -> Make:
    """The small project, whose recordings say nothing of who made them."""

    def make(parameters: dict[str, Any]) -> Project:
        project = make_project(parameters)
        for path in (project.root / "mine").iterdir():
            unsigned(path)
        return project

    return make


def people(project: Project) -> dict[str, str]:
    ingest.run(project, "sweep")
    rows = read_table(project.table("sweep", "demonstrations"), "demonstrations")
    return dict(zip(rows["demonstration_id"], rows["participant"], strict=True))


def noted(project: Project) -> str:
    return str(recorded_runs(project)[-1]["notes"])


def test_the_table_beside_the_recordings(make_unsigned: Make, parameters: dict[str, Any]) -> None:
    project = make_unsigned(parameters)
    own = people(project)
    assert own == {f"demo-{number}": f"demo-{number}" for number in range(3)}
    table = project.root / "mine" / "participants.csv"
    table.write_text("file;participant;task\ndemo-0.mcap;Ann;sweep\ndemo-1;Bo;\nelse.mcap;Cy;\n")
    assert people(project) == own | {"demo-0": "Ann", "demo-1": "Bo"}
    assert "participants are named by participants.csv (2)" in noted(project)
    assert "else.mcap" in noted(project)
    (row,) = read_table(project.table("sweep", "rejected"), "rejected").rows(named=True)
    assert (row["source"], row["reason"]) == ("participants.csv", "not-a-recording")
    lines, usable = report(project.root / "mine" / "demo-0.mcap", project, "sweep")
    assert usable
    assert "demonstration demo-0 of Ann (by participants.csv)" in "\n".join(lines)


def test_the_order_in_which_they_count(make_unsigned: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["reading"] = {"file_name": "demo-{participant}"}
    project = make_unsigned(parameters)
    assert people(project) == {"demo-0": "0", "demo-1": "1", "demo-2": "2"}
    assert "participants are named by the name of the file (3)" in noted(project)
    (project.root / "mine" / "participants.csv").write_text("file,participant\ndemo-1.mcap,Bo\ndemo-2.mcap,Cy\n")
    record(project.root / "mine" / "demo-2.mcap", bow=0.2, participant="Di")
    assert people(project) == {"demo-0": "0", "demo-1": "Bo", "demo-2": "Di"}
    (one,) = checked(project.root / "mine" / "demo-2.mcap", project, "sweep")
    assert one.as_json()["participant_by"] == "the recording's metadata record 'demonstration'"
    record(project.root / "mine" / "other.mcap", bow=0.3)
    unsigned(project.root / "mine" / "other.mcap")
    assert people(project)["other"] == "other"
    assert "does not follow reading.file_name, demo-{participant}" in noted(project)


def test_another_task_by_the_table_or_the_name_is_refused(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["pour"] = parameters["tasks"]["sweep"] | {"recordings": "others"}
    project = make_project(parameters)
    (project.root / "mine" / "participants.csv").write_text("file,participant,task\ndemo-1.mcap,Bo,pour\n")
    with pytest.raises(StageError, match=r"demo-1.mcap \(another-task\): By participants.csv it is of task 'pour'"):
        ingest.run(project, "sweep")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"name,who\na,b\n", "needed are file and participant"),
        (b"", "needed are file and participant"),
        (b"file,participant\na,b\na,c\n", "names 'a' again"),
        (b"file,participant\n,b\n", "Row 2 of participants.csv names no file"),
        (b"\xff\xfe", "in UTF-8"),
        (b"x" * (5 << 20), "more than 4 MB"),
        (b'file,participant\n"' + b"x" * 200_000 + b'",b\n', "cannot be read as CSV"),
    ],
)
def test_a_table_that_cannot_be_used_stops_the_stage(
    make_project: Make, parameters: dict[str, Any], content: bytes, said: str
) -> None:
    project = make_project(parameters)
    (project.root / "mine" / "participants.csv").write_bytes(content)
    with pytest.raises(RecordingError, match=said):
        participants_in(project.root / "mine")
    with pytest.raises(StageError, match=said):
        ingest.run(project, "sweep")


def test_names_that_cannot_be_names_are_refused_with_where_they_stand(
    make_unsigned: Make, parameters: dict[str, Any]
) -> None:
    project = make_unsigned(parameters)
    (project.root / "mine" / "participants.csv").write_text("file,participant\ndemo-1.mcap,all\n")
    with pytest.raises(StageError, match=r"A participant cannot be called all.*change it in participants.csv"):
        ingest.run(project, "sweep")


def test_nothing_is_said_where_there_is_no_folder(tmp_path: Path) -> None:
    assert participants_in(None).of("a") == {}
    assert participants_in(tmp_path).of("a") == {}
