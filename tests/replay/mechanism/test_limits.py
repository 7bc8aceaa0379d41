"""What joint positions are judged to be, and what they are taken for where they cannot be right."""

from __future__ import annotations

import re
from math import radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.errors import ArgumentError
from pipeline.replay.mechanism.limits import TOLERANCE_M, TOLERANCE_RAD, Limits, Verdict, judge_positions

TURN = 2 * np.pi
NAMES = ("base", "shoulder", "elbow", "wrist", "lift")
LIMITS = Limits(
    NAMES,
    np.array([-np.inf, 0.8, -2.0, -6.2, 0.0]),
    np.array([np.inf, 5.4, 2.0, 6.2, 1.0]),
    np.array([False, False, False, False, True]),
)
PATH = np.linspace([0, 1.0, -1.0, 2.0, 0.1], [3, 5.0, 1.5, 4.5, 0.9], 50)
WITHIN, TOLERATED, TURNED, BEYOND = Verdict.WITHIN, Verdict.TOLERATED, Verdict.TURNED, Verdict.BEYOND


def verdicts(positions):
    return [one.verdict for one in judge_positions(LIMITS, positions).joints]


def changed(**columns):
    path = PATH.copy()
    for name, values in columns.items():
        path[:, NAMES.index(name)] = values
    return path


def test_within_the_limits():
    judged = judge_positions(LIMITS, PATH)
    assert verdicts(PATH) == [WITHIN] * 5
    assert (judged.positions == PATH).all()
    assert judged.refusal is None
    assert judged.remarks == ()
    assert judged.cause is None


def test_beyond_by_less_than_the_tolerance_is_used_as_it_is():
    path = changed(elbow=np.where(np.arange(50) == 7, 2 + 0.99 * TOLERANCE_RAD, 0), lift=-0.99 * TOLERANCE_M)
    judged = judge_positions(LIMITS, path)
    assert verdicts(path) == [WITHIN, WITHIN, TOLERATED, WITHIN, TOLERATED]
    assert (judged.positions == path).all()
    assert judged.refusal is None
    assert judged.remarks[0] == "joint 'elbow' is at 2.05184; its limits are -2 to 2 rad"
    assert judged.joints[2].sample == 7
    assert judged.joints[2].limit == 2
    assert judged.joints[4].limit == 0


def test_beyond_is_refused_with_joint_value_and_limits():
    path = changed(elbow=np.where(np.arange(50) == 7, -2 - 1.01 * TOLERANCE_RAD, 0))
    judged = judge_positions(LIMITS, path)
    assert verdicts(path) == [WITHIN, WITHIN, BEYOND, WITHIN, WITHIN]
    assert judged.refusal == "joint 'elbow' is at -2.05288; its limits are -2 to 2 rad."
    assert (judged.joints[2].sample, judged.joints[2].limit) == (7, -2)
    assert judge_positions(LIMITS, changed(elbow=2.5, lift=1.2)).refusal == (
        "joint 'elbow' is at 2.5; its limits are -2 to 2 rad (1 more joint is beyond a limit)."
    )


def test_the_tolerance_of_a_small_range_is_a_tenth_of_it():
    finger = Limits(("finger",), np.zeros(1), np.full(1, 0.04), np.ones(1, bool))
    assert finger.tolerance.tolist() == [pytest.approx(0.004)]
    assert LIMITS.tolerance.tolist() == [radians(3)] * 4 + [0.01]


@pytest.mark.parametrize("turns", [1, -1])
def test_one_whole_turn_is_taken_back(turns):
    judged = judge_positions(LIMITS, PATH + TURN * turns * np.array([0, 1, 1, 0, 0]))
    assert [one.verdict for one in judged.joints] == [WITHIN, TURNED, TURNED, WITHIN, WITHIN]
    np.testing.assert_allclose(judged.positions, PATH, atol=1e-14)
    assert all("a whole turn from its limits" in remark for remark in judged.remarks)
    assert judge_positions(LIMITS, PATH + 2 * TURN * turns * np.array([0, 1, 0, 0, 0])).refusal is not None


