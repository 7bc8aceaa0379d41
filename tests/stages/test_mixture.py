"""A mixture has equal parts at every anchor; a sampler that cannot keep to the room of one is left out, in words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import polars as pl
import pytest

from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import ingest, sample, shift
from pipeline.workspace.project import Project, recorded_runs

Make = Callable[[dict[str, Any]], Project]


def sampled(project: Project) -> tuple[pl.DataFrame, list[str]]:
    ingest.run(project, "sweep")
    sample.run(project, "sweep")
    (notes,) = [run["notes"] for run in recorded_runs(project) if run["stage"] == "sample"]
    return read_table(project.table("sweep", "sampling"), "sampling"), notes  # type: ignore[return-value]


def test_a_part_that_cannot_be_had_is_shared_by_the_others(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["sample"]["via-point"]["reach_rad"] = 60.0  # leaves the limits all but always
    shares, notes = sampled(make_project(parameters))
    assert set(shares["sampler"]) == {"deformation", "planner"}
    assert (shares["kept"] * 2 - shares["set_size"]).abs().max() <= 1
    (note,) = notes
    assert note.startswith("no alternatives from 'via-point', whose part the others have: sampler 'via-point' had ")
    assert "left the joint limits" in note


def test_a_sampler_alone_that_cannot_be_had_stops_the_stage(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["sample"] |= {"sampler": "via-point"}
    parameters["sample"]["via-point"]["reach_rad"] = 60.0
    with pytest.raises(
        StageError, match=r"sampler 'via-point' had \d+ of \d+ paths accepted \(\d+ left the joint limits"
    ):
        sampled(make_project(parameters))


def test_large_sets_have_equal_parts_as_well(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["compute"]["partition"] = 40
    parameters["sample"] |= {"sizes": [100], "sets": 1}
    shares, notes = sampled(make_project(parameters))
    assert notes == []
    kept = shares.filter(set_size=100)["kept"].sort().to_list()
    assert kept == [33, 33, 34]


def test_collisions_are_counted(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["collisions"] = True
    parameters["sample"] |= {"sizes": [20], "sets": 1, "sampler": "deformation"}
    project = make_project(parameters)
    scene = project.root / "gantry.xml"
    pillar = '<body name="pillar" pos="0.55 0.15 0"><geom type="cylinder" size="0.03 0.3"/></body><body name="vase"'
    scene.write_text(scene.read_text().replace('<body name="vase"', pillar))
    shares, _ = sampled(project)
    assert shares["in_collision"].sum() > 0
    assert (
        shares["proposed"] - shares["kept"]
        == shares["outside_limits"] + shares["through_surface"] + shares["in_collision"]
    ).all()
    (produced,) = [run["produced"] for run in recorded_runs(project) if run["stage"] == "sample"]
    assert "in collision)" in str(produced)


def test_the_study_goes_without_a_sampler_that_cannot_be_had(make_project: Make, parameters: dict[str, Any]) -> None:
    samplers = parameters["robustness"]["samplers"]
    samplers["via"]["reach_rad"] = 60.0
    samplers["with_via"] = {"kind": "mixture", "of": ["near", "via"]}  # half of it can be had
    project = make_project(parameters)
    ingest.run(project, "sweep")
    shift.run(project, "sweep")
    table = read_table(project.table("sweep", "shifted_sampling"), "shifted_sampling")
    assert set(table["set_id"]) == {"near", "far", "both", "planned", "with_via"}
    (notes,) = [run["notes"] for run in recorded_runs(project) if run["stage"] == "shift"]
    (note,) = notes  # type: ignore[misc]
    assert note.startswith("the study goes without the sampler 'via': anchor 'task': sampler 'via' had ")
    for name in ("near", "far", "planned"):
        del samplers[name]
    parameters["robustness"]["samplers"] = {"via": samplers["via"], "narrow": {"kind": "deformation", "width_rad": 0.1}}
    with pytest.raises(
        StageError, match=r"of robustness\.samplers, 1 can draw for every anchor and 2 are needed .* 'via' had"
    ):
        shift.run(make_project(parameters), "sweep")
