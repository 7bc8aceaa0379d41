"""What cannot be right in a recording is refused with the reason, what is merely odd is used and said."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from mcap.writer import CompressionType

from pipeline.commands.check import report
from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import ingest
from pipeline.workspace.project import Project
from tests.support.recorded_motions import BEGIN_NS, NAMES, STEP_NS, Recorded, reach, save, save_messages, timed
from tests.support.tables import provenance_of

Make = Callable[[dict[str, Any]], Project]
Prepare = Callable[..., Project]
INDEX = "rosbag2_bagfile_information:\n  relative_file_paths: [{files}]\n"


@pytest.fixture
def project(make_project: Make, parameters: dict[str, Any]) -> Prepare:
    """The small project with recordings of one's own, by their names without ending, and settings of ingest."""

    def prepare(recordings: dict[str, Recorded], task: dict[str, Any] | None = None, **settings: object) -> Project:
        parameters["ingest"] |= settings
        parameters["tasks"]["sweep"] |= task or {}
        made = make_project(parameters)
        shutil.rmtree(made.root / "mine")
        for name, recorded in recordings.items():
            save(made.root / "mine" / f"{name}.mcap", recorded)
        (made.root / "mine").mkdir(exist_ok=True)
        return made

    return prepare


def demonstrations(made: Project) -> pl.DataFrame:
    ingest.run(made, "sweep")
    return read_table(made.table("sweep", "demonstrations"), "demonstrations")


def rejected(made: Project) -> dict[str, str]:
    table = read_table(made.table("sweep", "rejected"), "rejected")
    return dict(zip(table["source"], table["reason"], strict=True))


def refusal(made: Project) -> str:
    with pytest.raises(StageError) as caught:
        ingest.run(made, "sweep")
    return str(caught.value)


def test_a_good_recording_has_no_remarks_and_its_numbers_are_those_of_the_motion(project: Prepare) -> None:
    made = project({"a": reach()})
    row = demonstrations(made).row(0, named=True)
    assert rejected(made) == {}
    assert (row["clock"], row["dropped"], row["files"], row["remarks"]) == ("header", 0, 1, None)
    assert row["rate_hz"] == pytest.approx(100)
    assert row["longest_gap_s"] == pytest.approx(0.01)
    steps = np.diff(reach().positions[:, 1])
    assert (row["fastest_joint"], row["greatest_speed"]) == ("swing", pytest.approx(100 * steps.max(), rel=0.01))
    assert max(row["start_apart"], row["goal_apart"]) < 0.011  # the idle ends are cut off within 0.01 rad
    assert max(row["start_apart_m"], row["goal_apart_m"]) < 0.01


# limits

UNITS = {
    "degrees": (lambda q: np.where([False, True, True], np.degrees(q), q), r"'bend' is at .*look like degrees"),
    "ticks": (
        lambda q: np.where([False, True, True], np.rint(4096 * (q + 3)), q),
        r"whole numbers, as encoders count ticks",
    ),
    "percent": (lambda q: q * [100, 16, 50] + np.array([0, 0, 30]), r"'rail' is at .*its limits are -1 to 1 m"),
    "millimetres": (lambda q: q * [1000, 1, 1], r"'rail' is at .*look like millimetres"),
    "an offset": (lambda q: q + np.array([0, 0, 2.1]), r"'bend' is at 2\.\d+; its limits are -2 to 2 rad"),
}


@pytest.mark.parametrize("unit", UNITS)
def test_positions_beyond_the_limits_are_refused_with_joint_value_limit_cause_and_time(
    project: Prepare, unit: str
) -> None:
    change, said = UNITS[unit]
    recorded = reach()
    made = project({"a": recorded.but(positions=change(recorded.positions)), "b": reach(0.2)})
    message = refusal(made)
    assert_matches(r"1 of 2 recordings in mine cannot be used: a\.mcap \(beyond-limits\): At \d\.\d+ s ", message)
    assert_matches(said, message)
    assert rejected(made) == {"a.mcap": "beyond-limits"}
    assert not made.table("sweep", "demonstrations").exists()


def assert_matches(pattern: str, text: str) -> None:
    assert re.search(pattern, text), text


