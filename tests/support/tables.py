"""What tests ask of the file of a table, read without the program's own reader."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq

from pipeline.formats.parquet.checked.conformance import PROVENANCE_KEY


def provenance_of(path: Path) -> dict[str, object]:
    """What is stored about where the rows came from."""
    return dict(json.loads(pq.read_schema(path).metadata[PROVENANCE_KEY]))


def part_rows(path: Path) -> tuple[int, ...]:
    """How many rows each part has, that is each row group."""
    metadata = pq.read_metadata(path)
    return tuple(metadata.row_group(number).num_rows for number in range(metadata.num_row_groups))
