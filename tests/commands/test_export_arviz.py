"""The export as ArviZ sees it; and what is in it, for machines without ArviZ."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pipeline.answers.tables import group_of
from pipeline.commands.export_arviz import CHAINS, DRAWS, export_arviz
from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import answer, density, featurize, ingest, sample
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]


@pytest.fixture
def exported(make_project: Make, parameters: dict[str, Any]) -> Project:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5]}
    project = make_project(parameters)
    with pytest.raises(StageError, match="there are no weights yet"):
        export_arviz(project, "sweep")
    for one in (ingest, sample, featurize, density, answer):
        one.run(project, "sweep")
    export_arviz(project, "sweep")
    return project


def test_draws_of_equal_weight_are_those_of_the_table(exported: Project) -> None:
    group = group_of(read_table(exported.table("sweep", "weights"), "weights").filter(model="less"))
    path = exported.datasets / "sweep" / "arviz" / "less.json"
    found = json.loads(path.read_text())
    drawn = np.array(found["posterior"]["group"])
    assert drawn.shape == (CHAINS, DRAWS, 2)
    step = group.interval(0.9)[:, 1] - group.interval(0.9)[:, 0]
    np.testing.assert_allclose(drawn.mean(axis=(0, 1)), group.mean, atol=0.02 * step.max())
    assert np.array(found["log_likelihood"]["features"]).shape == (CHAINS, DRAWS, 3)
    assert (np.array(found["log_likelihood"]["features"]) <= 1e-12).all()  # 0 is certainty, but for rounding
    before = path.read_bytes()
    export_arviz(exported, "sweep")
    assert path.read_bytes() == before


@pytest.mark.filterwarnings("ignore")  # ArviZ warns that three demonstrations are few
def test_arviz_opens_summarises_and_compares_it(exported: Project) -> None:
    az = pytest.importorskip("arviz", reason="ArviZ is not installed; pip install arviz")
    if not hasattr(az, "from_json"):
        pytest.skip("this ArviZ has no from_json, which the export is written for")
    data = {
        name: az.from_json(exported.datasets / "sweep" / "arviz" / f"{name}.json") for name in ("less", "boltzmann")
    }
    posterior = data["less"].posterior
    assert posterior["group"].dims == ("chain", "draw", "feature")
    assert posterior["person"].sizes["participant"] == 3
    summary = az.summary(data["less"], var_names=["group", "spread", "beta"])
    assert list(summary.index) == ["group[effort]", "group[vase]", "spread", "beta"]
    assert (summary["r_hat"] < 1.05).all()
    assert set(az.compare(data).index) == {"less", "boltzmann"}
