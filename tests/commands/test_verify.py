"""`lessbench verify` names whatever is no longer as it was made."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.commands.verify import verify
from pipeline.formats.parquet.tables import read_table, write_table
from pipeline.stages import density, featurize, human_choice, infer, ingest, sample
from pipeline.workspace.project import Project
from tests.support.tables import provenance_of

Make = Callable[[dict[str, Any]], Project]


@pytest.fixture
def made(make_project: Make, parameters: dict[str, Any]) -> Project:
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")
    return project


def drift(project: Project, count: int = 30) -> list[str]:
    return verify(Project(project.root), "sweep", count).drift


def tamper(project: Project, name: str, change: Callable[[pl.DataFrame], pl.DataFrame]) -> None:
    """Change rows of a table and keep what it says of itself."""
    path = project.table("sweep", name)
    write_table(path, name, change(read_table(path, name)), provenance_of(path))


def test_nothing_has_drifted(made: Project) -> None:
    found = verify(made, "sweep", 30)
    assert found.drift == []
    assert (found.tables, found.trajectories, found.posteriors) == (12, 33, 30)
    assert found.files > 20
    assert found.lines("sweep") == [
        f"sweep: 12 tables as they were made; 0 other outputs, {found.files} input hashes, 33 trajectories and 30 "
        "posteriors checked again"
    ]


def test_a_flipped_feature_value(made: Project) -> None:
    tamper(
        made, "features", lambda t: t.with_columns(vase=pl.when(pl.col("id") == "demo-1").then(7.5).otherwise("vase"))
    )
    said = drift(made)
    assert any("features.parquet: vase of the demonstration demo-1 is 7.5, and " in line for line in said), said
    for table in ("densities", "scales", "posteriors", "held_out"):
        tables = "datasets/sweep/tables"
        assert f"{tables}/{table}.parquet: {tables}/features.parquet has changed since it was made" in said


def test_an_altered_posterior(made: Project) -> None:
    tamper(made, "posteriors", lambda t: t.with_columns(posterior=pl.col("posterior") + 1e-6))
    assert any("posteriors.parquet: the posterior of" in line and "when computed again" in line for line in drift(made))


def test_an_altered_density(made: Project) -> None:
    tamper(made, "densities", lambda t: t.with_columns(log_density=pl.col("log_density") + 0.01))
    assert any("densities.parquet: log_density of" in line and "when computed again" in line for line in drift(made))


def test_changed_parameters(make_project: Make, parameters: dict[str, Any], made: Project) -> None:
    parameters["infer"]["betas"] = [1, 2]
    parameters["seed"] = 8
    said = drift(make_project(parameters))
    other = "was made with other parameters than params.yaml has now"
    assert {line.split(":")[0] for line in said if other in line} == {
        f"datasets/sweep/tables/{table}.parquet"
        for table in ("alternatives", "sampling", "posteriors", "held_out", "support", "fits")
    }
    assert "datasets/sweep/tables/alternatives.parquet: was made with the seed 7; params.yaml has 8" in said


def test_another_scene(made: Project) -> None:
    scene = made.root / "gantry.xml"
    scene.write_text(scene.read_text().replace('pos="0.4 0.3 0"', 'pos="0.4 0.2 0"'))
    said = drift(made)
    assert "datasets/sweep/tables/features.parquet: was made with another scene model than the task has now" in said
    assert "datasets/sweep/tables/features.parquet: gantry.xml has changed since it was made" in said
    assert any("features.parquet: vase of the demonstration" in line for line in said)


def test_recordings_that_changed_came_or_went(made: Project) -> None:
    folder = made.root / "mine"
    recorded = folder / "demo-0.mcap"
    recorded.write_bytes(recorded.read_bytes() + b"\0")
    (folder / "demo-1.mcap").rename(folder / "demo-9.mcap")
    table = "datasets/sweep/tables/demonstrations.parquet"
    assert [line for line in drift(made, 0) if line.startswith(table)] == [
        f"{table}: mine/demo-0.mcap has changed since it was made",
        f"{table}: was made from mine/demo-1.mcap, which is not there any more",
        f"{table}: was made without the recording demo-9.mcap",
    ]


def test_a_table_that_is_no_table_and_rows_that_are_gone(made: Project) -> None:
    made.table("sweep", "sampling").write_bytes(b"PAR1 no more")
    tamper(made, "features", lambda t: t.filter(pl.col("kind") == "demonstration"))
    said = drift(made)
    assert any("sampling.parquet: cannot be read as Parquet" in line for line in said), said
    assert any("features.parquet: has no row of the alternative task/" in line for line in said), said


def test_what_dvc_recorded_is_compared(made: Project) -> None:
    entries = "".join(
        f"    - path: datasets/sweep/tables/{name}.parquet\n      md5: {32 * '0'}\n"
        for name in ("held_out", "shifted_features")
    )
    (made.root / "dvc.lock").write_text(f"schema: '2.0'\nstages:\n  infer@sweep:\n    outs:\n{entries}")
    assert drift(made, 0) == [
        "datasets/sweep/tables/shifted_features.parquet: is not there any more; make it again with `dvc repro`",
        "datasets/sweep/tables/held_out.parquet: is not the file that `dvc repro` wrote",
    ]


def test_the_studies(make_project: Make, parameters: dict[str, Any]) -> None:
    source = Path(__file__).resolve().parents[2] / "datasets" / "studies" / "human_choice" / "choices.csv"
    project = make_project(parameters)
    choices = project.root / "choices.csv"
    choices.write_bytes(source.read_bytes())
    human_choice.run(project)
    assert verify(project, "studies", 5).drift == []
    choices.write_bytes(choices.read_bytes() + b"\n")
    assert len(verify(project, "studies", 5).drift) == 4
