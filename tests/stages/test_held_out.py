"""Held-out scores of the chain against a slow loop, and the comparison of models in the catalog."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.formats.duckdb.questions import ask
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import catalog, density, featurize, infer, ingest, sample
from pipeline.views.intervals import compare_models
from pipeline.workspace.project import Project
from tests.oracles import slow_choice

Make = Callable[[dict[str, Any]], Project]
NAMES = ["effort", "vase"]
WEIGHTS = {"boltzmann": lambda _: slow_choice.boltzmann, "less": slow_choice.less}


@pytest.fixture
def parameters(parameters: dict[str, Any]) -> dict[str, Any]:
    parameters["sample"] |= {"sampler": "deformation", "sets": 1, "sizes": [5], "working_set": 12}
    return parameters


def run_chain(project: Project) -> None:
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")


def table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table("sweep", name), name)


def slow_scores(project: Project, model: str, set_size: int, set_id: str) -> list[float]:
    """From the features on, every sum a loop."""
    features, scales = table(project, "features"), table(project, "scales")["scale"].to_numpy()
    chosen = {"set_size": set_size, "set_id": set_id}
    hypotheses = table(project, "posteriors").unique("theta_id").sort("theta_id")["theta"].to_list()
    likelihoods = []
    for demonstration in features.filter(kind="demonstration").iter_rows(named=True):
        bandwidths = table(project, "densities").filter(**chosen)
        pool = features.filter(kind="alternative", **chosen)
        anchor = demonstration["id"] if demonstration["id"] in pool["anchor"] else "task"
        sigma = bandwidths.filter(anchor=anchor)["bandwidth"][0]
        alternatives = (pool.filter(anchor=anchor).select(NAMES).to_numpy() / scales).tolist()
        phi = [demonstration[name] / scale for name, scale in zip(NAMES, scales, strict=True)]
        weights = WEIGHTS[model](sigma)
        likelihoods.append(
            [
                [slow_choice.log_likelihood(weights, phi, alternatives, theta, beta) for beta in (0.3, 3, 30)]
                for theta in hypotheses
            ]
        )
    return slow_choice.held_out(likelihoods, [[0.0] * 3 for _ in hypotheses])


@pytest.mark.parametrize("anchor", ["task", "demonstration"])
def test_equals_the_slow_loop(make_project: Make, parameters: dict[str, Any], anchor: str) -> None:
    parameters["tasks"]["sweep"]["anchor"] = anchor
    project = make_project(parameters)
    run_chain(project)
    held_out = table(project, "held_out")
    assert held_out.height == 3 * 2 * 2
    for (model, set_size, set_id), rows in held_out.group_by("model", "set_size", "set_id"):
        assert rows["demonstration_id"].to_list() == ["demo-0", "demo-1", "demo-2"]
        assert rows["participant"].to_list() == ["person-0", "person-1", "person-2"]
        np.testing.assert_allclose(rows["log_predictive"], slow_scores(project, model, set_size, set_id), rtol=1e-10)


def test_the_catalog_compares_models_pair_by_pair(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["infer"]["models"] = ["less", "attribute-rule", "boltzmann"]
    project = make_project(parameters)
    run_chain(project)
    catalog.run(project)
    answer = ask(project.catalog, "from model_comparison order by model")
    assert answer["model"].to_list() == ["attribute-rule", "boltzmann", "less"]
    assert answer.select("task", "set_size", "demonstrations").unique().rows() == [("sweep", 12, 3)]
    working = {
        model: table(project, "held_out").filter(model=model, set_id="working")["log_predictive"].to_list()
        for model in answer["model"]
    }
    for row in answer.iter_rows(named=True):
        own = working[row["model"]]
        gain = [a - b for a, b in zip(own, working["boltzmann"], strict=True)]
        assert row["total"] == pytest.approx(math.fsum(own), rel=1e-12)
        assert row["mean"] == pytest.approx(math.fsum(own) / 3, rel=1e-12)
        assert row["standard_error"] == pytest.approx(statistics.stdev(own) / math.sqrt(3), rel=1e-9)
        assert row["difference"] == pytest.approx(math.fsum(gain) / 3, rel=1e-9, abs=1e-12)
        assert row["difference_standard_error"] == pytest.approx(statistics.stdev(gain) / math.sqrt(3), rel=1e-9)
    assert answer.filter(model="less")["difference"].item() != 0
    assert_the_figure_says_the_same(project, answer)


def assert_the_figure_says_the_same(project: Project, answer: pl.DataFrame) -> None:
    shown = compare_models(table(project, "held_out").filter(set_id="working")).sort("model")
    assert_frame_equal(answer.select(shown.columns), shown, rel_tol=1e-12, abs_tol=1e-12)


def test_without_boltzmann_there_is_no_difference(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["infer"]["models"] = ["less"]
    project = make_project(parameters)
    run_chain(project)
    catalog.run(project)
    answer = ask(project.catalog, "from model_comparison")
    assert_the_figure_says_the_same(project, answer)
    row = answer.row(0, named=True)
    assert row["mean"] < 0
    assert row["difference"] is None
    assert row["difference_standard_error"] is None


def test_one_demonstration_has_no_others(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    for number in (1, 2):
        (project.root / "mine" / f"demo-{number}.mcap").unlink()
    run_chain(project)
    catalog.run(project)
    assert table(project, "held_out").is_empty()
    assert table(project, "posteriors").height > 0
    assert ask(project.catalog, "from model_comparison").is_empty()


def test_a_view_needs_its_table(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    run_chain(project)
    project.table("sweep", "held_out").unlink()
    catalog.run(project)
    views = ask(project.catalog, "select view_name from duckdb_views() where not internal order by all")
    assert "best_hypothesis" in views["view_name"]
    assert "model_comparison" not in views["view_name"]
