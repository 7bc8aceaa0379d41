"""Names of joints in recordings and in a scene: the same, or the same but for separators or one prefix."""

from __future__ import annotations

import pytest

from pipeline.errors import ParameterError
from pipeline.workspace.joint_names import matched_names, renamed
from pipeline.workspace.recorded_joints import shared_by


def numbered(form: str, count: int = 7) -> list[str]:
    return [form.format(number) for number in range(1, count + 1)]


@pytest.mark.parametrize(
    ("recorded", "ours"),
    [
        (numbered("fr3_joint{}"), numbered("panda_joint{}")),
        (numbered("joint_{}"), numbered("Joint{}")),
        (numbered("left/joint_{}"), numbered("joint_{}")),
        (numbered("A{}"), numbered("lbr_iiwa_joint_{}")),
        (["shoulder_pan_joint", "elbow_joint"], ["robot0_shoulder_pan_joint", "robot0_elbow_joint"]),
    ],
)
def test_a_prefix_or_separators_apart(recorded: list[str], ours: list[str]) -> None:
    wanted = dict(zip(recorded, ours, strict=True))
    assert renamed(matched_names(recorded, ours)) == wanted
    others = ["gripper", "pan_tilt"]
    assert renamed(matched_names([*others, *recorded], [*ours, "drawer_slide"])) == wanted


def test_the_same_names_need_none() -> None:
    names = numbered("j{}")
    assert renamed(matched_names([*names, "finger"], [*names, "drawer"])) == {}


def test_a_finger_of_the_same_name_does_not_hide_the_arm() -> None:
    recorded, ours = [*numbered("fr3_joint{}"), "finger"], [*numbered("panda_joint{}"), "finger"]
    assert len(matched_names(recorded, ours)) == 8


def test_other_arms_have_nothing_in_common() -> None:
    assert matched_names(["shoulder", "wrist"], ["rail", "swing"]) == {}
    assert matched_names(["camera_joint"], ["door_joint"]) == {}


def test_two_arms_for_one_are_for_the_person_to_tell() -> None:
    recorded = numbered("left_joint{}", 2) + numbered("right_joint{}", 2)
    with pytest.raises(ParameterError, match=r"left_joint1: joint1.*or right_joint1: joint1.*--joint-name"):
        matched_names(recorded, numbered("joint{}", 2))


def test_what_recordings_share() -> None:
    found = shared_by([["a", "b"], [], ["b", "a", "c"]])
    assert (found.recordings, found.shared, found.some) == (2, ("a", "b"), ("c",))
