"""Which files a scene depends on: those that MuJoCo reads, wherever its includes, folders and attachments put them."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from pipeline.errors import SceneError
from pipeline.replay import load_scene
from pipeline.replay.scene import scene_files

JOINT = '<body name="link"><joint name="j"/><geom type="mesh" mesh="tet"/></body>'
CORNERS = ((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1))
SCENE, ARM, MAIN = "scene.xml", "arm/arm.xml", "<mujoco>{}</mujoco>"


def stl() -> bytes:
    """A tetrahedron, binary."""
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    rows = [struct.pack("<12fH", 0, 0, 0, *(x for corner in face for x in CORNERS[corner]), 0) for face in faces]
    return b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows)


def arm(file: str = "tet.stl", compiler: str = "") -> str:
    mesh = f'<asset><mesh name="tet" file="{file}"/></asset>'
    return f"<mujoco>{compiler}{mesh}<worldbody>{JOINT}</worldbody></mujoco>"


INCLUDED = f'<include file="{ARM}"/>'
ATTACHED = (
    f'<asset><model name="arm" file="{ARM}"/></asset>'
    '<worldbody><attach model="arm" body="link" prefix="a_"/></worldbody>'
)
MESHDIR = '<compiler meshdir="assets"/>'
LAYOUTS = {
    "beside the scene": ({SCENE: arm()}, "tet.stl"),
    "in a folder of the scene": ({SCENE: arm("meshes/tet.stl")}, "meshes/tet.stl"),
    "in the scene's meshdir": ({SCENE: arm(compiler=MESHDIR)}, "assets/tet.stl"),
    "beside the included arm": ({SCENE: MAIN.format(INCLUDED), ARM: arm()}, "arm/tet.stl"),
    "in a folder of the included arm": (
        {SCENE: MAIN.format(INCLUDED), ARM: arm("meshes/tet.stl")}, "arm/meshes/tet.stl"
    ),
    "of an included arm, beside the scene": ({SCENE: MAIN.format(INCLUDED), ARM: arm()}, "tet.stl"),
    "of an included arm, in its meshdir": (
        {SCENE: MAIN.format(INCLUDED), ARM: arm(compiler=MESHDIR)}, "assets/tet.stl"
    ),
    "of an included arm, in the scene's meshdir": (
        {SCENE: MAIN.format(INCLUDED + '<compiler meshdir="late"/>'), ARM: arm(compiler=MESHDIR)}, "late/tet.stl",
    ),
    "of an attached arm": ({SCENE: MAIN.format(ATTACHED), ARM: arm(compiler=MESHDIR)}, "arm/assets/tet.stl"),
    "of an arm that an attached file includes": (
        {
            SCENE: MAIN.format(ATTACHED.replace(ARM, "cell/cell.xml")),
            "cell/cell.xml": MAIN.format('<include file="arm/arm.xml"/>'), "cell/arm/arm.xml": arm(),
        },
        "cell/arm/tet.stl",
    ),
    "above the scene": ({f"scenes/{SCENE}": arm("../meshes/tet.stl")}, "meshes/tet.stl"),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_mesh_that_is_read_is_listed(tmp_path: Path, layout: str) -> None:
    texts, mesh = LAYOUTS[layout]
    for name, content in {**{name: text.encode() for name, text in texts.items()}, mesh: stl()}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    scene = tmp_path / next(iter(texts))
    load_scene(scene)
    assert scene_files(scene) == sorted(tmp_path / name for name in [*texts, mesh])
    (tmp_path / mesh).unlink()
    with pytest.raises(SceneError, match=r"tet\.stl"):
        load_scene(scene)


def test_textures_are_listed(tmp_path: Path) -> None:
    from matplotlib import image

    (tmp_path / "pictures").mkdir()
    image.imsave(tmp_path / "pictures" / "wood.png", [[0.0, 1.0], [1.0, 0.0]])
    texture = '<compiler texturedir="pictures"/><asset><texture name="wood" type="2d" file="wood.png"/></asset>'
    scene = tmp_path / SCENE
    scene.write_text(MAIN.format(texture + '<worldbody><body><joint name="j"/><geom size="1"/></body></worldbody>'))
    assert scene_files(scene) == [tmp_path / "pictures" / "wood.png", scene]
