"""SIGKILL at a dozen seeded random moments; `python tests/support/kills.py --moments 100` is the long form."""

from __future__ import annotations

import pytest

from tests.support.kills import Undisturbed, disturb


@pytest.mark.timeout(900)
def test_killed_at_any_moment_the_next_run_gives_the_same_files(undisturbed: Undisturbed) -> None:
    for number in range(12):
        disturb(undisturbed, number)
