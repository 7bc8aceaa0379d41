"""Which clock a recording's times are of, and which samples it leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import RecordingError
from pipeline.formats.mcap.clocks import SLIGHT, Timed, timed

START, STEP = 1_700_000_000 * 10**9, 10**7  # 100 Hz
EVEN = START + STEP * np.arange(20)


def by(header: np.ndarray, publish: np.ndarray = EVEN, log: np.ndarray = EVEN, asked: str | None = None) -> Timed:
    q = np.random.default_rng(1).normal(size=(len(header), 2))
    return timed("/arm", {"header": header, "publish": publish[: len(header)], "log": log[: len(header)]}, q, asked)


def test_a_simulation_that_begins_at_zero_keeps_its_clock() -> None:
    found = by(STEP * np.arange(20))
    assert (found.clock, found.dropped, found.time_ns[0], found.remarks) == ("header", 0, 0, ())


def test_samples_before_a_clock_runs_are_left_out_and_said() -> None:
    stamps = STEP * np.arange(20)
    stamps[:4] = 0
    found = by(stamps)
    assert (found.clock, found.dropped, found.time_ns.tolist()) == ("header", 4, stamps[4:].tolist())
    assert "4 samples without a header stamp" in found.remarks[0]


@pytest.mark.parametrize("stamp", [0, START])
def test_a_header_clock_that_stands_gives_way_to_the_next_that_runs(stamp: int) -> None:
    found = by(np.full(20, stamp), publish=EVEN + 5)
    assert (found.clock, found.time_ns[0]) == ("publish", START + 5)
    assert ("are 0" in found.remarks[0]) == (stamp == 0)
    assert by(np.full(20, stamp)).clock == "log"  # a publish time that is the log time is no other clock
    assert by(np.full(20, stamp), publish=np.zeros(20, np.int64), log=EVEN).clock == "log"


def test_one_repeated_and_one_late_stamp_are_left_out() -> None:
    stamps = EVEN.copy()
    stamps[8], stamps[14] = stamps[7], stamps[13] - STEP // 2
    found = by(stamps)
    assert (found.dropped, np.flatnonzero(~found.kept).tolist()) == (2, [8, 14])
    assert "2 of 20 samples left out" in found.remarks[0]


@pytest.mark.parametrize("back", [int(SLIGHT * STEP) + 1, 3600 * 10**9])
def test_a_step_back_is_refused_with_the_remedy(back: int) -> None:
    stamps = EVEN.copy()
    stamps[9:] -= back + STEP
    with pytest.raises(
        RecordingError, match=r"Pose 10 on /arm .*mcap filter.*ingest\.clock to publish or log"
    ) as caught:
        by(stamps)
    assert caught.value.reason == "time-not-increasing"
    assert by(stamps, asked="log").clock == "log"


def test_a_stamp_in_the_future_is_a_step_back_and_not_the_end_of_a_recording() -> None:
    stamps = EVEN.copy()
    stamps[5] += 3600 * 10**9
    with pytest.raises(RecordingError, match="Pose 7"):
        by(stamps)
