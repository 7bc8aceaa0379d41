"""The files that an MJCF or URDF file depends on."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import mujoco

from pipeline.errors import SceneError
from pipeline.replay.urdf import is_urdf, read_urdf


def model_files(path: Path) -> list[Path]:
    """The file itself and every file it depends on (included files, meshes, textures), sorted.

    Raises:
        SceneError: one of them is missing or is not XML where it should be.
    """
    path = path.absolute()
    if is_urdf(path):
        return sorted({path, *(Path(os.path.normpath(file)) for file in read_urdf(path).meshes.values())})
    try:
        listed = [Path(file) for file in mujoco.mju_getXMLDependencies(str(path))]
        assets = _assets(path)
    except (ValueError, mujoco.FatalError) as error:
        raise SceneError(
            f"The files that {path} depends on cannot be listed: {' '.join(str(error).split())}"
        ) from error
    # MuJoCo lists the meshes of a file that is included from another folder as if they were beside the first file
    for included in listed:
        if included.suffix.lower() == ".xml" and included != path:
            with suppress(ValueError, mujoco.FatalError):  # most included files are no models by themselves
                assets += _assets(included)
    return sorted({Path(os.path.normpath(file)) for file in [*listed, *assets] if file.is_file()})


def _assets(path: Path) -> list[Path]:
    """Where MuJoCo finds the meshes, height fields, skins and textures of a model."""
    spec = mujoco.MjSpec.from_file(str(path))
    geometry = [part.file for parts in (spec.meshes, spec.hfields, spec.skins) for part in parts]
    pictures = [file for texture in spec.textures for file in (texture.file, *texture.cubefiles)]
    folders = ((spec.meshdir, geometry), (spec.texturedir, pictures))
    return [path.parent / folder / file for folder, files in folders for file in files if file]
