"""The stage that answers: its tables on a small project, the lines that it prints, and what does not change them."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.answers.tables import answer_lines, group_of
from pipeline.commands import answer as command
from pipeline.commands import plan
from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import answer, density, explore, featurize, ingest, sample
from pipeline.stages.registry import stage
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]


def answered(make_project: Make, parameters: dict[str, Any]) -> Project:
    parameters["sample"] |= {"sampler": "deformation", "sizes": [5]}
    project = make_project(parameters)
    for one in (ingest, sample, featurize, density, answer):
        one.run(project, "sweep")
    return project


def table(project: Project, name: str) -> pl.DataFrame:
    return read_table(project.table("sweep", name), name)


def test_one_answer_with_its_weights_and_predictions(
    make_project: Make, parameters: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    project = answered(make_project, parameters)
    rows = table(project, "answers")
    lines = answer_lines(rows)
    assert len(lines) <= 10
    assert lines[0].startswith("sweep: ")
    assert lines[0].endswith("(from 30 sampled alternatives)")
    assert rows["trust"][0] == "do not trust"  # of 30 alternatives
    assert rows.filter(line="samplers")["outcome"].item() == "not checked"
    assert rows.filter(line="ends")["number"].item() < 0.1

    weights, summary = table(project, "weights"), table(project, "weights_summary")
    for (_, _, _), mine in weights.group_by("model", "kind", "participant"):
        np.testing.assert_allclose(np.exp(mine["log_weight"].to_numpy()).sum(), 1, atol=1e-9)
    group = group_of(weights.filter(model="less"))
    said = summary.filter(model="less", kind="group", quantity="weight")["mean"].to_numpy()
    np.testing.assert_allclose(group.mean, said, atol=1e-12)
    assert summary.filter(kind="alone")["participant"].n_unique() == 3

    features = table(project, "features").filter(set_id="working")["effort"].to_numpy()
    predicted = table(project, "predictions").filter(feature="effort")
    assert predicted.height == 2 * (1 + 3)
    assert (predicted["low"] >= features.min()).all()
    assert (predicted["high"] <= features.max()).all()
    assert (predicted["low"] <= predicted["median"]).all()
    motion = table(project, "predicted_motion").filter(model="less", kind="next").sort("waypoint")
    np.testing.assert_allclose(motion["low"][0].to_numpy(), motion["high"][0].to_numpy(), atol=1e-6)  # all start there
    assert table(project, "likely_paths")["probability"].is_between(0, 1).all()
    assert table(project, "predictive_checks").height == 2 * 3 * 2

    capsys.readouterr()
    command.run(project, None, as_json=False)
    assert capsys.readouterr().out.splitlines() == lines
    command.run(project, "sweep", as_json=True)
    found = json.loads(capsys.readouterr().out)["sweep"]
    assert f"sweep: {found['answer']}" == lines[0]
    assert {check["line"] for check in found["checks"]} >= {"samplers", "truth", "coverage"}


def test_the_same_again_whatever_recordings_are_called(make_project: Make, parameters: dict[str, Any]) -> None:
    project = answered(make_project, parameters)
    before = {name: project.table("sweep", name).read_bytes() for name in stage("answer").makes}
    answer.run(project, "sweep")
    assert {name: project.table("sweep", name).read_bytes() for name in before} == before
    said = table(project, "answers")
    folder = project.root / "mine"
    for old, new in (("demo-0", "z"), ("demo-2", "a")):
        (folder / f"{old}.mcap").rename(folder / f"{new}.mcap")
    for one in (ingest, sample, featurize, density, answer):
        one.run(project, "sweep")
    assert table(project, "answers").equals(said)


def test_each_demonstration_may_have_alternatives_of_its_own(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["tasks"]["sweep"]["anchor"] = "demonstration"
    project = answered(make_project, parameters)
    rows = table(project, "answers")
    assert rows.filter(line="coverage")["outcome"].item() == "not checked"
    assert rows.filter(line="surprise")["number"].item() is not None
    assert set(table(project, "predictions")["kind"]) == {"person"}


def test_no_answer_yet(make_project: Make, parameters: dict[str, Any]) -> None:
    project = make_project(parameters)
    with pytest.raises(StageError, match="no task has an answer yet"):
        command.run(project, None, as_json=False)
    with pytest.raises(StageError, match="lessbench conclude sweep"):
        command.run(project, "sweep", as_json=False)


def test_the_answer_is_said_after_inference_if_it_rests_on_the_same_tables(
    make_project: Make, parameters: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    project = answered(make_project, parameters)
    lines = answer_lines(table(project, "answers"))
    capsys.readouterr()
    command.after_inference(project, "sweep")
    assert capsys.readouterr().out.splitlines() == lines

    parameters["sample"]["working_set"] += 1
    for one in (sample, featurize, density):
        one.run(make_project(parameters), "sweep")
    capsys.readouterr()
    command.after_inference(project, "sweep")
    out, err = capsys.readouterr()
    assert out == ""
    assert "lessbench conclude sweep" in err

    project.table("sweep", "answers").unlink()
    command.after_inference(project, "sweep")
    assert "lessbench conclude sweep" in capsys.readouterr().err


def test_over_an_explored_space(make_project: Make, parameters: dict[str, Any]) -> None:
    """People chose from the space: its trajectories are predicted, no sampler is asked, sampled sets do not matter."""
    project = answered(make_project, parameters)
    explore.run(project, "sweep")
    answer.run(project, "sweep")
    rows = table(project, "answers")
    assert "samplers" not in set(rows["line"])
    assert "sampled" not in rows["statement"][0]
    assert rows.filter(line="unsettled")["number"].item() >= 0
    assert rows.filter(line="explorations")["outcome"].item() != "not checked"

    likely, space = table(project, "likely_paths"), table(project, "explored").filter(model="less")
    known = {tuple(path) for path in space["waypoints"].to_numpy().reshape(space.height, -1)}
    shown = likely["waypoints"].to_numpy()
    assert {tuple(path) for path in shown.reshape(len(shown), -1)} <= known
    assert set(likely["model"]) == {"less", "boltzmann"}
    covered = space["features"].to_numpy()[:, 0] * table(project, "scales")["scale"][0]
    predicted = table(project, "predictions").filter(feature="effort")
    assert predicted["low"].min() >= covered.min()
    assert predicted["high"].max() <= covered.max()

    assert table(project, "weights").filter(model="less", kind="group").height >= 100


def test_a_space_that_was_explored_for_something_else_is_refused(
    make_project: Make, parameters: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    project = answered(make_project, parameters)
    capsys.readouterr()
    command.after_inference(project, "sweep")
    assert capsys.readouterr().out
    explore.run(project, "sweep")
    capsys.readouterr()
    command.after_inference(project, "sweep")  # the answer does not know of the space
    assert capsys.readouterr().out == ""

    parameters["tasks"]["sweep"]["features"]["vase"]["radius_m"] = 0.3
    changed = make_project(parameters)
    for one in (featurize, density):
        one.run(changed, "sweep")
    for run in (answer.run, lambda at, name: plan.run(at, name, plan.Wanted(None, "less", contacts=False))):
        with pytest.raises(StageError, match=r"explored for other features.*lessbench explore sweep"):
            run(changed, "sweep")
    changed.table("sweep", "explored").unlink()
    with pytest.raises(StageError, match="other tables are missing; run `lessbench explore sweep`"):
        answer.run(changed, "sweep")
