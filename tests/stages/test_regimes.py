"""The stage `regimes`: its tables fit the studies they come from, on an arm of another shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import density, featurize, infer, ingest, regimes, robustness, sample, shift
from pipeline.stages.registry import stage
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]
CHAIN = (ingest, sample, featurize, density, infer, shift, robustness)


def table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table("sweep", name), name)


@pytest.fixture
def compared(make_project: Make, parameters: dict[str, Any]) -> Project:
    parameters["robustness"]["regimes"] = {"optima": 2, "choices": 3, "repetitions": 1}
    project = make_project(parameters)
    for one in (*CHAIN, regimes):
        one.run(project, "sweep")
    return project


def test_regimes_of_a_small_arm(compared: Project, parameters: dict[str, Any]) -> None:
    rows, robust = table(compared, "regimes"), table(compared, "robustness")
    assert {"independent", "sampler-shift", "with-optima", "explored-space"} <= set(rows["regime"])
    # the sets of the robustness study are as it has them
    keys = ["regime", "model", "set_size", "demonstration_id", "participant"]
    both = robust.join(rows, on=keys, suffix="_here")
    assert both.height == robust.height
    np.testing.assert_array_equal(both["kl_mean"], both["kl_mean_here"])
    explored = rows.filter(regime="explored-space")
    samplers = len(parameters["robustness"]["samplers"])
    assert set(explored["sets"]) == {samplers}
    assert set(explored["set_size"]) == {0}
    # one posterior costs what both halves of an exploration look at
    assert (explored["trajectories"] >= 2 * parameters["explore"]["evaluations"]).all()
    summary = table(compared, "regimes_summary")
    assert summary.filter(regime="with-optima", demonstrations="single").height == 2 * rows.filter(
        regime="with-optima"
    )["set_size"].n_unique()  # fmt: skip
    planned = summary.filter(regime="with-optima", model="less", demonstrations="single")["value"]
    plain = summary.filter(regime="sampler-shift", model="less", demonstrations="single")["value"]
    assert planned.mean() < plain.mean()  # the sets share regions of feature space now
    calibration = table(compared, "regimes_calibration")
    assert set(calibration["choices"]) == {1, 3}
    assert set(calibration["true_beta"]) == set(parameters["infer"]["betas"])
    assert calibration.filter(regime="explored-space")["sets"].to_list() == [samplers] * 2 * 2 * len(
        parameters["infer"]["betas"]
    )  # fmt: skip
    held_out = table(compared, "regimes_held_out")
    assert set(held_out["draws"]) == {samplers}
    assert set(held_out["model"]) == {"less"}


def test_the_same_again_gives_the_same_bytes(compared: Project) -> None:
    paths = [compared.table("sweep", name) for name in stage("regimes").makes]
    before = [path.read_bytes() for path in paths]
    regimes.run(compared, "sweep")
    assert [path.read_bytes() for path in paths] == before


def test_a_space_that_cannot_be_explored_is_refused(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["explore"]["explorations"] = 0
    project = make_project(parameters)
    for one in CHAIN:
        one.run(project, "sweep")
    with pytest.raises(StageError, match="explorations is 0"):
        regimes.run(project, "sweep")
    assert not project.table("sweep", "regimes").exists()
