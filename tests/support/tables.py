"""What tests ask of the file of a table."""

from __future__ import annotations

from pathlib import Path

from pipeline.formats.parquet.checked.open_table import OpenTable


def provenance_of(path: Path, name: str | None = None) -> dict[str, object]:
    """What is stored about where the rows came from; the schema's name is that of the file unless it is given."""
    with OpenTable(path, name or path.stem) as table:
        return table.provenance


def part_rows(path: Path) -> tuple[int, ...]:
    """How many rows each part has."""
    with OpenTable(path, path.stem) as table:
        return table.parts
