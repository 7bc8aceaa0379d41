"""Features of either of two arms, whichever the task calls its end effector."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from pipeline.replay import bind_features, load_scene
from pipeline.replay.features import KINDS
from pipeline.replay.scene import Scene

PAGE = Path(__file__).resolve().parents[3] / "docs" / "features.md"
ARM = """<body name="{side}_upper" pos="0 {y} .3"><joint name="{side}_a" axis="0 0 1" range="-2 2"/>
<geom type="capsule" size=".03" fromto="0 0 0 .4 0 0"/>
<body name="{side}_fore" pos=".4 0 0"><joint name="{side}_b" axis="0 1 0" range="-2 2"/>
<geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
<body name="{side}_wrist" pos=".3 0 0"><joint name="{side}_c" axis="1 0 1" range="-2 2"/><geom size=".03"/>
<body name="{side}_hand" pos=".1 0 .05"><geom size=".04"/></body></body></body></body>"""
SCENE = f"""<mujoco><compiler angle="radian"/><worldbody>{ARM.format(side="left", y=0.3)}
{ARM.format(side="right", y=-0.3)}<site name="top" type="box" size="1 1 .01"/>
<body name="laptop" pos=".5 .1 .1"><geom type="box" size=".15 .1 .1"/></body></worldbody></mujoco>"""
JOINTS = [f"{side}_{joint}" for side in ("left", "right") for joint in "abc"]
ARGUMENTS = {
    "object": "laptop", "radius_m": 0.6, "over": "top", "body": "laptop", "x_m": 0.1, "y_m": 0.2, "z_m": 0.3,
}  # fmt: skip
SHIPPED = sorted(name for name, kind in KINDS.items() if kind.evaluate.__module__.startswith("pipeline.replay.kinds"))
OF_EITHER = [name for name in SHIPPED if "of" in inspect.signature(KINDS[name].evaluate).parameters]


@pytest.fixture
def hands(tmp_path: Path) -> dict[str, Scene]:
    path = tmp_path / "two.xml"
    path.write_text(SCENE)
    return {side: load_scene(path, end_effector=f"{side}_hand", joints=JOINTS) for side in ("left", "right")}


def spec(name: str) -> dict[str, object]:
    needed = inspect.signature(KINDS[name].evaluate).parameters.values()
    return {"kind": name} | {
        one.name: ARGUMENTS[one.name]
        for one in needed
        if one.name in ARGUMENTS and one.default is inspect.Parameter.empty
    }


@pytest.fixture
def waypoints() -> np.ndarray:
    return np.random.default_rng(5).uniform(-1.5, 1.5, (30, 8, 6))


def test_what_the_page_shows_of_two_arms(hands: dict[str, Scene], waypoints: np.ndarray) -> None:
    block = next(text for text in re.findall(r"(?ms)^```yaml\n(.*?)^```$", PAGE.read_text()) if "left_hand" in text)
    task = YAML(typ="safe").load(block)
    assert task["end_effector"] == hands["right"].end_effector
    found = bind_features(hands["right"], task["features"]).evaluate(waypoints)
    left = {"f": {"kind": "proximity", "object": "laptop"}}
    np.testing.assert_array_equal(found[:, 2:], bind_features(hands["left"], left).evaluate(waypoints))
    assert found[:, 1:].any(axis=0).all()


@pytest.mark.parametrize("name", [name for name in OF_EITHER if name != "contact"])
def test_a_feature_of_the_other_hand_is_that_of_a_task_of_the_other_hand(
    hands: dict[str, Scene], waypoints: np.ndarray, name: str
) -> None:
    of_left = bind_features(hands["right"], {"f": spec(name) | {"of": "left_hand"}}).evaluate(waypoints)
    np.testing.assert_array_equal(of_left, bind_features(hands["left"], {"f": spec(name)}).evaluate(waypoints))
    assert not np.allclose(of_left, bind_features(hands["right"], {"f": spec(name)}).evaluate(waypoints))


@pytest.mark.parametrize("name", ["contact", *(name for name in SHIPPED if name not in OF_EITHER)])
def test_other_kinds_do_not_look_at_the_end_effector(hands: dict[str, Scene], waypoints: np.ndarray, name: str) -> None:
    left, right = (bind_features(scene, {"f": spec(name)}).evaluate(waypoints) for scene in hands.values())
    np.testing.assert_array_equal(left, right)


def test_a_contact_of_one_arm_is_not_one_of_the_other(hands: dict[str, Scene], waypoints: np.ndarray) -> None:
    specs = {side: {"kind": "contact", "of": f"{side}_upper", "object": "laptop"} for side in hands}
    found = bind_features(hands["right"], specs).evaluate(waypoints)
    still = waypoints.copy()
    still[:, :, :3] = 0
    again = bind_features(hands["right"], specs).evaluate(still)
    np.testing.assert_array_equal(found[:, 1], again[:, 1])
    assert found[:, 0].any()
    assert not np.array_equal(found[:, 0], again[:, 0])
