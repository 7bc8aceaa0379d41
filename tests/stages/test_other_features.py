"""Tables that were made with other features than params.yaml has now: what cannot be told apart is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import StageError
from pipeline.formats.parquet.tables import read_table
from pipeline.params import parse
from pipeline.stages import density, featurize, infer, ingest, robustness, sample, shift
from pipeline.workspace.project import Project

Make = Callable[[dict[str, Any]], Project]


def with_features(root: Path, parameters: dict[str, Any], names: tuple[str, ...], thetas: Any) -> Project:
    """The project with the same features in another order, or fewer of them."""
    features = {name: parameters["tasks"]["sweep"]["features"][name] for name in names}
    task = parameters["tasks"]["sweep"] | {"features": features, "thetas": thetas}
    project = Project(root)
    project.__dict__["params"] = parse(parameters | {"tasks": {"sweep": task}})
    return project


@pytest.fixture
def root(make_project: Make, parameters: dict[str, Any]) -> Path:
    """A project whose features, `effort` and `vase`, have their densities."""
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, shift):
        stage.run(project, "sweep")
    return project.root


def test_weights_of_features_in_another_order_are_refused(root: Path, parameters: dict[str, Any]) -> None:
    thetas = [[-1.0, 0.0], [0.0, -1.0]]
    infer.run(with_features(root, parameters, ("effort", "vase"), thetas), "sweep")
    turned = with_features(root, parameters, ("vase", "effort"), thetas)
    for stage in (infer, robustness):
        with pytest.raises(
            StageError, match=r"have the features effort, vase in this order and params\.yaml has vase, effort"
        ):
            stage.run(turned, "sweep")


def test_a_grid_has_a_weight_for_each_feature_of_the_tables(root: Path, parameters: dict[str, Any]) -> None:
    for order in (("effort", "vase"), ("vase", "effort")):
        project = with_features(root, parameters, order, "grid")
        infer.run(project, "sweep")
        posteriors = read_table(project.table("sweep", "posteriors"), "posteriors")
        assert posteriors["theta"].to_numpy().shape[1] == 2
        robustness.run(project, "sweep")
        found = read_table(project.table("sweep", "robustness"), "robustness")
        if order == ("effort", "vase"):
            before = posteriors, found
        assert posteriors.equals(before[0])
        assert found.equals(before[1])


def test_the_robustness_of_other_features_is_not_computed(root: Path, parameters: dict[str, Any]) -> None:
    with pytest.raises(
        StageError, match=r"scales\.parquet: has features other than tasks\.sweep\.features; run `dvc repro`"
    ):
        robustness.run(with_features(root, parameters, ("vase",), "grid"), "sweep")
