"""Run docs/notebook.ipynb on what `make repro` computed, and keep what its cells show: `python docs/make_notebook.py`.

With `--check` nothing is written: exit status 1 if a cell shows another text than is kept.
"""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import polars as pl

mpl.use("agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "notebook.ipynb"


def main() -> None:
    """Run the cells in the project's folder, and write or compare."""
    os.chdir(ROOT)
    notebook = json.loads(PAGE.read_text(encoding="utf-8"))
    before = texts(notebook)
    run(notebook)
    if "--check" not in sys.argv:
        PAGE.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    elif texts(notebook) != before:
        sys.exit("docs/notebook.ipynb shows other answers than its cells give; run `python docs/make_notebook.py`")


def run(notebook: dict[str, Any]) -> dict[str, Any]:
    """Run every code cell and put what it shows into the notebook: its last value, and figures.

    Returns:
        the names that the cells define.
    """
    names: dict[str, Any] = {}
    with pl.Config(tbl_rows=20, fmt_str_lengths=70, tbl_width_chars=170, tbl_cols=12):
        for number, cell in enumerate(cell for cell in notebook["cells"] if cell["cell_type"] == "code"):
            cell["execution_count"] = number + 1
            cell["outputs"] = _shown("".join(cell["source"]), names, number + 1)
    return names


def _shown(code: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "docs/notebook.ipynb", "exec"), names)
    value = eval(compile(ast.Expression(last.value), "docs/notebook.ipynb", "eval"), names) if last else None
    outputs = []
    for figure in map(plt.figure, plt.get_fignums()):
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=80, metadata={"Software": None})
        picture = {"image/png": base64.b64encode(stream.getvalue()).decode(), "text/plain": ["<a figure>"]}
        outputs.append({"output_type": "display_data", "data": picture, "metadata": {}})
    plt.close("all")
    if value is not None and not outputs:
        data = {"text/plain": str(value).splitlines(keepends=True)}
        shown = {"output_type": "execute_result", "execution_count": number, "data": data, "metadata": {}}
        outputs.append(shown)
    return outputs


def texts(notebook: dict[str, Any]) -> list[list[str]]:
    """What the code cells show, without pictures."""
    return [
        ["".join(output["data"]["text/plain"]) for output in cell["outputs"]]
        for cell in notebook["cells"]
        if cell["cell_type"] == "code"
    ]


if __name__ == "__main__":
    main()
