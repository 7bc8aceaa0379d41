"""Write the way of the data into ARCHITECTURE.md, from the registry of stages: `python docs/make_architecture.py`."""

from __future__ import annotations

import textwrap
from itertools import groupby, zip_longest
from pathlib import Path

from pipeline.stages.registry import STAGES, Scope, Stage

PAGE = Path(__file__).resolve().parents[1] / "ARCHITECTURE.md"
BEGIN, END = "<!-- written by docs/make_architecture.py -->\n", "<!-- until here -->\n"
WIDTHS = (16, 47, 56)  # of the columns


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


def page(text: str) -> str:
    """The page with the way of the data as it is now."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}```text\n{way()}```\n{END}{after}"


def way() -> str:
    """What each stage reads and makes, in the order in which stages run."""
    lines = [_line(("stage", "reads", "makes"))]
    for title, stages in groupby(STAGES, _title):
        lines.append(f"{title}:")
        for stage in stages:
            lines += _rows(stage)
    return "\n".join(lines) + "\n"


def _title(stage: Stage) -> str:
    return str(Scope.TASK.value if stage.per_task else stage.scope.value)


def _rows(stage: Stage) -> list[str]:
    named = [path.rpartition(".")[2] for path in stage.named]
    inputs = [path.format(task="TASK") if stage.scope is Scope.PROJECT else _short(path) for path in stage.inputs]
    reads = [*named, *inputs, *stage.reads]
    makes = [*stage.makes, *map(_short, stage.outputs), *map(_short, stage.metrics)]
    columns = [
        textwrap.wrap(", ".join(cell), width - 2) for cell, width in zip((reads, makes), WIDTHS[1:], strict=True)
    ]
    return [_line(cells) for cells in zip_longest([f"  {stage.name}"], *columns, fillvalue="")]


def _short(path: str) -> str:
    """A path without the folder of the task or of the studies."""
    return path.removeprefix("datasets/{task}/").removeprefix("datasets/studies/")


def _line(cells: tuple[str, ...]) -> str:
    return "".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS, strict=True)).rstrip()


if __name__ == "__main__":
    main()
