"""Small JSON files of headline numbers, as `dvc metrics` reads them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from pipeline.formats.files.atomic import written_whole


def write_metrics(path: Path, numbers: Mapping[str, object]) -> None:
    """Write `numbers`, nested by name, whole or not at all; equal numbers give equal bytes."""
    with written_whole(path) as stream:
        stream.write((json.dumps(numbers, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode())
