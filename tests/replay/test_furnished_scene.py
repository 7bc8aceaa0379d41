"""A scene that is built around an arm is that arm, with what was asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene
from pipeline.replay.furnished_scene import furnished, with_keyframes
from pipeline.replay.scene import Scene
from tests.replay.test_scene_files import ARM, INCLUDED, MAIN, MESHDIR, SCENE, arm, stl
from tests.replay.test_urdf import mesh, robot

ARMS = {
    "urdf": ({"arm.urdf": robot(mesh("package://arms/tet.stl"))}, "arm.urdf", "arms/tet.stl"),
    "mjcf": ({SCENE: arm(compiler=MESHDIR)}, SCENE, "assets/tet.stl"),
    "included": ({SCENE: MAIN.format(INCLUDED), ARM: arm("meshes/tet.stl")}, SCENE, "arm/meshes/tet.stl"),
}


def built(folder: Path, which: str) -> tuple[Path, Scene]:
    files, name, place = ARMS[which]
    for file, content in (*files.items(), (place, "")):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(content)
    (folder / place).write_bytes(stl())
    output = folder / "project" / "scenes" / "built.xml"
    output.parent.mkdir(parents=True)
    text, remarks = furnished(folder / name, output, table=True, objects={"cup": (0.5, 0.1, 0.2)})
    assert remarks == ()
    output.write_text(text)
    return folder / name, load_scene(output)


@pytest.mark.parametrize("which", ARMS)
def test_the_arm_moves_as_before(tmp_path: Path, which: str) -> None:
    file, scene = built(tmp_path, which)
    alone = load_scene(file)
    assert (scene.joints, scene.box_sites(), scene.model.nmesh) == (alone.joints, ["table_top"], 1)
    np.testing.assert_allclose(scene.lower, alone.lower)
    configuration = np.full(len(scene.joints), 0.3)
    ours, theirs = scene.rig.data(), alone.rig.data()
    scene.rig.pose(ours, configuration)
    alone.rig.pose(theirs, configuration)
    for body in range(1, alone.model.nbody):
        name = alone.model.body(body).name
        np.testing.assert_allclose(ours.body(name).xpos, theirs.body(name).xpos, atol=1e-6)
    np.testing.assert_allclose(ours.body("cup").xpos, (0.5, 0.1, 0.2))


def test_what_was_replaced_is_said(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(robot(mesh("a.stl")))
    _, (remark,) = furnished(tmp_path / "arm.urdf", tmp_path / "x.xml", table=False, objects={})
    assert remark.startswith("1 meshes (a.stl) are not there")


def test_keyframes(tmp_path: Path) -> None:
    _, scene = built(tmp_path, "urdf")
    wanted = {"start": np.array([0.1, -0.2]), "goal": np.array([0.3, 2.0])}
    scene.path.write_text(with_keyframes(scene.path.read_text(), scene, wanted))
    again = load_scene(scene.path)
    assert again.start is not None
    assert again.goal is not None
    np.testing.assert_allclose([again.start, again.goal], list(wanted.values()), atol=1e-5)


def test_what_cannot_be_built(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(robot())
    with pytest.raises(SceneError, match="has a body 'tool0' already"):
        furnished(file, tmp_path / "x.xml", table=False, objects={"tool0": (0, 0, 0)})
    with pytest.raises(SceneError, match="There is no file"):
        furnished(tmp_path / "none.urdf", tmp_path / "x.xml", table=False, objects={})
    (tmp_path / SCENE).write_text(arm())
    with pytest.raises(SceneError, match=r"names tet\.stl, which is not there"):
        furnished(tmp_path / SCENE, tmp_path / "x.xml", table=False, objects={})
