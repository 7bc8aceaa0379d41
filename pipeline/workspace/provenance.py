"""Where a table came from: the program, the parameters, the inputs, the seed, MuJoCo and the scene's model."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path

from pipeline import params
from pipeline.formats.parquet.tables import read_provenance
from pipeline.workspace.project import Project

INHERITED = ("seed", "mujoco", "model")


def provenance(
    project: Project, parameters: Sequence[str], inputs: Iterable[Path], *, model: str | None = None
) -> dict[str, object]:
    """What every table says about itself, beside its schema and version.

    Seed, MuJoCo version and model are those of the stage if it used them, else those of the tables it was made from;
    None where no random number or no scene had a part in it.

    Args:
        project: whose table it is.
        parameters: the dotted paths of all parameters that the table depends on, as the registry of stages declares them.
        inputs: the files it was made from.
        model: hash of the compiled scene (`pipeline.replay.model_hash`), if the stage used one.
    """
    inputs = list(inputs)
    tables = [path for path in inputs if path.suffix == ".parquet" and path.is_relative_to(project.datasets)]
    stated = [read_provenance(path) for path in tables]
    inherited = {key: next((one[key] for one in stated if one.get(key) is not None), None) for key in INHERITED}
    own: dict[str, object] = {"seed": project.params.seed} if "seed" in parameters else {}
    if model is not None:
        own |= {"mujoco": version("mujoco"), "model": model}
    return {
        "program": f"lessbench {version('lessbench')}",
        **inherited,
        **own,
        "parameters": params.fingerprint(project.params, parameters),
        "inputs": {project.shown(path): content_hash(path) for path in inputs},
    }


def content_hash(path: Path) -> str:
    """SHA-256 of a file, as `sha256sum` says it."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
