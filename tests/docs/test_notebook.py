"""docs/notebook.ipynb runs from first cell to last and says what SQL says."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from polars.testing import assert_frame_equal

from pipeline.formats.duckdb.questions import ask
from pipeline.stages import catalog, density, featurize, infer, ingest, sample
from pipeline.workspace.project import Project
from pipeline.workspace.provenance import content_hash

NOTEBOOK = json.loads((Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb").read_text(encoding="utf-8"))
CODE = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def test_it_keeps_no_outputs() -> None:
    assert NOTEBOOK["nbformat"] == 4
    assert all(cell["outputs"] == [] for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code")


def test_it_says_what_sql_says(
    make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters["sample"]["sampler"] = "deformation"
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, infer):
        stage.run(project, "sweep")
    catalog.run(project)
    monkeypatch.chdir(project.root)
    names: dict[str, Any] = {}
    for code in CODE:
        exec(compile(code, "docs/notebook.ipynb", "exec"), names)

    question = (
        "select * exclude (shown) from best_hypothesis where participant = 'all' and set_id = 'working' "
        "order by task, model"
    )
    assert_frame_equal(names["together"], ask(project.catalog, question), check_column_order=False, check_dtypes=False)
    question = f"select {', '.join(names['lead'].columns)} from model_comparison order by task, model"
    assert_frame_equal(names["lead"], ask(project.catalog, question))
    question = "select task, model, set_size, answers, sets from disagreement_between_sets where participant = 'all'"
    assert_frame_equal(
        names["answers"], ask(project.catalog, f"{question} order by task, model, set_size"), check_dtypes=False
    )
    files = sorted((project.root / "mine").glob("*.mcap"))
    assert names["recordings"] == {f"mine/{file.name}": content_hash(file) for file in files}
