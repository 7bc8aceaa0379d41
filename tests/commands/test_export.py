"""`lessbench export` of motions: what is in the folders, and what of a user's is never replaced."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.commands import plan
from pipeline.commands.export import FORMS, Wanted, export
from pipeline.errors import ParameterError, StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import answer, density, featurize, ingest, sample
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]
MOTIONS = [form for form in FORMS if FORMS[form].motions]


@pytest.fixture
def project(make_project: Make, parameters: dict[str, Any]) -> Project:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5]}
    project = make_project(parameters)
    with pytest.raises(StageError, match="no demonstrations yet; run `lessbench ingest sweep`"):
        export(project, "sweep", Wanted("csv"))
    ingest.run(project, "sweep")
    return project


def table(project: Project) -> pl.DataFrame:
    return read_table(project.table("sweep", "demonstrations"), "demonstrations")


def test_an_export_to_mcap_is_taken_in_again_as_the_same_demonstrations(project: Project) -> None:
    before = table(project)
    export(project, "sweep", Wanted("mcap"))
    shutil.rmtree(project.root / "mine")
    (project.datasets / "sweep" / "mcap").rename(project.root / "mine")
    ingest.run(project, "sweep")
    after = table(project)
    np.testing.assert_allclose(after["waypoints"].to_numpy(), before["waypoints"].to_numpy(), atol=0.02)
    same = ["demonstration_id", "participant", "simulated", "true_theta"]
    assert after.select(same).equals(before.select(same))
    assert (after["start_time_ns"] - before["start_time_ns"]).abs().max() < 0.1e9  # type: ignore[operator]


def test_tables_have_the_waypoints_of_the_demonstrations(project: Project) -> None:
    for form in ("csv", "parquet"):
        export(project, "sweep", Wanted(form))
    folder = project.datasets / "sweep"
    read = pl.read_csv(folder / "csv" / "motions.csv", infer_schema_length=None)
    assert read.equals(pl.read_parquet(folder / "parquet" / "motions.parquet"))
    rows = table(project)
    assert read["demonstration_id"].unique(maintain_order=True).to_list() == rows["demonstration_id"].to_list()
    poses = read.select("rail", "swing", "bend").to_numpy().reshape(len(rows), 15, 3)
    np.testing.assert_array_equal(poses, rows["waypoints"].to_numpy())
    ends = read.group_by("demonstration_id", maintain_order=True).last()["time_s"]
    np.testing.assert_allclose(ends, rows["duration_s"], atol=1e-9)


def test_a_rate_is_kept_by_every_form(project: Project) -> None:
    export(project, "sweep", Wanted("csv", rate_hz=50))
    times = pl.read_csv(project.datasets / "sweep" / "csv" / "motions.csv").filter(
        pl.col("demonstration_id") == pl.col("demonstration_id").first()
    )["time_s"]
    np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-9)
    export(project, "sweep", Wanted("lerobot", rate_hz=10))
    assert '"fps": 10' in (project.datasets / "sweep" / "lerobot" / "meta" / "info.json").read_text()


def test_the_plan_is_exported_in_its_place(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(StageError, match="there is no plan yet; run `lessbench plan sweep`"):
        export(project, "sweep", Wanted("csv", plan=True))
    for one in (sample, featurize, density, answer):
        one.run(project, "sweep")
    plan.run(project, "sweep", plan.Wanted(None, "less", False))
    capsys.readouterr()
    for form in MOTIONS:
        export(project, "sweep", Wanted(form, plan=True))
    assert "csv-plan: the plan of sweep, joints rail, swing, bend" in capsys.readouterr().out
    read = pl.read_csv(project.datasets / "sweep" / "csv-plan" / "motions.csv")
    assert read["participant"].unique().to_list() == ["plan for someone new"]
    np.testing.assert_allclose(np.diff(read["time_s"]), 0.01, atol=2e-4)  # 100 Hz, stretched to the duration
    ends = read.select("rail", "swing", "bend").to_numpy()[[0, -1]]
    np.testing.assert_allclose(ends, [[-0.3, -0.6, 0.1], [0.3, 0.9, -0.2]], atol=1e-6)


@pytest.mark.parametrize("form", MOTIONS)
def test_the_same_demonstrations_give_the_same_bytes(project: Project, form: str) -> None:
    folders = [project.root / "out" / name for name in ("one", "two")]
    for folder in folders:
        export(project, "sweep", Wanted(form, folder))
    one, two = ({path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")} for folder in folders)
    assert one
    assert one == two


def test_what_somebody_has_in_a_folder_is_not_replaced_unasked(project: Project, tmp_path: Path) -> None:
    folder = tmp_path / "notes"
    folder.mkdir()
    export(project, "sweep", Wanted("csv", folder))
    (folder / "note.txt").write_text("mine")
    before = sorted(path.name for path in folder.iterdir())
    with pytest.raises(StageError, match="has something in it, so nothing was written"):
        export(project, "sweep", Wanted("parquet", folder))
    assert sorted(path.name for path in folder.iterdir()) == before
    export(project, "sweep", Wanted("parquet", folder, force=True))
    assert sorted(path.name for path in folder.iterdir()) == ["columns.json", "motions.parquet"]


def test_no_force_replaces_the_project_or_what_it_is_in(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(project.root)
    monkeypatch.setattr(Path, "home", lambda: project.root / "home" / "ada")
    places = [project.datasets, project.datasets / "sweep", project.table("sweep", "features").parent]
    for folder in (Path(), Path(".."), project.root, *places, project.root / "home", project.root / "mine"):
        with pytest.raises(StageError, match="holds more than an export; name a new folder"):
            export(project, "sweep", Wanted("csv", folder, force=True))
    with pytest.raises(StageError, match="is a file or link"):
        export(project, "sweep", Wanted("csv", project.root / "params.yaml", force=True))
    assert (project.root / "params.yaml").is_file()


def test_nothing_is_left_of_an_export_that_fails(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pipeline.formats.motions.lerobot._write_json", full)
    with pytest.raises(StageError, match="free some space"):
        export(project, "sweep", Wanted("lerobot"))
    assert not [path for path in (project.datasets / "sweep").iterdir() if "lerobot" in path.name]


def test_demonstrations_of_another_scene_are_not_given_its_joints(project: Project) -> None:
    scene = project.root / "gantry.xml"
    scene.write_text(scene.read_text().replace('name="bend"', 'name="fold"'))
    with pytest.raises(StageError, match=r"is of another scene than the one that tasks\.sweep\.scene names now"):
        export(project, "sweep", Wanted("csv"))


def test_what_is_not_known_is_said(project: Project) -> None:
    with pytest.raises(ParameterError, match="--to is 'xls'; allowed are arviz, csv, lerobot, mcap"):
        export(project, "sweep", Wanted("xls"))
    with pytest.raises(ParameterError, match="takes neither --plan nor --hz"):
        export(project, "sweep", Wanted("arviz", rate_hz=5))
    with pytest.raises(ParameterError, match="nowhere"):
        export(project, "nowhere", Wanted("csv"))
