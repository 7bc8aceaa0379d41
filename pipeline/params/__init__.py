"""params.yaml as frozen, validated objects: every field checked, unknown keys refused, nothing guessed."""

from pipeline.params.reading import fingerprint, load, parse
from pipeline.params.sections import (
    FILE,
    Duplicates,
    GridWorldSettings,
    Infer,
    Ingest,
    Params,
    Sample,
    ShiftedSampler,
    Task,
)

__all__ = [
    "Duplicates",
    "FILE",
    "GridWorldSettings",
    "Infer",
    "Ingest",
    "Params",
    "Sample",
    "ShiftedSampler",
    "Task",
    "fingerprint",
    "load",
    "parse",
]
