"""A scene around an arm: a table to stand on, objects on it, and where paths start and end. An MJCF file to edit."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import SceneError
from pipeline.replay.declared_sizes import check_declared_sizes
from pipeline.replay.model_files import model_files
from pipeline.replay.urdf import is_urdf, read_urdf

if TYPE_CHECKING:
    from pipeline.replay.scene import Scene

Place = tuple[float, float, float]
TABLE, TABLE_TOP = "table", "table_top"
_TABLE_CENTRE, _TABLE_HALF_SIZE = (0.4, 0.0, -0.02), (0.8, 0.8, 0.02)  # m; its top is the height of the arm's base
_OBJECT_M = 0.04  # radius


def furnished(arm: Path, output: Path, *, table: bool, objects: Mapping[str, Place]) -> tuple[str, tuple[str, ...]]:
    """MJCF of an arm with what stands around it, and remarks on what of the arm was replaced.

    Args:
        arm: MJCF or URDF file.
        output: where the text is to be written; meshes are named from its folder.
        table: whether a table is added, its top at the height of the arm's base, and on it the site `table_top`.
        objects: where spheres of 4 cm are added, m, by name.

    Raises:
        SceneError: the arm cannot be read, a name is taken, or a mesh is not there.
    """
    with building(arm):
        spec, remarks = furnished_spec(arm, output.absolute().parent, table=table, objects=objects)
        spec.compile()
        return str(spec.to_xml()), remarks


def furnished_spec(
    arm: Path, folder: Path, *, table: bool, objects: Mapping[str, Place]
) -> tuple[Any, tuple[str, ...]]:
    """The same as `mujoco.MjSpec`, not compiled yet, its meshes named from a folder; errors as of `furnished`."""
    spec, remarks = _read(arm, folder)
    taken = {body.name for body in spec.bodies}
    for name in (*((TABLE,) if table else ()), *objects):
        if name in taken:
            raise SceneError(f"{arm} has a body {name!r} already; give the object another name")
    if table:
        body = spec.worldbody.add_body(name=TABLE, pos=_TABLE_CENTRE)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=_TABLE_HALF_SIZE, rgba=(0.6, 0.5, 0.4, 1))
        body.add_site(name=TABLE_TOP, type=mujoco.mjtGeom.mjGEOM_BOX, size=_TABLE_HALF_SIZE)
    for name, place in objects.items():
        body = spec.worldbody.add_body(name=name, pos=place)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(_OBJECT_M, 0, 0), rgba=(0.8, 0.3, 0.2, 1))
    return spec, remarks


@contextmanager
def building(arm: Path) -> Iterator[None]:
    """Turns what MuJoCo raises into one sentence."""
    try:
        yield
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise SceneError(f"MuJoCo cannot build a scene around {arm}: {' '.join(str(error).split())}") from error


def with_keyframes(text: str, scene: Scene, keyframes: Mapping[str, FloatArray]) -> str:
    """The text of a scene with keyframes, configurations (J,) of its joints, everything else at home."""
    lines = []
    for name, configuration in keyframes.items():
        data = scene.rig.data()
        scene.rig.pose(data, configuration)
        lines.append(f'    <key name="{name}" qpos="{_numbers(np.asarray(data.qpos))}"/>\n')
    head, tail = text.rsplit("</mujoco>", 1)
    return f"{head}\n  <keyframe>\n{''.join(lines)}  </keyframe>\n</mujoco>{tail}"


def _read(arm: Path, folder: Path) -> tuple[Any, tuple[str, ...]]:
    """The arm as `mujoco.MjSpec`, its files named from the folder of the output, and remarks."""
    if not arm.is_file():
        raise SceneError(f"There is no file {arm}; give the path of an MJCF or URDF file.")
    check_declared_sizes(arm)
    remarks: tuple[str, ...] = ()
    if is_urdf(arm):
        urdf = read_urdf(arm)
        remarks = urdf.remarks
        spec = mujoco.MjSpec.from_string(urdf.text, assets=urdf.assets)
        found = {name: path.absolute() for name, path in urdf.meshes.items()}
        spec.assets = {}
    else:
        spec = mujoco.MjSpec.from_file(str(arm.absolute()))
        found = _located(model_files(arm), spec)
    for part in [*spec.meshes, *spec.hfields, *spec.skins, *spec.textures]:
        if part.file:
            if part.file not in found:
                raise SceneError(f"{arm} names {part.file}, which is not there; put it there, or take it out.")
            part.file = os.path.relpath(found[part.file], folder)
    spec.meshdir = spec.texturedir = ""
    spec.modelfiledir = str(folder)
    return spec, remarks


def _located(files: Sequence[Path], spec: Any) -> dict[str, Path]:
    """The files of a model by the names that it has for them."""
    names = [part.file for part in [*spec.meshes, *spec.hfields, *spec.skins, *spec.textures] if part.file]
    return {
        name: file
        for name in names
        for file in files
        if file.as_posix().endswith(Path(os.path.normpath(name)).as_posix().lstrip("./"))
    }


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:.6g}" for value in values.tolist())
