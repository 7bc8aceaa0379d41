"""The smallest projects that make sense go through every stage: a result, or one sentence that says what is missing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.stages import (
    catalog,
    density,
    featurize,
    figures,
    infer,
    ingest,
    inspect,
    report,
    robustness,
    sample,
    scene,
    shift,
)
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]
EVERY = (scene, ingest, sample, featurize, density, infer, shift, robustness, figures, inspect)


def run_all(project: Project) -> None:
    for stage in EVERY:
        stage.run(project, "sweep")
    catalog.run(project)
    report.run(project)


def keep(project: Project, people: int) -> None:
    for number in range(people, 3):
        (project.root / "mine" / f"demo-{number}.mcap").unlink()


@pytest.mark.parametrize("people", [1, 2])
def test_few_participants(make_project: Make, parameters: dict[str, Any], people: int) -> None:
    parameters["sample"]["sizes"] = [5, 10, 20]  # two participants and more than two sizes
    project = make_project(parameters)
    keep(project, people)
    run_all(project)
    tests = read_table(project.table("sweep", "robustness_anova"), "robustness_anova")
    assert tests.is_empty() == (people == 1)
    assert (tests["df_error"] >= 1).all()


@pytest.mark.parametrize(
    ("features", "thetas"),
    [
        ({"effort": {"kind": "efficiency"}}, "grid"),
        ({"effort": {"kind": "efficiency"}, "lift": {"kind": "height"}}, [[-1.0, 0.5]]),
    ],
    ids=["one feature", "one theta"],
)
def test_one_hypothesis(make_project: Make, parameters: dict[str, Any], features: dict[str, Any], thetas: Any) -> None:
    parameters["tasks"]["sweep"] |= {"features": features, "thetas": thetas}
    project = make_project(parameters)
    run_all(project)
    spread = read_table(project.table("sweep", "robustness"), "robustness")
    assert spread["kl_aggregate"].abs().max() < 1e-12  # of one hypothesis all posteriors are the same
    assert sorted(path.name for path in project.figures("sweep").glob("robustness.*")) == [
        "robustness.pdf", "robustness.png", "robustness.svg", "robustness.txt",
    ]  # fmt: skip


def test_one_set_of_each_size_cannot_be_compared(make_project: Make, parameters: dict[str, Any]) -> None:
    parameters["sample"]["sets"] = 1
    project = make_project(parameters)
    for stage in EVERY[: EVERY.index(robustness)]:
        stage.run(project, "sweep")
    with pytest.raises(StageError, match=r"sample\.sets to 2 or more"):
        robustness.run(project, "sweep")
    figures.run(project, "sweep")  # those that do not need the study
    inspect.run(project, "sweep")
