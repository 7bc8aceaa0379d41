"""Which joints look like an arm's: not fingers, nor drawers, nor what nobody recorded."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.errors import SceneError
from pipeline.replay.arm_proposal import UnknownArm
from pipeline.replay.mechanism.proposal import Arm
from tests.replay.mechanism.test_arm import BALL, DRAWER, FINGERS, MUG, arm


def proposed(folder: Path, bodies: str, recorded: list[str] | None = None) -> Arm:
    file = folder / "scene.xml"
    file.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>')
    unknown = UnknownArm(file)
    return unknown.arm(list(unknown.joints) if recorded is None else recorded)


def test_fingers_by_name_and_by_place(tmp_path: Path) -> None:
    for hand in (FINGERS, FINGERS.replace("finger_", "f_")):
        found = proposed(tmp_path, arm(hand=hand) + MUG)
        assert (found.joints, found.hand) == (("j1", "j2"), "tip")
        assert list(found.left_out.values()) == ["finger", "finger"]


def test_furniture_and_what_nobody_recorded(tmp_path: Path) -> None:
    third = f'<body name="three"><joint name="j3"/>{BALL}</body>'
    bodies = arm(hand=third) + DRAWER
    assert proposed(tmp_path, bodies).left_out == {
        "drawer_slide": "short chain beside a longer one, as a drawer or a head"
    }
    found = proposed(tmp_path, bodies, ["j1", "j2", "j3"])
    assert (found.joints, found.left_out) == (("j1", "j2", "j3"), {"drawer_slide": "in no recording"})


def test_two_arms_and_a_base_that_moves(tmp_path: Path) -> None:
    both = arm("a_", hand="") + arm("b_", 1.0, hand="")
    assert proposed(tmp_path, both).joints == ("a_j1", "a_j2", "b_j1", "b_j2")
    torso = f'<body name="torso"><joint name="lift" type="slide"/>{BALL}{both}</body>'
    assert proposed(tmp_path, torso).joints == ("lift", "a_j1", "a_j2", "b_j1", "b_j2")


def test_a_head_on_the_torso_of_two_arms(tmp_path: Path) -> None:
    head = f'<body name="head"><joint name="pan"/>{BALL}</body>'
    third = f'<body name="{{0}}three"><joint name="{{0}}j3"/>{BALL}</body>'
    both = arm("a_", hand=third.format("a_")) + arm("b_", 1.0, hand=third.format("b_"))
    found = proposed(tmp_path, f'<body name="torso"><joint name="lift" type="slide"/>{BALL}{both}{head}</body>')
    assert list(found.left_out) == ["pan"]


def test_what_moves_freely_is_named(tmp_path: Path) -> None:
    proposed(tmp_path, arm() + MUG)
    assert UnknownArm(tmp_path / "scene.xml").free_bodies == ["mug"]


def test_nothing_that_looks_like_an_arm(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="name them with --joint, of finger_left, finger_right, j1, j2"):
        proposed(tmp_path, arm(), [])


def test_the_hand_without_sites_is_a_body_that_has_a_name(tmp_path: Path) -> None:
    plain = arm(hand="").replace('<site name="tip"/>', "")
    assert proposed(tmp_path, plain).hand == "hand"
    assert proposed(tmp_path, plain.replace('name="hand" ', "")).hand == "two"
