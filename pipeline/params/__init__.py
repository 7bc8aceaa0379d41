"""params.yaml as frozen, validated objects: every field checked, unknown keys refused, nothing guessed."""

from pipeline.params.paths import fingerprint, value_at
from pipeline.params.reading import OWN_TASKS, load, overlay_tasks, own_tasks, parse
from pipeline.params.sections import (
    FILE,
    Duplicates,
    Explore,
    FigureSettings,
    GridWorldSettings,
    Infer,
    Ingest,
    Params,
    Reading,
    Regimes,
    Sample,
    ShiftedSampler,
    Task,
)

__all__ = [
    "Duplicates",
    "Explore",
    "FigureSettings",
    "FILE",
    "GridWorldSettings",
    "Infer",
    "Ingest",
    "OWN_TASKS",
    "Params",
    "Reading",
    "Regimes",
    "Sample",
    "ShiftedSampler",
    "Task",
    "fingerprint",
    "overlay_tasks",
    "load",
    "own_tasks",
    "parse",
    "value_at",
]
