"""Tables that were damaged, doctored or mixed up between runs: every stage that reads one says which file and row."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from ruamel.yaml import YAML

from pipeline.errors import TableError, WorkbenchError
from pipeline.formats.parquet.checked.conformance import SCHEMA_KEY
from pipeline.stages import catalog, density, featurize, figures, infer, ingest, inspect, robustness, sample, shift
from pipeline.workspace.project import Project
from schemas import schema
from tests.support import gantry_project

READS: dict[str, tuple[Callable[[Project], None], tuple[str, ...]]] = {
    "sample": (lambda p: sample.run(p, "sweep"), ("demonstrations",)),
    "shift": (lambda p: shift.run(p, "sweep"), ("demonstrations",)),
    "featurize": (lambda p: featurize.run(p, "sweep"), ("demonstrations", "alternatives")),
    "density": (lambda p: density.run(p, "sweep"), ("features", "feature_units")),
    "infer": (lambda p: infer.run(p, "sweep"), ("demonstrations", "features", "scales", "densities")),
    "robustness": (
        lambda p: robustness.run(p, "sweep"),
        ("demonstrations", "features", "scales", "shifted_alternatives"),
    ),
    "inspect": (
        lambda p: inspect.run(p, "sweep"),
        ("demonstrations", "alternatives", "features", "scales", "densities", "posteriors"),
    ),
    "figures": (lambda p: figures.run(p, "sweep"), ("posteriors", "held_out", "rejected")),
    "catalog": (catalog.run, ("rejected", "sampling", "alternatives", "posteriors", "held_out")),
}


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """The small project, computed up to the posteriors, with alternatives that belong to demonstrations."""
    root = tmp_path_factory.mktemp("damaged") / "project"
    root.mkdir()
    parameters: dict[str, Any] = deepcopy(gantry_project.PARAMETERS)
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5, 20], "working_set": 10}
    parameters["robustness"]["samplers"] = {
        name: parameters["robustness"]["samplers"][name] for name in ("near", "far")
    }
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    (root / "gantry.xml").write_text(gantry_project.GANTRY)
    with (root / "params.yaml").open("w") as stream:
        YAML(typ="safe", pure=True).dump(parameters, stream)
    for number in range(3):
        gantry_project.record(root / "mine" / f"demo-{number}.mcap", bow=0.1 * number)
    made = Project(root)
    for stage in (ingest, sample, featurize, density, infer, shift):
        stage.run(made, "sweep")
    return made


Damage = Callable[[pa.Table, str], pa.Table | None]


def _changed(table: pa.Table, name: str, row: int, value: object) -> pa.Table:
    """The table with another value in one place."""
    place = table.schema.get_field_index(name)
    type_ = table.schema.field(place).type
    values = table.column(name).to_pylist()
    values[row] = value
    return table.set_column(place, pa.field(name, type_), pa.array(values, type_))


def _of_floats(table: pa.Table) -> list[str]:
    def inner(type_: pa.DataType) -> pa.DataType:
        return inner(type_.value_type) if pa.types.is_fixed_size_list(type_) else type_

    return [field.name for field in table.schema if pa.types.is_floating(inner(field.type))]


def _with_number(number: float) -> Damage:
    def damage(table: pa.Table, name: str) -> pa.Table | None:
        checked = [column.name for column in schema(name).columns if column.finite or column.positive]
        further = schema(name).further
        if further is not None and further.finite:
            checked += [column for column in _of_floats(table) if column not in schema(name).columns]
        floats = _of_floats(table) if np.isnan(number) else checked
        if not floats:
            return None
        value = np.array(table.column(floats[-1]).to_pylist()[1])
        value[(0,) * value.ndim] = number
        return _changed(table, floats[-1], 1, value.tolist())

    return damage


def another_version(table: pa.Table, name: str) -> pa.Table:
    stated = f'{{"name": "{name}", "version": {schema(name).version + 1}}}'.encode()
    return table.replace_schema_metadata({**table.schema.metadata, SCHEMA_KEY: stated})


def another_type(table: pa.Table, name: str) -> pa.Table:
    key = schema(name).key[-1]
    wrong = pa.array([b"x"] * table.num_rows) if table.num_rows else pa.array([], pa.binary())
    return table.set_column(table.schema.get_field_index(key), key, wrong)


def a_gap(table: pa.Table, name: str) -> pa.Table | None:
    return _changed(table, schema(name).key[-1], 1, None) if table.num_rows else None


def a_row_twice(table: pa.Table, name: str) -> pa.Table | None:
    return pa.concat_tables([table, table.slice(1, 1)]).combine_chunks() if table.num_rows else None


def a_column_less(table: pa.Table, name: str) -> pa.Table:
    return table.drop_columns([schema(name).key[0]])


DAMAGES: dict[str, tuple[Damage, str]] = {
    "version": (another_version, "version"),
    "type": (another_type, "needed is"),
    "NaN": (_with_number(np.nan), r"holds NaN in row 2"),
    "infinity": (_with_number(np.inf), r"holds an infinite value in row 2"),
    "gap": (a_gap, "row 2"),
    "twice": (a_row_twice, "more than one row|among those of another part"),
    "column": (a_column_less, "lacks the column"),
}


@pytest.mark.parametrize("stage", READS)
def test_a_stage_names_what_is_wrong_with_a_table_it_reads(project: Project, stage: str) -> None:
    run, tables = READS[stage]
    tried = 0
    for name in tables:
        path = project.table("sweep", name)
        whole = path.read_bytes()
        table = pq.read_table(path)
        for kind, (damage, message) in DAMAGES.items():
            damaged = damage(table, name)
            if damaged is None:
                continue
            pq.write_table(damaged, path)
            with _kept(path, whole), pytest.raises(TableError) as caught:
                run(project)
            _assert_clear(str(caught.value), path, f"{stage} {name} {kind}")
            assert caught.match(message), f"{stage} {name} {kind}"
            tried += 1
        for content in (b"", b"PAR1" + bytes(90), whole[: len(whole) // 2], whole[:-9], None):
            if content is None:
                path.unlink()
                if stage == "catalog":
                    path.write_bytes(whole)
                    continue
            else:
                path.write_bytes(content)
            with _kept(path, whole), pytest.raises(TableError) as caught:
                run(project)
            _assert_clear(str(caught.value), path, f"{stage} {name}")
            tried += 1
    assert tried >= 8 * len(tables)


class _kept:
    """Puts the file back, and sees to it that nothing half written stays."""

    def __init__(self, path: Path, whole: bytes) -> None:
        self.path, self.whole = path, whole

    def __enter__(self) -> None:
        self.before = {file: file.read_bytes() for file in self.path.parent.glob("*.parquet") if file != self.path}

    def __exit__(self, *_: object) -> None:
        self.path.write_bytes(self.whole)
        assert {
            file: file.read_bytes() for file in self.path.parent.glob("*.parquet") if file != self.path
        } == self.before
        assert not list(self.path.parent.glob(".*"))


def _assert_clear(message: str, path: Path, case: str) -> None:
    assert "\n" not in message, case
    assert str(path) in message, (case, message)
    assert "Traceback" not in message


def orphans() -> Iterator[tuple[str, str, Callable[[pa.Table], pa.Table], str]]:
    """(stage, table, what is done to it, what the message says)."""

    def without_row(table: pa.Table) -> pa.Table:
        return pa.concat_tables([table.slice(0, 1), table.slice(2)]).combine_chunks()

    def renamed(column: str) -> Callable[[pa.Table], pa.Table]:
        return lambda table: _changed(table, column, 1, "nobody")

    def without_kind(kind: str) -> Callable[[pa.Table], pa.Table]:
        def leave_one_out(table: pa.Table) -> pa.Table:
            first = pc.index(table["kind"], kind).as_py()
            return pa.concat_tables([table.slice(0, first), table.slice(first + 1)]).combine_chunks()

        return leave_one_out

    yield (
        "featurize",
        "demonstrations",
        without_row,
        r"alternatives\.parquet: row 61 has anchor 'demo-1', for which .*demonstr",
    )
    yield "featurize", "alternatives", renamed("anchor"), "row 2 has anchor 'nobody'"
    yield (
        "density",
        "feature_units",
        without_row,
        r"features\.parquet: has the column 'vase', for which .*feature_units",
    )
    yield "density", "feature_units", renamed("feature"), "has the column 'vase'"
    for stage in ("infer", "robustness", "inspect"):
        yield (
            stage,
            "demonstrations",
            without_row,
            r"row \d+ has (id|anchor) 'demo-1', for which .*demonstrations",
        )
        yield (
            stage,
            "features",
            without_kind("demonstration"),
            r"demonstrations\.parquet: row 1 has demonstration_id 'demo-0'",
        )
        yield stage, "scales", without_row, r"features\.parquet: has the column 'vase', for which .*scales"
    for stage in ("infer", "inspect", "catalog"):
        yield (
            stage,
            "densities",
            without_row,
            r"features\.parquet: row 5 has id 'demo-0/10/working/000001', .*densities",
        )
        yield stage, "densities", renamed("alternative_id"), "row 2 has alternative_id 'nobody'"
    for stage in ("inspect", "catalog"):
        yield stage, "features", without_kind("alternative"), "'demo-0/10/working/000000'"
        yield stage, "posteriors", renamed("demonstration_id"), "row 2 has demonstration_id 'nobody'"
    yield "robustness", "shifted_alternatives", renamed("anchor"), "row 2 has anchor 'nobody'"
    yield "catalog", "held_out", renamed("demonstration_id"), "row 2 has demonstration_id 'nobody'"
    yield "catalog", "sampling", renamed("anchor"), "row 2 has anchor 'nobody'"


ORPHANS = list(orphans())


@pytest.mark.parametrize("number", range(len(ORPHANS)), ids=[f"{stage} {table}" for stage, table, _, _ in ORPHANS])
def test_rows_without_their_counterpart_are_named(project: Project, number: int) -> None:
    stage, name, damage, message = ORPHANS[number]
    path = project.table("sweep", name)
    whole = path.read_bytes()
    pq.write_table(damage(pq.read_table(path)), path)
    with _kept(path, whole), pytest.raises(WorkbenchError) as caught:
        READS[stage][0](project)
    assert caught.match(message), caught.value
    assert "dvc repro" in str(caught.value)


def test_trajectories_of_another_arm_or_length_are_named(project: Project) -> None:
    path = project.table("sweep", "alternatives")
    whole = path.read_bytes()
    table = pq.read_table(path)
    for shape, letter in (((15, 2), "J = 2"), ((9, 3), "T = 9")):
        type_ = pa.list_(pa.list_(pa.float64(), shape[1]), shape[0])
        arrays = pa.array(np.zeros((table.num_rows, *shape)).tolist(), type_)
        pq.write_table(table.set_column(table.schema.get_field_index("waypoints"), "waypoints", arrays), path)
        with _kept(path, whole), pytest.raises(TableError, match=f"{path}: has arrays of {letter} where"):
            featurize.run(project, "sweep")
