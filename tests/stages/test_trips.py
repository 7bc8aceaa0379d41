"""The stage `trips` on a small network: its tables, its figures and its page."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from pipeline.commands import import_trips
from pipeline.errors import StageError
from pipeline.stages import trips
from pipeline.stages.registry import stage
from pipeline.studies.trips import choices
from pipeline.studies.trips.path_models import BY_SET, MODELS
from pipeline.studies.trips.roads import Roads
from pipeline.studies.trips.study import TripsStudy, run_trips
from pipeline.vocabulary import STUDIES
from pipeline.workspace.project import Project
from tests.support.small_roads import write_small_roads

Make = Callable[[dict[str, Any]], Project]


def test_from_four_files_to_the_page(
    make_project: Make, parameters: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def few(roads: Roads, seed: int, tracked: Any) -> TripsStudy:
        return run_trips(roads, seed, {6: 2, 3: 1}, tracked)

    monkeypatch.setattr(trips, "run_trips", few)
    project = make_project(parameters)
    import_trips.run(project, write_small_roads(tmp_path / "roads"))

    trips.run(project)

    tables = {name: pl.read_parquet(project.table(STUDIES, name)) for name in stage("trips").makes}
    estimates, scores = tables["trips_estimates"], tables["trips_scores"]
    assert estimates.height == len(BY_SET) * 3 * 3  # three samplers, two samplings of six draws and one of three
    nested = estimates.filter(pl.col("model").str.starts_with("nested-logit"))
    assert nested["own"].is_between(0.05, 1).all()
    assert nested["log_likelihood_all_paths"].null_count() == nested.height
    one, two = scores.filter(set_size=3), scores.filter(set_size=6)
    assert one["log_predictive_error_samplings"].null_count() == one.height
    assert two["log_predictive_error_samplings"].null_count() == 0
    assert (scores["difference_lower"] <= scores["difference"]).all()
    assert (scores["difference"] <= scores["difference_upper"]).all()

    page = (project.root / "datasets/trips.html").read_text()
    assert page.count("<svg") + page.count("data:image") == 3
    assert all(page.count(f">{escape(name)}<") >= 3 for name in MODELS.values())
    assert "Sets of 6 draws of fast: better than corrected Boltzmann are" in page
    assert f"{tables['trips_exact']['log_likelihood'][0]:.4f} at the estimates" in page
    figures = {path.name for path in (project.root / "datasets/studies/trips_figures").iterdir()}
    assert figures == {f"{name}.{kind}" for name in ("routes", "samplers", "scores") for kind in ("pdf", "png", "svg")}


def test_a_process_that_is_ended_from_outside_is_named_in_a_sentence(
    make_project: Make, parameters: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the system ends one when memory is short."""
    project = make_project(parameters)
    import_trips.run(project, write_small_roads(tmp_path / "roads"))
    monkeypatch.setattr(choices, "_FEW", 0)
    monkeypatch.setattr(choices, "_parts", _ended)
    with pytest.raises(StageError, match="ended from outside, most often for lack of memory; close other programs"):
        trips.run(project)
    assert not (project.root / "datasets/trips.html").exists()


def _ended(*_: Any) -> None:
    assert multiprocessing.parent_process() is not None  # never the process of the tests
    os.kill(os.getpid(), signal.SIGKILL)
