"""A feature that is the same for all alternatives, of the task or of one anchor, is named, and stops nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.errors import BandwidthError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import density, featurize, figures, infer, ingest, inspect, robustness, sample, shift
from pipeline.workspace.project import Project, recorded_runs
from tests.support.gantry_project import record

Make = Callable[[dict[str, Any]], Project]
STAGES = (ingest, sample, featurize, density, infer, shift, robustness, figures, inspect)
NEAR = {"bow": 0.1}
FAR = {"start": (-0.9, 2.6, 0.1), "goal": (-0.9, 3.6, 0.2)}  # turned away from the vase
VASE = {"kind": "proximity", "object": "vase", "radius_m": 0.3}


def run(project: Project, stages: tuple[Any, ...] = STAGES) -> dict[str, list[str]]:
    """All stages; what each noted."""
    for stage in stages:
        stage.run(project, "sweep")
    return {str(run["stage"]): run["notes"] for run in recorded_runs(project)}  # type: ignore[misc]


def table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table("sweep", name), name)


def test_the_same_for_all(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["features"]["vase"] = VASE | {"radius_m": 0.01}
    project = make_project(parameters)
    notes = run(project)
    assert notes["density"] == ["feature 'vase' is the same for all 80 alternatives, so that nothing tells its weight"]
    scales = table(project, "scales")
    assert scales["varies"].to_list() == [True, False]
    assert scales["scale"][1] == 1
    # thetas that differ in that weight alone, once brought to the same scale, are told apart by nothing but its size
    posteriors = table(project, "posteriors").filter(set_id="working", demonstration_id="all", model="boltzmann")
    only_vase = posteriors.filter(pl.col("theta").arr.get(0) == 0)["log_posterior"].to_numpy()
    np.testing.assert_allclose(only_vase, only_vase[0], atol=1e-12)  # whatever beta is, all alternatives are as good


@pytest.mark.parametrize("preferred", [False, True])
def test_the_same_at_one_anchor(make_project: Make, parameters: dict[str, Any], preferred: bool) -> None:
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    parameters["tasks"]["sweep"]["features"]["vase"] = VASE
    parameters["sample"]["sizes"] = [6, 20]
    if preferred:
        parameters["tasks"]["sweep"]["preferences"]["vase"] = VASE
    project = make_project(parameters)
    record(project.root / "mine" / "demo-3.mcap", **FAR)
    notes = run(project)
    said = (
        "feature 'vase' is the same for all alternatives of demo-3 (of 4 anchors), so that these demonstrations hardly"
    )
    assert [note for note in notes["density"] if note.startswith(said)] == notes["density"]
    unplanned = "demo-3: paths are planned without 'vase', the same for all deformations"
    for stage in ("sample", "shift"):
        assert (unplanned in notes[stage]) == preferred
    assert table(project, "scales")["varies"].all()
    here = table(project, "posteriors").filter(set_id="working", demonstration_id="demo-3", model="boltzmann")
    only_vase = here.filter(pl.col("theta").arr.get(0) == 0)["log_posterior"].to_numpy()
    np.testing.assert_allclose(only_vase, only_vase[0], atol=1e-12)
    assert set(table(project, "robustness")["demonstration_id"]) == {"demo-0", "demo-1", "demo-2", "demo-3", "all"}


def test_where_nothing_varies_at_an_anchor_the_set_is_named(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"] |= {"anchor": "demonstration", "features": {"vase": VASE}}
    project = make_project(parameters)
    record(project.root / "mine" / "demo-3.mcap", **FAR)
    with pytest.raises(
        BandwidthError,
        match=r"set 'working' of 30 alternatives with anchor 'demo-3': .* one distinct row; .* as a number",
    ):
        run(project, STAGES[:4])
    parameters["density"]["bandwidth"] = 0.1
    run(make_project(parameters), STAGES[:6])
