"""What a robot and its scene look like, and where its bodies are: the material of a picture, from the compiled model.

The shapes are those MuJoCo's own viewer shows by default (geom groups 0 to 2; groups from 3 on hold collision
geometry by convention). They are logged once; `body_poses` says where they go at each configuration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from pipeline.errors import ArgumentError, SceneError

if TYPE_CHECKING:
    from pipeline.arrays import FloatArray, IntArray
    from pipeline.replay.scene import Scene

KINDS = ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
VISIBLE_GROUPS = 3
_BY_TYPE = {int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")): kind for kind in KINDS}


@dataclass(frozen=True)
class Shape:
    """One solid, fixed to a body.

    Attributes:
        name: the geom's name, or `<kind>_<geom id>` where the file gives none.
        kind: one of KINDS.
        body: index into `Geometry.body_names`.
        size: (3,) m, as MuJoCo has it: radius first for sphere, capsule and cylinder, then the half length; half
            extents for box, ellipsoid and plane (a plane's 0 means without end).
        position: (3,) m, of the shape's centre in the body's frame.
        quaternion: (4,) wxyz, of the shape in the body's frame.
        rgba: (4,) in 0..1.
        vertices: (V, 3) m in the shape's frame, of a mesh; empty otherwise.
        faces: (W, 3) rows of `vertices`, of a mesh; empty otherwise.
    """

    name: str
    kind: str
    body: int
    size: FloatArray
    position: FloatArray
    quaternion: FloatArray
    rgba: FloatArray
    vertices: FloatArray
    faces: IntArray


@dataclass(frozen=True)
class Geometry:
    """The bodies of a scene, the world first, the shapes fixed to them, and where its author looks from.

    Attributes:
        body_names: (B,).
        shapes: in the order of the file.
        viewpoint: (3,) m, where the first camera of the file that stands still is; None if there is no such camera.
    """

    body_names: tuple[str, ...]
    shapes: tuple[Shape, ...]
    viewpoint: FloatArray | None


def extract_geometry(model: Any) -> Geometry:
    """The visible shapes of a compiled model.

    Args:
        model: `mujoco.MjModel`.

    Raises:
        SceneError: a visible geom is of a type that has no solid form here (height field, signed distance field).
    """
    names = tuple(model.body(i).name or f"body_{i}" for i in range(model.nbody))
    visible = [i for i in range(model.ngeom) if is_drawn(model, i)]
    return Geometry(body_names=names, shapes=tuple(_shape(model, i) for i in visible), viewpoint=_viewpoint(model))


def body_poses(scene: Scene, waypoints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where every body is at each configuration, for shapes to be drawn there.

    Args:
        scene: the loaded scene.
        waypoints: (M, J) rad or m, the arm's joints in the scene's order.

    Returns:
        (M, B, 3) positions in m and (M, B, 4) quaternions wxyz, both in the world's frame, bodies in the order of
        `Geometry.body_names`.

    Raises:
        ArgumentError: `waypoints` is not (M, J) for this scene's J joints.
    """
    waypoints = np.asarray(waypoints, dtype=np.float64)
    if waypoints.ndim != 2 or waypoints.shape[1] != len(scene.joints):
        raise ArgumentError(
            f"waypoints must be (M, {len(scene.joints)}), one column for each of {', '.join(scene.joints)}; "
            f"got shape {waypoints.shape}."
        )
    model, data = scene.model, scene.rig.data()
    positions = np.empty((len(waypoints), model.nbody, 3))
    quaternions = np.empty((len(waypoints), model.nbody, 4))
    for row, configuration in enumerate(waypoints):
        scene.rig.pose(data, configuration)
        positions[row], quaternions[row] = data.xpos, data.xquat
    return _frozen(positions), _frozen(quaternions)


def _shape(model: Any, geom: int) -> Shape:
    kind = _BY_TYPE.get(int(model.geom_type[geom]))
    name = model.geom(geom).name or f"{kind}_{geom}"
    if kind is None:
        raise SceneError(
            f"geom {model.geom(geom).name or geom} has MuJoCo type {int(model.geom_type[geom])}, which cannot be "
            f"drawn; allowed are {', '.join(KINDS)}: put it in a geom group from 3 on to leave it out."
        )
    vertices, faces = _mesh(model, int(model.geom_dataid[geom])) if kind == "mesh" else _no_mesh()
    return Shape(
        name=name,
        kind=kind,
        body=int(model.geom_bodyid[geom]),
        size=_frozen(model.geom_size[geom]),
        position=_frozen(model.geom_pos[geom]),
        quaternion=_frozen(model.geom_quat[geom]),
        rgba=_frozen(colour(model, geom)),
        vertices=vertices,
        faces=faces,
    )


def is_drawn(model: Any, geom: int) -> bool:
    """Whether a geom is seen: it is in a visible group and not fully transparent."""
    return bool(model.geom_group[geom] < VISIBLE_GROUPS and colour(model, geom)[3] > 0)


def colour(model: Any, geom: int) -> Any:
    """Red, green, blue and opacity (4,) of a geom: its material wins over its own colour, as in MuJoCo's renderer."""
    material = int(model.geom_matid[geom])
    return model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]


def _viewpoint(model: Any) -> FloatArray | None:
    for camera in range(model.ncam):
        if model.cam_bodyid[camera] == 0:
            return _frozen(model.cam_pos[camera])
    return None


def _mesh(model: Any, mesh: int) -> tuple[FloatArray, IntArray]:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    first_face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    triangles = np.array(model.mesh_face[first_face : first_face + faces], dtype=np.int64)
    triangles.flags.writeable = False
    return _frozen(model.mesh_vert[first : first + count]), triangles


def _no_mesh() -> tuple[FloatArray, IntArray]:
    return _frozen(np.empty((0, 3))), np.empty((0, 3), dtype=np.int64)


def _frozen(values: Any) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
