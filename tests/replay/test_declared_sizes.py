"""Scenes that would take MuJoCo without end end in one sentence, at once."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from pipeline.errors import SceneError
from pipeline.replay.scene import load_scene

SCENE = """<mujoco>{assets}<worldbody><body name="a"><joint name="j" range="-90 90" limited="true"/>
<geom name="g" size=".1"/>{inside}</body>{beside}</worldbody></mujoco>"""


def written(folder: Path, assets: str = "", inside: str = "", beside: str = "") -> Path:
    path = folder / "scene.xml"
    path.write_text(SCENE.format(assets=assets, inside=inside, beside=beside))
    return path


REPLICATE = '<replicate count="{}" offset="0 0 1">{}</replicate>'
GEOM = '<geom size=".1"/>'
HOSTILE = {
    "replicate": ({"beside": REPLICATE.format(10**8, GEOM)}, "<replicate> declares 100,000,000 copies; at most"),
    "nested": (
        {"beside": REPLICATE.format(1000, REPLICATE.format(1000, GEOM))}, "<replicate> declares 1,000,000 copies"
    ),
    "height field": (
        {"assets": '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'},
        "<hfield> declares 10,000,000,000 grid points",
    ),
    "flexcomp": (
        {"beside": '<flexcomp name="f" type="grid" count="2000 2000 2000" spacing=".1 .1 .1" radius=".01" dim="3"/>'},
        "<flexcomp> declares 8,000,000,000 vertices",
    ),
    "texture": (
        {"assets": '<asset><texture name="t" type="2d" builtin="flat" width="200000" height="200000"/></asset>'},
        "<texture> declares 40,000,000,000 pixels",
    ),
    "device": (
        {"assets": '<asset><mesh name="m" file="/dev/zero"/></asset>'}, "names /dev/zero, which is a pipe, a socket or"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_it_ends_at_once_in_one_sentence(tmp_path: Path, case: str) -> None:
    parts, said = HOSTILE[case]
    begin = time.process_time()
    with pytest.raises(SceneError) as refused:
        load_scene(written(tmp_path, **parts))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    assert time.process_time() - begin < 1


@pytest.mark.parametrize("meshdir", ["", "meshes"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, meshdir: str) -> None:
    (tmp_path / meshdir).mkdir(exist_ok=True)
    os.mkfifo(tmp_path / meshdir / "m.stl")
    compiler = f'<compiler meshdir="{meshdir}"/>' if meshdir else ""
    path = written(tmp_path, assets=f'{compiler}<asset><mesh name="m" file="m.stl"/></asset>')
    with pytest.raises(SceneError, match=r"m\.stl, which is a pipe, a socket or a device and no file"):
        load_scene(path)


def test_what_is_included_is_looked_at(tmp_path: Path) -> None:
    (tmp_path / "part.xml").write_text(f"<mujoco><worldbody>{REPLICATE.format(10**8, GEOM)}</worldbody></mujoco>")
    path = tmp_path / "scene.xml"
    path.write_text('<mujoco><include file="part.xml"/></mujoco>')
    with pytest.raises(SceneError, match=r"part\.xml: <replicate> declares 100,000,000 copies"):
        load_scene(path)
    os.mkfifo(tmp_path / "pipe.xml")
    path.write_text('<mujoco><include file="pipe.xml"/></mujoco>')
    with pytest.raises(SceneError, match=r"pipe\.xml, which is a pipe"):
        load_scene(path)
    path.write_text('<mujoco><include file="scene.xml"/></mujoco>')
    with pytest.raises(SceneError, match="already included"):
        load_scene(path)


def test_entities_are_refused_before_they_grow(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text('<!DOCTYPE m [<!ENTITY a "aaaa">]><mujoco model="&a;"/>')
    with pytest.raises(SceneError, match="declares entities"):
        load_scene(path)


def test_ordinary_sizes_and_other_encodings_are_built(tmp_path: Path) -> None:
    parts = {
        "assets": '<asset><hfield name="h" nrow="100" ncol="100" size="1 1 1 1"/></asset>',
        "beside": REPLICATE.format(50, GEOM),
    }
    assert load_scene(written(tmp_path, **parts)).model.ngeom == 51
    path = written(tmp_path)
    path.write_bytes(path.read_text().replace('"g"', '"g\u00e9"').encode("latin-1"))
    assert load_scene(path).joints == ("j",)
