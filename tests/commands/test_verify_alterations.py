"""Whatever a person reads is altered, one file at a time: `lessbench verify` names it, with dvc.lock and without."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from ruamel.yaml import YAML

from pipeline.commands.verify import verify, verify_project
from pipeline.formats.parquet.checked.conformance import CONTENT_KEY
from pipeline.formats.parquet.tables import read_table, write_table
from pipeline.stages import catalog, report
from pipeline.stages.registry import STAGES, Scope, table_makers
from pipeline.workspace.outputs import output_hash
from pipeline.workspace.project import Project
from tests.support import gantry_project
from tests.support.tables import provenance_of

TASK = "sweep"
TABLES = tuple(table for table, maker in table_makers(TASK).items() if maker in STAGES)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A project of one task with everything that is made for it."""
    root = tmp_path_factory.mktemp("altered") / "project"
    parameters: dict[str, Any] = deepcopy(gantry_project.PARAMETERS)
    parameters["sample"] |= {"sampler": "deformation", "sets": 2, "sizes": [5, 20], "working_set": 20}
    (root / "mine").mkdir(parents=True)
    (root / "gantry.xml").write_text(gantry_project.GANTRY)
    with (root / "params.yaml").open("w") as stream:
        YAML(typ="safe", pure=True).dump(parameters, stream)
    for number in range(3):
        gantry_project.record(root / "mine" / f"demo-{number}.mcap", bow=0.1 * number)
    project = Project(root)
    for stage in STAGES:
        if stage.scope is Scope.TASK:
            stage.run(project, TASK)
    catalog.run(project)
    report.run(project)
    return project


@pytest.fixture(params=["records of runs", "dvc.lock"])
def made(whole: Project, request: pytest.FixtureRequest, tmp_path: Path) -> Project:
    """The project as it was made, where one of the two says what was written."""
    root = tmp_path / "project"
    shutil.copytree(whole.root, root)
    project = Project(root)
    if request.param == "dvc.lock":
        shutil.rmtree(root / ".lessbench")
        places = [
            place.format(task=TASK)
            for stage in STAGES
            if stage.scope in (Scope.TASK, Scope.PROJECT)
            for place in (
                *stage.outputs, *stage.metrics, *(f"datasets/{TASK}/tables/{table}.parquet" for table in stage.makes)
            )
        ]  # fmt: skip
        outs = [{"path": place, "md5": output_hash(root / place)} for place in places]
        with (root / "dvc.lock").open("w") as stream:
            YAML(typ="safe", pure=True).dump({"schema": "2.0", "stages": {"all": {"outs": outs}}}, stream)
    return project


def drift(project: Project) -> list[str]:
    fresh = Project(project.root)
    return [*verify(fresh, TASK, 5).drift, *verify_project(fresh).drift]


def test_nothing_is_altered(made: Project) -> None:
    assert drift(made) == []
    assert verify_project(made).lines("catalog and report") == ["catalog and report: as they were written"]


@pytest.mark.parametrize("table", TABLES)
def test_a_row_is_dropped_or_a_value_changed(made: Project, table: str) -> None:
    """As another program would: all that the file says of itself stays, its checksum too."""
    path = made.table(TASK, table)
    before = pq.ParquetFile(path)
    rows, content = before.read(), before.metadata.metadata[CONTENT_KEY]
    if not rows.num_rows:
        rows = pa.table({name: pa.array([_any(rows.schema.field(name).type)]) for name in rows.column_names})
    elif numbers := [name for name in rows.column_names if pa.types.is_floating(rows.schema.field(name).type)]:
        place = rows.schema.get_field_index(numbers[-1])
        values = rows.column(place).to_pylist()
        values[0] = 0.125 if values[0] != 0.125 else 0.25
        rows = rows.set_column(place, rows.schema.field(place), pa.array(values, rows.schema.field(place).type))
    else:
        rows = rows.slice(0, rows.num_rows - 1)
    metadata = before.schema_arrow.metadata | {CONTENT_KEY: content}
    pq.write_table(rows.replace_schema_metadata(metadata), path)
    assert any(f"/{table}.parquet" in line for line in drift(made)), drift(made)


