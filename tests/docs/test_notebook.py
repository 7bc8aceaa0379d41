"""docs/notebook.ipynb runs from first cell to last and says what SQL says."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from polars.testing import assert_frame_equal

from pipeline.formats.duckdb.questions import ask
from pipeline.stages import answer, catalog, density, explore, featurize, infer, ingest, robustness, sample, shift
from pipeline.workspace.project import Project
from pipeline.workspace.provenance import content_hash

MAKE = runpy.run_path(str(Path(__file__).resolve().parents[2] / "docs" / "make_notebook.py"))
NOTEBOOK = json.loads((Path(__file__).resolve().parents[2] / "docs" / "notebook.ipynb").read_text(encoding="utf-8"))
CODE = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def test_it_keeps_what_its_cells_show() -> None:
    assert NOTEBOOK["nbformat"] == 4
    shown = [output["data"] for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code" for output in cell["outputs"]]
    assert len(shown) == len(CODE)
    assert sum("image/png" in data for data in shown) == 2
    assert len(json.dumps(NOTEBOOK)) < 200_000


def test_another_text_is_found() -> None:
    changed = json.loads(json.dumps(NOTEBOOK))
    (output,) = changed["cells"][3]["outputs"]
    output["data"]["text/plain"][0] += "x"
    assert MAKE["texts"](changed) != MAKE["texts"](NOTEBOOK)


def test_it_says_what_sql_says(
    make_project: Callable[[dict[str, Any]], Project], parameters: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters["sample"]["sampler"] = "deformation"
    project = make_project(parameters)
    for stage in (ingest, sample, featurize, density, infer, explore, shift, robustness, answer):
        stage.run(project, "sweep")
    catalog.run(project)
    monkeypatch.chdir(project.root)
    names = MAKE["run"](json.loads(json.dumps(NOTEBOOK)))

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
    question = "select statement from answers where kind = 'answer'"
    assert names["said"]["statement"].to_list() == ask(project.catalog, question)["statement"].to_list()
    for table in ("weights", "predictions"):
        kind, quantity = ("group", "and quantity = 'weight'") if table == "weights" else ("next", "")
        question = (
            f"select {', '.join(names[table].columns)} from {'weights_summary' if table == 'weights' else table} "
            f"where participant = 'all' and model = 'less' and kind = '{kind}' {quantity} order by task, feature"
        )
        assert_frame_equal(names[table], ask(project.catalog, question))
    files = sorted((project.root / "mine").glob("*.mcap"))
    assert names["recordings"] == {f"mine/{file.name}": content_hash(file) for file in files}
