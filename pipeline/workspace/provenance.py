"""Where a table came from: the program, the parameters, the inputs, the seed, MuJoCo and the scene's model."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from pipeline import params
from pipeline.formats.parquet.checked.open_table import OpenTable
from pipeline.workspace.project import Project
from schemas import names

INHERITED = ("seed", "mujoco", "model")


def provenance(
    project: Project,
    parameters: Sequence[str],
    inputs: Iterable[Path | OpenTable],
    *,
    model: str | None = None,
    hashes: Mapping[Path, str] | None = None,
) -> dict[str, object]:
    """What every table says about itself, beside its schema and version.

    Seed, MuJoCo version and model are those of the stage if it used them, else those of the tables it was made from;
    None where no random number or no scene had a part in it.

    Args:
        project: whose table it is.
        parameters: the dotted paths of all parameters that the table depends on, as the registry of stages declares
            them.
        inputs: the files it was made from; a table that was opened need not be opened again.
        model: hash of the compiled scene (`pipeline.replay.model_hash`), if the stage used one.
        hashes: of inputs whose bytes were hashed as they were read; the others are read again.
    """
    inputs, known = list(inputs), hashes or {}
    paths = [one.path if isinstance(one, OpenTable) else one for one in inputs]
    stated = [_stated(project, one) for one in inputs]
    inherited = {key: next((one[key] for one in stated if one.get(key) is not None), None) for key in INHERITED}
    own: dict[str, object] = {"seed": project.params.seed} if "seed" in parameters else {}
    if model is not None:
        own |= {"mujoco": version("mujoco"), "model": model}
    return {
        "program": f"lessbench {version('lessbench')}",
        **inherited,
        **own,
        "parameters": params.fingerprint(project.params, parameters),
        "inputs": {project.shown(path): known.get(path) or content_hash(path) for path in paths},
    }


def is_current(project: Project, parameters: Sequence[str], table: OpenTable) -> bool:
    """Whether a table was made with the parameters and from the very tables that are there now.

    Files outside of the project are not looked at; provenance has only their names.

    Args:
        project: whose table it is.
        parameters: as of `provenance`.
        table: one that states its provenance.
    """
    stated, inputs = table.provenance, table.provenance.get("inputs")
    if not isinstance(inputs, dict) or stated.get("parameters") != params.fingerprint(project.params, parameters):
        return False
    files = {project.root / str(shown): known for shown, known in inputs.items() if "/" in str(shown)}
    return all(path.is_file() and content_hash(path) == known for path, known in files.items())


def _stated(project: Project, source: Path | OpenTable) -> dict[str, object]:
    """What an input says about itself; only tables say anything."""
    if isinstance(source, OpenTable):
        return source.provenance
    if source.stem in names() and source == project.table(source.parent.parent.name, source.stem):
        with OpenTable(source, source.stem) as table:
            return table.provenance
    return {}


def content_hash(path: Path) -> str:
    """SHA-256 of a file, as `sha256sum` says it."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
