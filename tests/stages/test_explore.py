"""The stage `explore`: its tables fit together, depend on nothing but their inputs, and say what is not explored."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.commands.watch.session import Until, run
from pipeline.formats.duckdb.questions import ask
from pipeline.formats.parquet.tables import read_table
from pipeline.formats.parquet.task_tables import TaskTables
from pipeline.stages import catalog, density, explore, featurize, infer, ingest, sample
from pipeline.stages.registry import stage
from pipeline.views.task_view import EXPLORED, INPUTS, task_view
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]
CHAIN = (ingest, sample, featurize, density, infer, explore)
MADE = stage("explore").makes
SIX = {
    "effort": {"kind": "efficiency"},
    "vase": {"kind": "proximity", "object": "vase", "radius_m": 0.5},
    "length": {"kind": "path_length"},
    "lift": {"kind": "height"},
    "limits": {"kind": "limit_nearness"},
    "speed": {"kind": "speed"},
}


def run_chain(project: Project) -> None:
    for one in CHAIN:
        one.run(project, "sweep")


def table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table("sweep", name), name)


@pytest.fixture
def project(make_project: Make, parameters: dict[str, Any]) -> Project:
    made = make_project(parameters)
    run_chain(made)
    return made


def test_six_features_are_explored_until_explorations_agree(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["features"] = SIX
    parameters["explore"] |= {"evaluations": 20_000, "most_evaluations": 160_000, "tolerance": 0.1}
    project = make_project(parameters)
    run_chain(project)
    space = table(project, "choice_space").row(0, named=True)
    assert space["explored"]
    settled = table(project, "convergence")
    last = settled.filter(pl.col("round") == pl.col("round").max().over("model"))
    assert last["converged"].all()
    assert last.filter(model="less")["growth"].max() < 0.5  # the map is not all new cells, as one too fine would be


def test_tables_of_one_run_fit_together(project: Project) -> None:
    space = table(project, "choice_space").row(0, named=True)
    assert (space["explored"], space["reason"], space["effort_from"]) == (True, None, "demonstrations")
    posteriors = table(project, "explored_posteriors")
    totals = posteriors.group_by("demonstration_id", "participant", "model", "exploration").agg(pl.sum("posterior"))
    assert totals.height == 4 * 2 * 3  # three people and all together, two models, two explorations and their mean
    np.testing.assert_allclose(totals["posterior"], 1, atol=1e-9)
    wide = posteriors.pivot("exploration", index=["demonstration_id", "model", "theta_id", "beta"], values="posterior")
    np.testing.assert_allclose(wide["pooled"], (wide["00"] + wide["01"]) / 2, rtol=1e-9)

    settled = table(project, "convergence")
    last = settled.filter(pl.col("round") == pl.col("round").max().over("model"))
    assert last.group_by("model").len().sort("model").rows() == [("boltzmann", 4), ("less", 4)]
    marginal = posteriors.group_by("demonstration_id", "model", "exploration", "theta_id").agg(pl.sum("posterior"))
    for row in last.iter_rows(named=True):
        mine = marginal.filter(demonstration_id=row["demonstration_id"], model=row["model"]).sort("theta_id")
        p, q = (mine.filter(exploration=one)["posterior"].to_numpy() for one in ("00", "01"))
        apart = ((p - q) * (np.log(p) - np.log(q))).sum() / 2  # the mean of both directions
        assert row["disagreement"] == pytest.approx(apart, abs=1e-9)
        assert row["probability"] == pytest.approx(max((p + q) / 2), abs=1e-9)


def test_a_posterior_is_that_of_a_slow_sum_over_the_rows(project: Project) -> None:
    scales = table(project, "scales")["scale"].to_numpy()
    features = table(project, "features").filter(kind="demonstration").sort("id").select("effort", "vase").to_numpy()
    rows = table(project, "explored")
    for model in ("less", "boltzmann"):
        mine = rows.filter(model=model, exploration="01")
        phi, log_w = mine["features"].to_numpy(), mine["log_weight"].to_numpy()
        found = (
            table(project, "explored_posteriors")
            .filter(model=model, exploration="01", demonstration_id="all")
            .sort("theta_id", "beta")
        )
        expected = []
        for theta, beta in zip(found["theta"].to_numpy(), found["beta"], strict=True):
            log_z = np.log(np.exp(beta * phi @ theta + log_w).sum())
            expected.append(sum(beta * (one / scales) @ theta - log_z for one in features))
        expected = np.exp(np.array(expected) - max(expected))
        np.testing.assert_allclose(found["posterior"], expected / expected.sum(), atol=1e-9)


def test_paths_of_the_map_have_its_features_and_keep_to_the_bound(project: Project) -> None:
    rows, space = table(project, "explored"), table(project, "choice_space").row(0, named=True)
    assert rows.filter(model="boltzmann")["waypoints"].null_count() == rows.filter(model="boltzmann").height
    mine = rows.filter(model="less")
    paths = mine["waypoints"].to_numpy().astype(float)
    effort = (np.diff(paths, axis=1) ** 2).sum(axis=(1, 2))
    scale = table(project, "scales").filter(feature="effort")["scale"][0]
    np.testing.assert_allclose(mine["features"].to_numpy()[:, 0] * scale, effort, rtol=1e-5)
    assert effort.max() <= space["effort_multiple"] * space["least_effort"] * (1 + 1e-5)
    np.testing.assert_allclose(paths[:, 0], np.tile(space["start"], (len(paths), 1)), atol=1e-6)


def test_equal_inputs_give_equal_bytes_on_any_number_of_cores(
    project: Project, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {name: project.table("sweep", name).read_bytes() for name in MADE}
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    explore.run(project, "sweep")
    assert {name: project.table("sweep", name).read_bytes() for name in MADE} == before


def test_what_is_shown_is_the_explored_answer(project: Project) -> None:
    with TaskTables(project.tables("sweep", INPUTS)) as tables:
        view = task_view(tables, project.table("sweep", "explored_posteriors"))
    assert view.over == f"over the {EXPLORED}"
    pooled = (
        table(project, "explored_posteriors")
        .filter(exploration="pooled", model="less", demonstration_id="all")
        .sort("theta_id", "beta")
    )
    np.testing.assert_allclose(np.exp(view.beliefs["less"][-1].log_probability).ravel(), pooled["posterior"], atol=1e-9)
    catalog.run(project)
    shown = ask(project.catalog, "from best_hypothesis where shown and participant = 'all' order by model")
    assert shown.select("model", "set_size", "set_id").rows() == [("boltzmann", 0, "explored"), ("less", 0, "explored")]
    assert shown["posterior"][1] == pytest.approx(pooled["posterior"].max())
    sampled = ask(project.catalog, "from best_hypothesis where set_id = 'working' and shown")
    assert sampled.height == 0


@pytest.mark.parametrize(
    ("task", "settings", "why"),
    [
        ({"anchor": "demonstration"}, {}, "each demonstration has its own ends"),
        ({"collisions": True}, {}, "contacts are too slow"),
        ({"features": {**SIX, "jerk": {"kind": "jerk"}}}, {}, "the task has 7 features"),
        ({}, {"explorations": 0}, "explore.explorations is 0"),
        ({}, {"width_rad": 50.0}, "make the width smaller or the bound larger"),
    ],
)
def test_what_is_not_explored_is_said_in_the_table_and_on_the_terminal(
    make_project: Make,
    parameters: dict[str, Any],
    capsys: pytest.CaptureFixture[str],
    task: dict[str, Any],
    settings: dict[str, Any],
    why: str,
) -> None:
    parameters["tasks"]["sweep"] |= task
    parameters["explore"] |= settings
    parameters["sample"] |= {"sampler": "deformation", "sets": 1}
    project = make_project(parameters)
    run_chain(project)
    spaces = table(project, "choice_space")
    assert not spaces["explored"].any()
    assert all(why in reason for reason in spaces["reason"])
    assert why in capsys.readouterr().err
    assert [table(project, name).height for name in MADE[1:]] == [0, 0, 0]
    catalog.run(project)
    shown = ask(project.catalog, "from best_hypothesis where shown and participant = 'all'")
    assert shown["set_id"].to_list() == ["working", "working"]
    with TaskTables(project.tables("sweep", INPUTS)) as tables:
        assert "set of 30" in task_view(tables, project.table("sweep", "explored_posteriors")).over


def test_a_project_without_the_section_has_its_defaults(make_project: Make, parameters: dict[str, Any]) -> None:
    del parameters["explore"]
    params = make_project(parameters).params
    assert (params.explore.explorations, params.explore.evaluations) == (2, 250_000)
    from pipeline.stages.dvc_yaml import dvc_yaml

    listed = dvc_yaml(params).split("  explore:\n")[1].split("deps:")[0]
    assert "infer.betas]" in listed


def test_watching_gives_the_posteriors_of_the_stage(project: Project) -> None:
    run(project, None, "sweep", Until(demonstrations=3), None)
    watched = read_table(project.datasets / "sweep" / "watch" / "explored_posteriors.parquet", "explored_posteriors")
    made = table(project, "explored_posteriors")
    keys = ["demonstration_id", "participant", "model", "exploration", "theta_id", "beta"]
    both = made.join(watched, on=keys, how="full", coalesce=True)
    assert both.height == made.height == watched.height
    np.testing.assert_allclose(both["posterior"], both["posterior_right"], atol=1e-9)
