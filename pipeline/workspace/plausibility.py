"""What a recording of an arm can be: within limits, moving as arms do, one demonstration between the right ends."""

from __future__ import annotations

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.formats.mcap.rejection_reasons import rejection
from pipeline.params import Ingest
from pipeline.replay.ends import Distance, distances
from pipeline.replay.mechanism.limits import Verdict, judge_positions
from pipeline.replay.replay import replay
from pipeline.replay.room import YIELD_M
from pipeline.replay.scene import Scene
from pipeline.replay.surface import Surface
from pipeline.trajectories import motion
from pipeline.trajectories.timebase import Moving

IRREGULAR = 0.6
"""Median intervals that 9 of 10 intervals span; of a driver whose messages come 12 % early or late it is 0.5."""
PACE = 1.3
"""Times as long as before are intervals if a clock changes its pace."""
NEAR_RAD, NEAR_M = 0.1, 0.05
"""An end this near is where it should be: nobody leads an arm to a keyframe more exactly."""
_CUT = (
    "cut the recording, such as with `mcap filter RECORDING -o PART.mcap --include-metadata --start TIME --end TIME` "
    "(log times), one file for each demonstration; rows of a table are told apart by the task's reading.id"
)


def within_limits(scene: Scene, positions: FloatArray, time_s: FloatArray, remarks: list[str]) -> FloatArray:
    """Recorded positions (M, J), whole turns added where they bring a joint within its limits.

    Args:
        scene: whose limits.
        positions: (M, J) as recorded.
        time_s: (M,) for messages.
        remarks: to which phrases on what is odd are added.

    Raises:
        RecordingError: beyond-limits.
    """
    judged = judge_positions(scene.limits, positions)
    if judged.refusal is not None:
        worst = next(one for one in judged.joints if one.verdict is Verdict.BEYOND)
        raise rejection(
            "beyond-limits",
            f"At {time_s[worst.sample]:.3f} s {judged.refusal} Correct the recording (of a table or dataset, name "
            f"its unit in the task's reading.unit), or the joint's range in {scene.path.name}.",
        )
    remarks += judged.remarks
    return judged.positions


def require_plausible(scene: Scene, part: Moving, settings: Ingest, remarks: list[str]) -> motion.Event:
    """Refuse what no arm does, and what is more than one demonstration; remark on what is odd.

    Returns:
        The speed that comes nearest to its limit.

    Raises:
        RecordingError: gap, jump, too-fast or several-motions.
    """
    time_s, q = part.time_s, part.positions
    _check_gap(part, settings, remarks)
    jump = np.where(scene.slides, settings.jump_m, settings.jump_rad)
    for step in motion.outlying_steps(time_s, q):
        said = f"{_joint(scene, step.joint)} moves {_size(scene, step)} in one sample at {_at(step.at_s)}"
        if step.size > jump[step.joint]:
            raise rejection(
                "jump",
                f"{said}, {motion.OUTLIER:g} times as far as in the samples around it or more; a sample is wrong, or "
                "another publisher or arm came in between: remove it. A real motion of this kind needs a greater "
                "ingest.jump_rad or jump_m.",
            )
        if step.size > motion.ODD_STEP:
            remarks.append(f"{said}, much farther than in the samples around it")
    limit = np.where(scene.slides, settings.fastest_m_s, settings.fastest_rad_s)
    fastest = max(motion.greatest_speeds(time_s, q), key=lambda speed: speed.size / limit[speed.joint])
    if fastest.size > limit[fastest.joint]:
        raise rejection(
            "too-fast",
            f"{_joint(scene, fastest.joint)} moves at {_size(scene, fastest)}/s at {_at(fastest.at_s)}, allowed are "
            f"{limit[fastest.joint]:g}; positions in other units, such as degrees, or a wrong clock do this. A faster "
            "arm needs a greater ingest.fastest_rad_s or fastest_m_s.",
        )
    for noise in motion.shaking(q):
        if noise.size > settings.idle_rad:
            remarks.append(
                f"{_joint(scene, noise.joint)} goes to and fro by {_size(scene, noise)} from sample to sample"
            )
    if motion.irregularity(time_s) > IRREGULAR:
        low, high = np.percentile(np.diff(time_s), [5, 95])
        remarks.append(f"samples come irregularly, {low:.3g} to {high:.3g} s apart")
    if motion.changing_pace(time_s) > PACE:
        remarks.append(
            f"its clock runs up to {motion.changing_pace(time_s):.2g} times as fast at one time as at another"
        )
    require_one(part, settings, remarks)
    return fastest