def test_positions_reported_within_one_turn_are_unwrapped():
    """A driver that reports from -pi to pi cuts a joint's way in two where its limits reach across pi."""
    wrapped = PATH.copy()
    for name in ("shoulder", "wrist"):
        column = NAMES.index(name)
        wrapped[:, column] = (PATH[:, column] + np.pi) % TURN - np.pi
    judged = judge_positions(LIMITS, wrapped)
    # the wrist's limits allow both parts as they stand, but no way between them
    assert [one.verdict for one in judged.joints] == [WITHIN, TURNED, WITHIN, TURNED, WITHIN]
    np.testing.assert_allclose(judged.positions, PATH, atol=1e-14)


@given(
    arrays(np.float64, (12, 5), elements=st.floats(-0.2, 0.2)),
    st.tuples(*[st.sampled_from([0, 1, -1])] * 3),
    st.integers(0, 11),
)
def test_turns_leave_the_pose_as_it_is(steps, turns, place):
    """Whatever is done to positions, no joint ends up anywhere else than a number of whole turns away."""
    path = np.clip(PATH[:1] + np.cumsum(steps, axis=0), LIMITS.lower, LIMITS.upper)
    given_path = path.copy()
    given_path[place:, 1:4] += TURN * np.array(turns)
    judged = judge_positions(LIMITS, given_path)
    moved = (judged.positions - given_path) / TURN
    np.testing.assert_allclose(moved, np.rint(moved), atol=1e-12)
    assert not moved[:, [0, 4]].any()
    if judged.refusal is None:
        assert (LIMITS.excess(judged.positions) <= LIMITS.tolerance).all()
        assert np.abs(np.diff(judged.positions[:, 1:3], axis=0)).max() < np.pi
    assert judged.joints[1].verdict is not BEYOND  # one turn, for all or for a part, is always found out


SWAPPED = PATH[:, [0, 2, 1, 3, 4]]


@pytest.mark.parametrize(
    ("positions", "cause"),
    [
        (np.where(LIMITS.slides, PATH, np.degrees(PATH)), "They look like degrees; convert them to radians."),
        (
            np.where(LIMITS.slides, PATH, np.linspace(-100, 99, 50)[:, None]),
            "percentages from -100 to 100; convert them",
        ),
        (
            np.where(LIMITS.slides, PATH, np.linspace(50, 98.5, 50)[:, None]),
            "like degrees or percentages from -100 to 100",
        ),
        (np.rint(PATH * 4096 / TURN), "All are whole numbers, as encoders count ticks"),
        (changed(lift=PATH[:, 4] * 1000), "They look like millimetres; convert them to metres."),
        (SWAPPED, r"in another order \(those of 'elbow' to 'shoulder', those of 'shoulder' to 'elbow'\)"),
        (np.zeros((30, 5)), "All positions are zero, as a driver or a second publisher without a reading"),
        (np.where(np.arange(50)[:, None] % 5, PATH, 0), "10 of 50 rows are all zero, .* leave them out"),
    ],
)  # fmt: skip
def test_what_positions_look_like(positions, cause):
    judged = judge_positions(LIMITS, positions)
    assert judged.cause is not None
    assert re.search(cause, judged.cause)
    assert judged.refusal.endswith(judged.cause)


def test_positions_that_look_like_nothing_known_have_no_cause():
    assert judge_positions(LIMITS, changed(shoulder=0.3)).cause is None
    assert judge_positions(LIMITS, changed(lift=PATH[:, 4] + 0.5)).cause is None


def test_a_joint_without_limits_is_judged_by_its_turns():
    judged = judge_positions(LIMITS, changed(base=np.linspace(250, 310.8, 50)))
    assert judged.refusal is None
    (remark,) = judged.remarks
    assert remark == "Joint 'base' is at 310.8 rad, 49 turns; if these are degrees, convert them to radians"
    assert judge_positions(LIMITS, changed(base=PATH[:, 0] + 3 * TURN)).remarks == ()


@pytest.mark.parametrize("shape", [(5,), (0, 5), (5, 50), (2, 5, 1)])
def test_shapes(shape):
    with pytest.raises(ArgumentError, match=r"must be \(T, 5\), one column for each of base, shoulder, elbow"):
        judge_positions(LIMITS, np.zeros(shape))


def test_not_finite():
    with pytest.raises(ArgumentError, match="must be finite"):
        judge_positions(LIMITS, changed(base=np.nan))


def test_one_pose_is_judged_as_well():
    assert verdicts(PATH[:1]) == [WITHIN] * 5
    assert verdicts(PATH[:1] - TURN * np.eye(5)[1]) == [WITHIN, TURNED, WITHIN, WITHIN, WITHIN]