def test_a_limited_joint_a_turn_away_is_turned_back_and_said(project: Prepare) -> None:
    recorded = reach()
    made = project(
        {"a": recorded, "b": recorded.but(positions=recorded.positions + np.array([0, 0, 2 * np.pi])).later(10**9)}
    )
    table = demonstrations(made)
    np.testing.assert_allclose(table["waypoints"][1].to_list(), table["waypoints"][0].to_list(), atol=1e-12)
    assert "a whole turn from its limits" in table["remarks"][1]


def test_a_little_beyond_a_limit_is_used_and_said(project: Prepare) -> None:
    recorded = reach()
    smooth = recorded.positions.copy()
    smooth[:, 2] += np.sin(np.pi * np.linspace(0, 1, len(smooth))) ** 2 * 2.4
    smooth[:, 2] = np.minimum(smooth[:, 2], 2.03)
    assert "beyond a limit" not in (demonstrations(project({"a": recorded}))["remarks"][0] or "")
    table = demonstrations(project({"a": recorded.but(positions=smooth)}))
    excess = np.array(table["waypoints"][0].to_list())[:, 2].max() - 2
    assert 0 < excess < np.radians(3)
    assert "'bend' is at 2.0" in table["remarks"][0]


# ends and motion


def test_a_motion_between_other_ends_is_refused_and_kept_on_request(project: Prepare) -> None:
    half = reach().rows(slice(0, 140))
    message = refusal(project({"a": half}))
    assert_matches(
        r"far-ends\): The motion ends 0\.\d+ rad \('swing'\) and \d+ cm .*keyframe 'goal'.*ingest\.far_ends to keep",
        message,
    )
    row = demonstrations(project({"a": half}, far_ends="keep")).row(0, named=True)
    assert "which is far" in row["remarks"]
    assert row["goal_apart"] > 0.5
    own = demonstrations(project({"a": half}, task={"anchor": "demonstration"}, far_ends="reject")).row(0, named=True)
    assert (own["goal_apart"], own["remarks"]) == (None, None)


def test_ends_a_little_apart_are_said(project: Prepare) -> None:
    recorded = reach()
    row = demonstrations(project({"a": recorded.but(positions=recorded.positions + np.array([0, 0.15, 0]))})).row(
        0, named=True
    )
    assert row["start_apart"] == pytest.approx(0.15, abs=0.011)
    assert "starts 0.1" in row["remarks"]


def test_a_continuous_joint_counts_within_its_turn(project: Prepare) -> None:
    recorded = reach()
    row = demonstrations(project({"a": recorded.but(positions=recorded.positions - np.array([0, 4 * np.pi, 0]))})).row(
        0, named=True
    )
    assert row["start_apart"] < 0.011


def test_a_gap_in_the_motion_is_refused_and_in_the_rest_it_is_not(project: Prepare) -> None:
    recorded = reach()
    message = refusal(project({"a": recorded.rows(np.r_[0:100, 170:280])}))
    assert_matches(r"gap\): There is no sample for 0\.71 s from \d\.\d+ s on, where 0\.01 s is usual", message)
    small = demonstrations(project({"a": recorded.rows(np.r_[0:100, 105:280])})).row(0, named=True)
    assert "no sample for 0.06 s" in small["remarks"]
    assert small["longest_gap_s"] == pytest.approx(0.06)
    resting = demonstrations(project({"a": reach(idle=1.0).rows(np.r_[0:10, 85:280])})).row(0, named=True)
    assert (resting["remarks"], resting["longest_gap_s"]) == (None, pytest.approx(0.01))


JUMPS = {
    "one sample elsewhere": (lambda q: q + np.array([0, 0.5, 0]) * at(130, 131), "jump"),
    "from here on elsewhere": (lambda q: q + np.array([0, 0.6, 0]) * at(130, 280), "jump"),
    "a slide": (lambda q: q + np.array([0.15, 0, 0]) * at(130, 135), "jump"),
    "another arm in between": (lambda q: np.where(np.arange(280)[:, None] % 40 == 5, [0.0, 0.0, 0.0], q), "jump"),
    "degrees of a joint without limits": (lambda q: q * [1, 180 / np.pi, 1], "too-fast"),
}