def _check_gap(part: Moving, settings: Ingest, remarks: list[str]) -> None:
    """Refuse a time without samples in which the arm moved, remark on missing samples."""
    gap, usual = motion.longest_gap(part.time_s), 1 / motion.rate_hz(part.time_s)
    if gap.size <= motion.MISSED * usual:
        return
    row = int(np.searchsorted(part.time_s, gap.at_s))
    moved = float(np.abs(part.positions[row + 1] - part.positions[row]).max())
    said = f"no sample for {gap.size:.3g} s from {_at(gap.at_s)} on, where {usual:.3g} s is usual"
    if gap.size > settings.longest_gap_s and moved > settings.idle_rad:
        raise rejection(
            "gap",
            f"There is {said}, and a joint is {moved:.2g} rad or m elsewhere after it; how the arm went there is not "
            "recorded. Record it again, or, if a straight way will do, use a greater ingest.longest_gap_s.",
        )
    remarks.append(said)


def require_one(part: Moving, settings: Ingest, remarks: list[str]) -> None:
    """Refuse what is more than one demonstration: the arm comes back and leaves again, or rests for long.

    Raises:
        RecordingError: several-motions.
    """
    again = motion.returns(part.time_s, part.positions)
    if again:
        times = ", ".join(_at(one) for one in again[:5])
        raise rejection(
            "several-motions",
            f"The arm comes back to where it began and leaves again, at {times} of its clock: the recording holds "
            f"{len(again) + 1} motions, not one; {_CUT}.",
        )
    rest = motion.longest_rest(part.time_s, part.positions, settings.idle_rad)
    said = f"rests for {rest.size:.2g} s from {_at(rest.at_s)} on"
    if rest.size > settings.longest_rest_s:
        raise rejection(
            "several-motions",
            f"The arm {said}, longer than within one demonstration; {_CUT}, or, if it is one, use a greater "
            "ingest.longest_rest_s.",
        )
    if rest.size > settings.longest_rest_s / 3:
        remarks.append(said)


def ends_apart(
    scene: Scene, path: FloatArray, settings: Ingest, remarks: list[str]
) -> tuple[Distance, Distance] | None:
    """How far the ends of waypoints (T, J) are from the scene's start and goal; None if it has none.

    They are far if a joint and the end effector are: an arm with more joints than it needs reaches the same place in
    other configurations, and people end in them.

    Raises:
        RecordingError: far-ends, unless these are kept.
    """
    if scene.start is None or scene.goal is None:
        return None
    start, goal = distances(scene, path[:1], scene.start)[0], distances(scene, path[-1:], scene.goal)[0]
    for verb, keyframe, apart in (("starts", "start", start), ("ends", "goal", goal)):
        said = f"{verb} {apart} from keyframe {keyframe!r}"
        far = is_far(apart, settings)
        if far and settings.far_ends == "reject":
            raise rejection(
                "far-ends",
                f"The motion {said}, and the task's alternatives go from start to goal; it may be a part of a "
                f"demonstration or one of another task. Move the keyframe in {scene.path.name}, or set the task's "
                "anchor to demonstration, or ingest.far_ends to keep.",
            )
        if apart.turned_rad > NEAR_RAD or max(apart.slid_m, apart.end_effector_m) > NEAR_M:
            remarks.append(f"{said}{', which is far' if far else ''}")
    return start, goal


def remark_on_surface(scene: Scene, path: FloatArray, surface: Surface, remarks: list[str]) -> None:
    """Say that waypoints (T, J) go further under the surface than alternatives may begin there."""
    (moved,) = replay(scene, path[None])
    depth = float(np.max(surface.depth(moved)))
    if depth > YIELD_M:
        remarks.append(f"goes {100 * depth:.2g} cm under the task's surface, which alternatives do not")


def is_far(apart: Distance, settings: Ingest) -> bool:
    """Whether an end is elsewhere: a joint and the end effector are far from where they should be."""
    elsewhere = apart.turned_rad > settings.far_rad or apart.slid_m > settings.far_m
    return elsewhere and apart.end_effector_m > settings.far_m


def _joint(scene: Scene, joint: int) -> str:
    return f"joint {scene.joints[joint]!r}"


def _size(scene: Scene, event: motion.Event) -> str:
    return f"{event.size:.3g} {'m' if scene.slides[event.joint] else 'rad'}"


def _at(at_s: float) -> str:
    return f"{at_s:.3f} s"
