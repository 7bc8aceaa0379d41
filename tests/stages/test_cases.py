"""Recordings that went wrong once, and recordings of people, where they are beside the repository."""

from __future__ import annotations

import shutil
from pathlib import Path

import polars as pl
import pytest
from ruamel.yaml import YAML

from pipeline.commands.check import report
from pipeline.errors import WorkbenchError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import featurize, ingest, sample
from pipeline.workspace.demonstrations import Intake
from pipeline.workspace.project import Project

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
CASES, REAL = SHARED / "cases", SHARED / "real" / "jaco"
here = pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not beside the repository")
people = pytest.mark.skipif(not REAL.is_dir(), reason="the shared real recordings are not beside the repository")


def case(name: str, tmp_path: Path) -> Project:
    shutil.copytree(next(CASES.glob(f"{name}/project")), tmp_path / "project")
    return Project(tmp_path / "project")


def features_of(project: Project) -> pl.DataFrame:
    for stage in (ingest, sample, featurize):
        stage.run(project, "own")
    return read_table(project.table("own", "features"), "features")


@here
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("b04", r"d0\.mcap \(beyond-limits\): .*'j2' is at 1\d\d\.\d+; its limits are 0\.8 to 5\.4 rad.*degrees"),
        ("b06a", r"keyframe 'start' joint 'j2' is at 85"),
        ("b06b", r"keyframe 'start' joint 'j2' is at 1\.5; its limits are 0\.0139626"),
        ("b02", r"row 1 is 3 x 21; it has joint after joint"),
    ],
)
def test_what_cannot_be_right_is_refused(name: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(WorkbenchError, match=said):
        features_of(case(name, tmp_path))


@here
def test_one_zero_stamp_does_not_change_the_clock(tmp_path: Path) -> None:
    features = features_of(case("b07", tmp_path)).filter(pl.col("kind") == "demonstration")
    assert features["efficiency"].to_list() == pytest.approx([0.125] * 2, abs=5e-4)
    assert features["height"].to_list() == pytest.approx([6.43] * 2, abs=5e-3)
    assert features["vase"].to_list() == pytest.approx([5.23] * 2, abs=5e-3)


@here
def test_a_split_bag_and_two_topics(tmp_path: Path) -> None:
    for name, identity in (("b09", "my_bag"), ("b21", "both")):
        project = case(name, tmp_path / name)
        ingest.run(project, "own")
        table = read_table(project.table("own", "demonstrations"), "demonstrations")
        assert table["demonstration_id"].to_list() == [identity]
        assert table["duration_s"][0] == pytest.approx(1.65, abs=0.01)
        assert table["remarks"][0] is not None


@here
def test_given_joints_without_limits_are_unwrapped(tmp_path: Path) -> None:
    features = features_of(case("b03", tmp_path)).filter(pl.col("kind") != "demonstration")
    assert 0.126 < features["efficiency"].min() < features["efficiency"].max() < 0.21  # type: ignore[operator]


@here
def test_the_named_file_is_read_beside_one_that_a_pattern_would_find(tmp_path: Path) -> None:
    project = case("b01b", tmp_path)
    named = pl.concat(pl.from_arrow(batch) for batch in _batches(project.root / "alts[1].parquet"))  # type: ignore[misc]
    features_of(project)
    used = read_table(project.table("own", "alternatives"), "alternatives")["waypoints"][0]
    flat = [value for pose in used.to_list() for value in pose]
    assert any(abs(sum(flat) - sum(_flat(row))) < 1e-9 for row in named["waypoints"].to_list())


def _batches(path: Path) -> list[object]:
    import pyarrow.parquet as pq

    with path.open("rb") as stream:
        return list(pq.ParquetFile(stream).read(columns=["waypoints"]).to_batches())


def _flat(row: list[object]) -> list[float]:
    return [value for pose in row for value in (pose if isinstance(pose, list) else [pose])]  # type: ignore[misc]


CHECKED = {
    "o03_measured_and_desired_topics/rec/rec.mcap": (True, "remark: /joint_states is read for its name"),
    "o05_arm_joints_split_over_messages/rec/rec.mcap": (
        True,
        "joints: panda_joint1, panda_joint2, panda_joint3, panda_joint4, panda_joint5, panda_joint6, panda_joint7",
    ),
    "o06_three_demos_in_one_bag/rec/rec.mcap": (False, "the recording holds 3 motions, not one"),
    "o10_sqlite3_db3/rec/rec.db3": (True, "JointState in cdr, 800 messages"),
    "o10_sqlite3_db3/rec": (True, "JointState in cdr, 800 messages"),
    "o11_mcap_zstd_file_compressed/rec/rec.mcap.zstd": (True, "JointState in cdr, 800 messages"),
    "o11_mcap_zstd_file_compressed/rec": (True, "JointState in cdr, 800 messages"),
    "o13_ros1_bag/rec.bag": (True, "JointState in ros1, 800 messages"),
    "o15_ros1_in_mcap/rec.mcap": (True, "JointState in ros1, 800 messages"),
    "o30_joint_trajectory_msg/rec/rec.mcap": (True, "says where the arm was to be (JointTrajectory)"),
    "o33_carries_high/high0.mcap": (True, "header times, 100 Hz"),
    "o37_one_duplicate_stamp/rec/rec.mcap": (True, "1 samples dropped"),
}


@here
@pytest.mark.parametrize("name", CHECKED)
def test_check_says_what_it_is(name: str) -> None:
    if name.startswith(("o13", "o30")):
        pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    lines, usable = report(CASES / name, None, None)
    assert (usable, CHECKED[name][1] in "\n".join(lines)) == (CHECKED[name][0], True), lines


@here
def test_parts_that_touch_are_one_recording(tmp_path: Path) -> None:
    folder = CASES / "o07_split_bag"
    project = case("b21", tmp_path)
    shutil.rmtree(project.root / "rec")
    shutil.copytree(folder, project.root / "rec")
    names = [f"panda_joint{number}" for number in range(1, 8)]
    joints = "".join(
        f'<body name="l{n}" pos="0 0 0.1"><joint name="{name}" axis="{n % 2} {1 - n % 2} 0"/>'
        for n, name in enumerate(names)
    )
    scene = f'<mujoco><worldbody>{joints}<geom size="0.01"/>{"</body>" * 7}</worldbody></mujoco>'
    (project.root / "scene.xml").write_text(scene.replace("/><body", '/><geom size="0.01"/><body'))
    yaml = YAML(typ="safe", pure=True)
    content = yaml.load((project.root / "params.yaml").read_text())
    content["tasks"]["own"] |= {
        "end_effector": "l6",
        "anchor": "demonstration",
        "features": {"e": {"kind": "efficiency"}},
    }
    with (project.root / "params.yaml").open("w") as stream:
        yaml.dump(content, stream)
    project = Project(project.root)
    ingest.run(project, "own")
    table = read_table(project.table("own", "demonstrations"), "demonstrations")
    assert (table["demonstration_id"].to_list(), table["files"].to_list()) == (["rec"], [3])


CONDITIONS = {"human1": "human", "human2": "human", "laptop1": "laptop", "laptop2": "laptop", "table1": "table"}


@people
@pytest.mark.parametrize("condition", CONDITIONS)
def test_no_recording_of_the_twelve_people_is_refused(condition: str) -> None:
    project = Project(ROOT)
    intake = Intake.of(project, CONDITIONS[condition])
    found = ingest.collect(REAL / "twelve" / condition, intake)
    assert (len(found.rows), found.rejected) == (12, [])
    assert all("from keyframe 'goal'" in row["remarks"] for row in found.rows if row["goal_apart"] > 0.1)


@people
def test_none_of_the_twenty_is_refused(tmp_path: Path) -> None:
    shutil.copytree(REAL / "recordings", tmp_path / "people", ignore=shutil.ignore_patterns("kinesthetic*"))
    project = Project(ROOT)
    laptop = Intake.of(project, "laptop")
    found = ingest.collect(tmp_path / "people", Intake("people", laptop.scene, laptop.settings, shared_ends=False))
    assert (len(found.rows), found.rejected) == (20, [])
    kinesthetic = tmp_path / "kinesthetic"
    kinesthetic.mkdir()
    shutil.copy(REAL / "recordings" / "kinesthetic_ID0_task0.mcap", kinesthetic)
    found = ingest.collect(kinesthetic, Intake("kinesthetic", laptop.scene, laptop.settings, shared_ends=True))
    assert (len(found.rows), found.rejected) == (1, [])


@people
def test_a_recording_of_another_scene_is_refused(tmp_path: Path) -> None:
    """A neighbour of the real recordings: the same arm, ends of its own, in a task whose ends all share."""
    shutil.copytree(REAL / "recordings", tmp_path / "people", ignore=shutil.ignore_patterns("kinesthetic*"))
    found = ingest.collect(tmp_path / "people", Intake.of(Project(ROOT), "laptop"))
    assert {row["reason"] for row in found.rejected} == {"far-ends"}
