"""URDF as it is found: packages, meshes of other formats or none, links without inertia, fixed joints, mimics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene, replay
from pipeline.replay.scene import scene_files
from pipeline.replay.urdf import is_urdf
from tests.replay.test_scene_files import stl

LINK = '<link name="{name}"><{what}><geometry>{shape}</geometry></{what}></link>'
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>
<origin xyz="0.5 0 0"/><limit lower="-2" upper="1.5" effort="1" velocity="1"/>{more}</joint>"""
CYLINDER = '<cylinder radius="0.03" length="0.3"/>'


def robot(shape: str = CYLINDER, what: str = "collision", more: str = "") -> str:
    links = [LINK.format(name=name, what=what, shape=shape) for name in ("upper", "lower")]
    return "".join(
        [
            '<?xml version="1.0"?><robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="base"/>',
            *links,
            '<link name="tool0"/><link name="finger"/>',
            JOINT.format(name="j1", kind="revolute", parent="base", child="upper", more=""),
            JOINT.format(name="j2", kind="continuous", parent="upper", child="lower", more=""),
            JOINT.format(name="fixed", kind="fixed", parent="lower", child="tool0", more=""),
            JOINT.format(
                name="grip", kind="revolute", parent="tool0", child="finger",
                more='<mimic joint="j1" multiplier="2" offset="0.1"/>',
            ),
            more,
            "</robot>",
        ]
    )  # fmt: skip


def written(folder: Path, text: str, name: str = "arm.urdf") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def mesh(name: str) -> str:
    return f'<mesh filename="{name}"/>'


def test_links_without_inertia_and_on_fixed_joints_are_kept(tmp_path: Path) -> None:
    scene = load_scene(written(tmp_path, robot()), end_effector="tool0")
    assert scene.joints == ("j1", "j2")
    limits = scene.lower[0], scene.upper[0]
    np.testing.assert_allclose(limits, (-1.05, 0.7))  # so that the mimic, 2 x + 0.1, keeps to its own, -2 to 1.5
    assert scene.continuous.tolist() == [False, True]
    (motion,) = replay(scene, np.array([[[0.0, 0.0], [np.pi / 2, 0.0]]]))
    np.testing.assert_allclose(motion.end_effector[0], [[1.5, 0, 0], [0.5, 1, 0]], atol=1e-9)


def test_an_inertia_that_no_body_has_is_left_out_and_said(tmp_path: Path) -> None:
    wrong = '<link name="tool0"><inertial><mass value="1"/><inertia ixx="1" iyy="-1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    text = robot().replace('<link name="tool0"/>', f"{wrong}</inertial></link>")
    scene = load_scene(written(tmp_path, text), end_effector="tool0")
    (remark,) = scene.remarks
    assert remark.startswith("the inertia of tool0 is none that a body can have")


def test_a_mimic_follows(tmp_path: Path) -> None:
    scene = load_scene(written(tmp_path, robot()), end_effector="tool0")
    np.testing.assert_allclose(scene.rig.expanded(np.array([[0.3, 0.0]])), [[0.3, 0.0, 0.7]])


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("package://my_arm/meshes/a.stl", "my_arm/meshes/a.stl"),
        ("package://my_arm/meshes/a.stl", "my_arm/urdf/meshes/a.stl"),  # a package that was copied in part
        ("meshes/a.stl", "my_arm/urdf/meshes/a.stl"),
        ("../meshes/a.stl", "my_arm/meshes/a.stl"),
        ("file:///home/somebody/meshes/a.stl", "my_arm/urdf/meshes/a.stl"),
        ("package://my_arm/meshes/a.dae", "my_arm/meshes/a.stl"),  # the solid beside the picture
    ],
)
def test_meshes_are_found(tmp_path: Path, name: str, place: str) -> None:
    file = written(tmp_path, robot(mesh(name)), "my_arm/urdf/arm.urdf")
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_bytes(stl())
    if name.endswith("dae"):
        (tmp_path / place).with_suffix(".dae").write_text("<COLLADA/>")
    scene = load_scene(file, end_effector="tool0")
    assert (scene.remarks, scene.model.nmesh) == ((), 1)
    assert [path.resolve() for path in scene_files(file)] == sorted([file.resolve(), (tmp_path / place).resolve()])


@pytest.mark.parametrize("name", ["package://elsewhere/a.stl", "a.dae", "http://example.org/a.stl"])
def test_a_mesh_that_cannot_be_had_is_replaced_and_said(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.dae").write_text("<COLLADA/>")
    scene = load_scene(written(tmp_path, robot(mesh(name))), end_effector="tool0")
    assert scene.model.geom_size[:, 0].tolist() == [0.03, 0.03]
    (remark,) = scene.remarks
    assert remark.startswith(f"1 meshes ({Path(name).name}) are not there")


def test_a_package_outside_of_the_project_is_not_looked_into(tmp_path: Path) -> None:
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "a.stl").write_bytes(stl())
    file = written(tmp_path, robot(mesh("package://secret/a.stl")), "project/arm.urdf")
    assert load_scene(file, end_effector="tool0").model.nmesh == 1
    (tmp_path / "project" / "params.yaml").touch()
    assert load_scene(file, end_effector="tool0").model.nmesh == 0


def test_pictures_serve_where_there_are_no_solids(tmp_path: Path) -> None:
    assert load_scene(written(tmp_path, robot(what="visual")), end_effector="tool0").model.ngeom == 2
    both = robot(what="visual").replace("</link>", "</link>").replace(
        '<link name="base"/>', LINK.format(name="base", what="collision", shape=CYLINDER)
    )  # fmt: skip
    assert load_scene(written(tmp_path, both), end_effector="tool0").model.ngeom == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (robot(more="<xacro:arm/>"), "is a template; expand it with `xacro arm.urdf > arm.urdf`"),
        (robot()[:-20], "is not readable URDF"),
        ('<!DOCTYPE robot [<!ENTITY a "b">]>' + robot().partition("?>")[2], "declares entities"),
        ('<robot name="r"><link name="base"/></robot>', "no hinge or slide"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SceneError, match=message) as refused:
        load_scene(written(tmp_path, text))
    assert "\n" not in str(refused.value)


def test_other_files_are_no_urdf(tmp_path: Path) -> None:
    assert not is_urdf(written(tmp_path, "<mujoco/>"))
    assert not is_urdf(written(tmp_path, "no XML"))
    assert not is_urdf(tmp_path / "absent.urdf")