def _any(type_: pa.DataType) -> object:
    return "x" if pa.types.is_string(type_) else 0


@pytest.mark.parametrize("table", ["demonstrations", "posteriors", "robustness_summary", "scales"])
def test_a_table_is_gone(made: Project, table: str) -> None:
    made.table(TASK, table).unlink()
    gone = f"datasets/{TASK}/tables/{table}.parquet: is not there any more"
    recorded = (made.root / "dvc.lock").is_file()
    assert any(line.startswith(gone) for line in drift(made)) == recorded or any(table in line for line in drift(made))


def test_demonstrations_that_are_not_in_the_recordings(made: Project) -> None:
    """Written as this program writes, with a checksum that fits: the recordings say otherwise."""
    path = made.table(TASK, "demonstrations")
    rows = read_table(path, "demonstrations")
    write_table(
        path, "demonstrations", rows.with_columns(participant=rows["participant"].reverse()), provenance_of(path)
    )
    said = f"datasets/{TASK}/tables/demonstrations.parquet: participant of 'demo-0' is another when the recordings"
    assert any(line.startswith(said) for line in drift(made))
    write_table(path, "demonstrations", rows[1:], provenance_of(path))
    assert any("'demo-0' is among them, and not in the table" in line for line in drift(made))


def _append(path: Path) -> None:
    with path.open("ab") as stream:
        stream.write(b" ")


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def _asked(question: str) -> Callable[[Path], None]:
    def alter(path: Path) -> None:
        with duckdb.connect(path) as con:
            con.execute(question)

    return alter


ALTERATIONS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "a figure is edited": (f"datasets/{TASK}/figures/posterior.svg", _append),
    "a figure is gone": (f"datasets/{TASK}/figures/posterior.png", Path.unlink),
    "a figure is another": (
        f"datasets/{TASK}/figures/posterior.png", lambda path: shutil.copy(path.with_name("density_map.png"), path)
    ),
    "all figures are gone": (f"datasets/{TASK}/figures", shutil.rmtree),
    "headline numbers are edited": (f"datasets/{TASK}/metrics.json", _append),
    "headline numbers are gone": (f"datasets/{TASK}/metrics.json", Path.unlink),
    "the recording for the viewer is cut": (f"datasets/{TASK}/inspect.rrd", _cut),
    "the recording for the viewer is gone": (f"datasets/{TASK}/inspect.rrd", Path.unlink),
    "the scene's description is edited": (f"datasets/{TASK}/scene.json", _append),
    "the report is edited": ("datasets/report.html", _append),
    "the report is gone": ("datasets/report.html", Path.unlink),
    "a value in the catalog": ("datasets/catalog.duckdb", _asked("update posteriors set posterior = 0.5")),
    "a view of the catalog": (
        "datasets/catalog.duckdb", _asked("create or replace view best_hypothesis as select 1 as theta_id")
    ),
    "the catalog is gone": ("datasets/catalog.duckdb", Path.unlink),
    "a recording is edited": ("mine/demo-0.mcap", _append),
    "a recording is gone": ("mine/demo-0.mcap", Path.unlink),
    "a recording came": ("mine/demo-0.mcap", lambda path: shutil.copy(path, path.with_name("demo-9.mcap"))),
    "the scene is another": ("gantry.xml", _append),
}  # fmt: skip


@pytest.mark.parametrize("alteration", ALTERATIONS)
def test_what_is_no_table(made: Project, alteration: str) -> None:
    place, alter = ALTERATIONS[alteration]
    alter(made.root / place)
    assert drift(made) != []


def test_nothing_says_how_it_was_written(made: Project) -> None:
    """As in a folder that came from elsewhere without the records of its runs."""
    shutil.rmtree(made.root / ".lessbench", ignore_errors=True)
    (made.root / "dvc.lock").unlink(missing_ok=True)
    said = drift(made)
    for place in (f"datasets/{TASK}/figures", f"datasets/{TASK}/inspect.rrd", "datasets/catalog.duckdb"):
        assert f"{place}: there is no record of how it was written; make it with `dvc repro`" in said