def at(first: int, last: int) -> np.ndarray:
    rows = np.arange(280)[:, None]
    return (rows >= first) & (rows < last)


@pytest.mark.parametrize("kind", JUMPS)
def test_what_no_arm_does_is_refused_with_its_time(project: Prepare, kind: str) -> None:
    change, reason = JUMPS[kind]
    recorded = reach(0.3)
    made = project({"a": recorded.but(positions=change(recorded.positions))})
    assert_matches(rf"{reason}\): joint '\w+' moves .* at \d\.\d+ s", refusal(made))


def test_a_faster_arm_can_be_allowed(project: Prepare) -> None:
    fast = reach(step_ns=STEP_NS // 8)
    assert "too-fast): joint 'swing' moves at" in refusal(project({"a": fast}, fastest_rad_s=6.0))
    row = demonstrations(project({"a": fast}, fastest_rad_s=40.0, fastest_m_s=6.0)).row(0, named=True)
    assert (row["fastest_joint"], row["greatest_speed"]) == (
        "rail",
        pytest.approx(5.1, abs=0.1),
    )  # nearest to its limit


def test_nominal_clocks_are_no_reason_to_refuse(project: Prepare) -> None:
    for step_ns, samples in ((10**8, 28), (5 * 10**8, 41)):
        row = demonstrations(project({"a": reach(samples=samples, step_ns=step_ns)})).row(0, named=True)
        assert row["rate_hz"] == pytest.approx(10**9 / step_ns)


def back_and_forth() -> Recorded:
    there = reach(idle=0.1).positions
    return timed(np.concatenate([there, there[::-1], there]))


def test_several_motions_in_one_recording_are_refused_with_their_times(project: Prepare) -> None:
    message = refusal(project({"a": back_and_forth()}))
    assert_matches(
        r"several-motions\): The arm comes back .* at \d\.\d+ s of its clock: the recording holds 2 motions", message
    )
    assert "mcap filter" in message
    there = reach(idle=0.1).positions
    paused = np.concatenate([there[:140], np.repeat(there[140:141], 450, axis=0), there[140:]])
    assert_matches(r"several-motions\): The arm rests for 4\.\d s", refusal(project({"a": timed(paused)})))
    kept = demonstrations(project({"a": timed(paused)}, longest_rest_s=6.0))
    assert "rests for 4" in kept["remarks"][0]


def test_a_motion_through_the_surface_is_said(project: Prepare) -> None:
    made = project({"a": reach(), "b": reach().but(positions=reach().positions).later(10**9)})
    scene = made.root / "gantry.xml"
    scene.write_text(scene.read_text().replace('pos="0 0 -0.5"', 'pos="0 0 0.03"'))
    remarks = demonstrations(made)["remarks"].to_list()
    assert all("cm under the task's surface, which alternatives do not" in remark for remark in remarks)


# clocks


def test_a_task_that_mixes_clocks_is_told(project: Prepare, capfd: pytest.CaptureFixture[str]) -> None:
    unstamped = reach(0.2)
    made = project({"a": reach(), "b": unstamped.but(header_ns=0 * unstamped.header_ns)})
    table = demonstrations(made)
    assert table["clock"].to_list() == ["header", "log"]
    assert "header stamps are 0, so log times are used" in table["remarks"][1]
    assert "different clocks: header of 1, log of 1" in capfd.readouterr().err


def test_the_clock_can_be_named(project: Prepare) -> None:
    recorded = reach()
    assert demonstrations(project({"a": recorded}, clock="log"))["clock"].to_list() == ["log"]


def test_a_clock_that_begins_at_zero_and_one_that_begins_later_say_the_same(project: Prepare) -> None:
    recorded = reach()
    simulated = recorded.but(
        header_ns=recorded.header_ns - BEGIN_NS, log_ns=BEGIN_NS + 3 * (recorded.log_ns - BEGIN_NS)
    )
    made = project({"a": simulated, "b": simulated.but(header_ns=simulated.header_ns + 10**6)})
    table = demonstrations(made)
    assert table["clock"].to_list() == ["header", "header"]
    assert table["duration_s"][0] == table["duration_s"][1]
    assert "moves as a.mcap does, at other times" in table["remarks"][1]


# topics


def test_the_topic_can_be_named(project: Prepare) -> None:
    measured = reach().but(topic="/joint_states")
    wanted = reach(0.2).but(topic="/joint_states_desired")
    chosen = demonstrations(project({"a": measured.but(also=(wanted,))}))
    named = demonstrations(project({"a": measured.but(also=(wanted,))}, topic="/joint_states_desired"))
    assert "/joint_states is read for its name" in chosen["remarks"][0]
    assert named["remarks"][0] is None
    bow = [np.array(table["waypoints"][0].to_list())[7, 1] for table in (chosen, named)]
    assert bow[1] > bow[0] + 0.05


def test_joints_in_messages_of_their_own(project: Prepare) -> None:
    whole = reach()
    made = project({"a": whole})
    expected = np.array(demonstrations(made)["waypoints"][0].to_list())
    messages = []
    for row, at_ns in zip(whole.positions, whole.header_ns, strict=True):
        messages += [
            (("swing", "rail"), row[[1, 0]], int(at_ns)),
            (("gripper", "bend"), np.array([0.0, row[2]]), int(at_ns) + 10**6),
        ]
    save_messages(made.root / "mine" / "a.mcap", messages)
    table = demonstrations(made)
    np.testing.assert_allclose(np.array(table["waypoints"][0].to_list()), expected, atol=2e-3)
    assert "put together by name" in table["remarks"][0]


# whose and how many


def parts(recorded: Recorded, *cuts: int) -> list[Recorded]:
    edges = [0, *cuts, len(recorded.positions)]
    return [recorded.rows(slice(first, last)) for first, last in pairwise(edges)]


@pytest.mark.parametrize("index", [True, False])
def test_a_split_bag_is_one_demonstration(project: Prepare, index: bool) -> None:
    expected = demonstrations(project({"whole": reach()}))["waypoints"][0].to_list()
    made = project({f"tea_{number}": part for number, part in enumerate(parts(reach(), 90, 180))})
    if index:
        (made.root / "mine" / "metadata.yaml").write_text(INDEX.format(files="tea_0.mcap, tea_1.mcap, tea_2.mcap"))
    row = demonstrations(made).row(0, named=True)
    assert (row["demonstration_id"], row["participant"], row["source"], row["files"]) == ("tea", "tea", "tea_0.mcap", 3)
    assert row["waypoints"] == expected
    assert "put together from its 3 parts" in row["remarks"]
    assert rejected(made) == {}
    inputs = provenance_of(made.table("sweep", "demonstrations"))["inputs"]
    for number in range(3):
        content = (made.root / "mine" / f"tea_{number}.mcap").read_bytes()
        assert inputs[f"mine/tea_{number}.mcap"] == hashlib.sha256(content).hexdigest()


def test_numbered_recordings_that_do_not_touch_are_demonstrations_of_their_own(project: Prepare) -> None:
    made = project({f"tea_{number}": reach(0.1 * number).later(number * 2_801 * 10**6) for number in range(3)})
    table = demonstrations(made)
    assert table["demonstration_id"].to_list() == ["tea_0", "tea_1", "tea_2"]
    assert table["remarks"].to_list() == [None] * 3


def test_a_split_bag_with_a_part_missing_or_empty(project: Prepare) -> None:
    first, _, last = parts(reach(), 90, 180)
    made = project({"tea_0": first, "tea_2": last})
    (made.root / "mine" / "metadata.yaml").write_text(INDEX.format(files="tea_0.mcap, tea_1.mcap, tea_2.mcap"))
    assert "incomplete-bag" in refusal(made)
    empty = reach().rows(slice(0, 0))
    made = project({"tea_0": reach(), "tea_1": empty})
    (made.root / "mine" / "metadata.yaml").write_text(INDEX.format(files="tea_0.mcap, tea_1.mcap"))
    assert demonstrations(made)["demonstration_id"].to_list() == ["tea"]


def test_the_same_recording_twice_is_one_demonstration(project: Prepare) -> None:
    recorded = reach()
    made = project({"a": recorded, "copy": recorded})
    save(made.root / "mine" / "packed.mcap", recorded, CompressionType.LZ4)
    table = demonstrations(made)
    assert table["demonstration_id"].to_list() == ["a"]
    assert rejected(made) == {"copy.mcap": "copy", "packed.mcap": "copy"}
    assert "also in copy.mcap" in table["remarks"][0]
    assert "also in packed.mcap" in table["remarks"][0]


def test_spellings_of_one_name_are_one_person(project: Prepare) -> None:
    people = ["Zoë", "zoe\u0308", " ZOË ", "Zoë", "Ida"]
    made = project(
        {f"d{n}": reach(0.03 * n).but(metadata={"participant": name}).later(n * 10**9) for n, name in enumerate(people)}
    )
    table = demonstrations(made)
    assert table["participant"].to_list() == ["Zoë", "Zoë", "Zoë", "Zoë", "Ida"]
    assert "is taken for 'Zoë'" in table["remarks"][1]


def test_files_that_would_be_one_demonstration_are_refused(project: Prepare) -> None:
    made = project({"a": reach()})
    save(made.root / "mine" / "a.MCAP", reach(0.2))
    assert "same-name" in refusal(made)


def test_every_other_file_is_named_and_only_what_may_be_a_recording_stops(project: Prepare) -> None:
    made = project({"a": reach()})
    (made.root / "mine" / "notes.txt").write_text("Ann was tired.")
    assert demonstrations(made).height == 1
    assert rejected(made) == {"notes.txt": "not-a-recording"}
    (made.root / "mine" / "b.db3").write_bytes(b"SQLite format 3\0")
    (made.root / "mine" / "day2").mkdir()
    save(made.root / "mine" / "day2" / "c.mcap", reach(0.2))
    assert "2 of 3 recordings" in refusal(made)
    assert rejected(made) == {"b.db3": "corrupt", "day2": "not-read", "notes.txt": "not-a-recording"}


def test_a_recording_that_names_another_task(project: Prepare, parameters: dict[str, Any]) -> None:
    recorded = reach().but(metadata={"task": "pour"})
    assert "of task 'pour'" in demonstrations(project({"a": recorded}))["remarks"][0]
    parameters["tasks"]["pour"] = parameters["tasks"]["sweep"] | {"recordings": "others"}
    assert "another-task" in refusal(project({"a": recorded}))


# check


def test_check_says_what_ingest_finds(project: Prepare) -> None:
    recorded = reach().rows(np.r_[0:100, 105:280])
    made = project({"a": recorded, "b": back_and_forth()})
    lines, usable = report(made.root / "mine" / "a.mcap", made, "sweep")
    text = "\n".join(lines)
    assert usable
    for said in (
        "header times, 100 Hz, 0 samples dropped, longest gap 0.06 s, greatest speed",
        "distance to the start 0.00",
    ):
        assert said in text
    assert "  remark: no sample for 0.06 s from" in text
    without_task, usable = report(made.root / "mine" / "a.mcap", None, None)
    assert usable
    assert any("header times, 100 Hz" in line for line in without_task)
    for asked in ((made, "sweep"), (None, None)):
        lines, usable = report(made.root / "mine" / "b.mcap", *asked)
        assert (usable, "several-motions" in lines[0]) == (False, True)


def test_check_takes_a_part_for_the_whole_that_it_belongs_to(project: Prepare) -> None:
    made = project({f"tea_{number}": part for number, part in enumerate(parts(reach(), 140))})
    path: Path = made.root / "mine" / "tea_0.mcap"
    assert not report(path, made, "sweep")[1]
    (made.root / "mine" / "metadata.yaml").write_text(INDEX.format(files="tea_0.mcap, tea_1.mcap"))
    lines, usable = report(path, made, "sweep")
    assert usable
    assert "demonstration tea of tea, in 2 files" in lines[1]


def test_names_of_files_change_nothing_but_names(project: Prepare) -> None:
    given = {"a": reach(0.1), "b": reach(0.2).later(10**10), "c": reach(0.0).later(10**11)}
    first = demonstrations(project(given))
    second = demonstrations(project({"z": given["a"], "y": given["b"], "x": given["c"]}))
    assert first["waypoints"].to_list() == second["waypoints"].to_list()[::-1]
    assert NAMES == ("rail", "swing", "bend")
