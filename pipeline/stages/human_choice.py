"""Stage: the human choice study of section 3, or anybody's choices in the same columns."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from pipeline.errors import StageError
from pipeline.formats.parquet.tables import write_table
from pipeline.stages.registry import parameters
from pipeline.studies.human_choice import analyse_choices, compare_with_paper, counted
from pipeline.studies.model_evidence import with_uncertain_control
from pipeline.vocabulary import STUDIES
from pipeline.workspace.people import identity
from pipeline.workspace.project import Project, recorded_run
from pipeline.workspace.provenance import provenance


def run(project: Project) -> None:
    """Write the human_choice tables.

    Raises:
        StageError: the file of choices is missing or is no CSV.
        TableError: see `analyse_choices`.
    """
    settings = project.params.studies.human_choice
    with recorded_run(project, "human-choice", STUDIES) as record:
        source = project.path(settings.choices)
        choices = read_choices(source)
        study = analyse_choices(choices, settings.options, settings.alpha)
        stated = provenance(project, parameters("human-choice"), [source])
        tables = {"control": study.control, "predictions": study.predictions, "tests": with_uncertain_control(study)}
        paper = compare_with_paper(study) if settings.compare_with_paper else pl.DataFrame(schema=PAPER)
        for name, table in (tables | {"paper": paper}).items():
            write_table(project.table(STUDIES, f"human_choice_{name}"), f"human_choice_{name}", table, stated)
        record.produced = f"{study.tests.height} tests of {int(study.tests['n'][0])} choices"
        if left_out := choices.height - counted(choices).height:
            record.notes.append(f"{left_out} of {choices.height} people failed the attention test and are left out")


PAPER = {
    "quantity": pl.String, "comparison": pl.String, "model": pl.String, "printed": pl.String, "value": pl.Float64,
    "agrees": pl.Boolean, "note": pl.String,
}  # fmt: skip


def read_choices(source: Path) -> pl.DataFrame:
    """The rows of a file of choices, every cell as text without the blanks around it; a cell that says nothing is null.

    Numbers stay as they are written, so that the options 1 and 01 are two, and those in `options` are found.
    """
    try:
        with source.open("rb") as stream:  # a path would be taken for a pattern
            rows = pl.read_csv(stream, infer_schema=False)
    except FileNotFoundError:
        raise StageError(f"{source}: there is no such file; studies.human_choice.choices names it") from None
    except pl.exceptions.PolarsError as error:
        raise StageError(f"{source}: cannot be read as CSV ({' '.join(str(error).split())})") from None
    headers = [name.strip() for name in rows.columns]
    if repeated := next((name for name in headers if headers.count(name) > 1), None):
        raise StageError(f"{source}: has the column {repeated!r} twice; keep one")
    rows.columns = headers
    rows = rows.with_columns(pl.all().str.strip_chars()).with_columns(pl.all().replace("", None))
    for name in headers:
        _refuse_alike(source, name, rows[name])
    return rows


def _refuse_alike(source: Path, column: str, cells: pl.Series) -> None:
    """Labels that look the same must be the same; else one option, group or person would be counted as two."""
    seen = dict[str, str]()
    for label in cells.drop_nulls().unique(maintain_order=True).to_list():
        other = seen.setdefault(identity(label), label)
        if other != label:
            raise StageError(
                f"{source}: the column {column!r} has {other!r} and {label!r}, which differ only in case, blanks or "
                "Unicode form; write them alike if they mean one, or name them apart"
            )
